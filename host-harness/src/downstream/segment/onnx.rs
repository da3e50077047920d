//! Segments event frames by a trained model in an ONNX file.
//!
//! ```text
//! Frame -> 1 x C x H x W -> the model's size -> model -> logits -> the frame's size -> Masks
//! ```
//!
//! | input's C | channels |
//! |---|---|
//! | 1 | ON - OFF events |
//! | 2 | ON events, OFF events |
//! | 3 | a picture: red min(ON / [`FULL`], 1), green 0, blue min(OFF / [`FULL`], 1) |
//!
//! Frames are resized to the H and W that the model fixes; dynamic sides take the frame's size. If the model has
//! several outputs, the one named `masks` is used, else the first:
//!
//! | output | segments |
//! |---|---|
//! | 1 x 1 x h x w | one segment: logits above 0 |
//! | 1 x K x h x w | the class of the greatest logit (the first of equals); class 0 is the background |
//! | N x h x w, N x 1 x h x w | the mask of the greatest logit, if that is above 0 |
//!
//! Logits are float32. Masks and a single class may also be integers (or Booleans), which are taken as logits of 1
//! if above 0, else of -1. Input and output are resized bilinearly about the pixels' centres.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use eecvs_nostd::Sensor;
use rten::{DataType, Dimension, Model, NodeId, Value, ValueType};
use rten_tensor::Tensor;
use rten_tensor::prelude::*;

use super::{Frame, Masks, Segmenter};

/// Number of events at which a picture's colour saturates.
pub const FULL: u8 = 3;
/// Longest side of a model's input, in pixels.
const SIDE_MAX: usize = 4096;
/// Size of the frame on which a model is tried.
const TRIED: Sensor = Sensor {
    width: 64,
    height: 48,
};
/// Name of the output that is used if there are several.
const OUTPUT: &str = "masks";

/// A model and the format of its input.
pub struct OnnxModel {
    path: PathBuf,
    name: String,
    model: Model,
    input: NodeId,
    channels: Channels,
    /// Sides of the input if the model fixes them; `None` for the frame's.
    height: Option<usize>,
    width: Option<usize>,
    output: NodeId,
}

/// Meaning of the input's channels.
#[derive(Debug, Clone, Copy)]
enum Channels {
    Signed,
    Polarities,
    Picture,
}

impl OnnxModel {
    /// Loads a model and checks its input and a first result.
    ///
    /// # Errors
    /// Fails if the file cannot be read or is not an ONNX model, the runtime lacks an operator, the input differs
    /// from what [the module](self) describes, the model cannot be run on a frame without events, or its output for
    /// that is not finite. The message names the file.
    pub fn open(path: &Path) -> Result<Self> {
        let opened = Self::load(path).and_then(|model| {
            // A failure now is better than one after minutes of other work.
            model.run(&Frame::new(TRIED, &[]))?;
            Ok(model)
        });
        opened.with_context(|| {
            format!(
                "{}: not a segmentation model that can be run; docs/segmentation.md tells how to export one",
                path.display()
            )
        })
    }

    fn load(path: &Path) -> Result<Self> {
        let is_named_onnx = path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("onnx"));
        ensure!(is_named_onnx, "the file's name must end in .onnx");
        // The runtime's own error for a missing file is unclear.
        std::fs::File::open(path).context("the file cannot be opened")?;
        let model = guarded(|| Ok(Model::load_file(path)?))?;
        let [input] = *model.input_ids() else {
            bail!(
                "the model has {} inputs, and there is one frame; make the others constants",
                model.input_ids().len()
            );
        };
        let info = model
            .node_info(input)
            .ok_or_else(|| anyhow!("the model does not describe its input"))?;
        let is_float = info
            .dtype()
            .is_none_or(|dtype| dtype == ValueType::Tensor(DataType::Float));
        ensure!(is_float, "the input must be float32");
        let shape = info.shape().unwrap_or_default();
        let [batch, channels, height, width] = shape.as_slice() else {
            bail!(
                "the input must have the shape 1 x C x H x W, and has {} dimensions",
                shape.len()
            );
        };
        ensure!(
            !matches!(batch, Dimension::Fixed(size) if *size != 1),
            "the input's first dimension must be 1: one frame at a time"
        );
        let channels = match channels {
            Dimension::Fixed(1) => Channels::Signed,
            Dimension::Fixed(2) => Channels::Polarities,
            Dimension::Fixed(3) => Channels::Picture,
            Dimension::Fixed(other) => bail!("the input has {other} channels; 1, 2 or 3 are known"),
            Dimension::Symbolic(name) => {
                bail!("the number of the input's channels, {name:?}, must be fixed: 1, 2 or 3")
            }
        };
        let (height, width) = (side(height)?, side(width)?);
        let name = |id: &&NodeId| model.node_info(**id).and_then(|info| info.name());
        let outputs = model.output_ids();
        let output = *outputs
            .iter()
            .find(|id| name(id) == Some(OUTPUT))
            .or(outputs.first())
            .ok_or_else(|| anyhow!("the model has no output"))?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        Ok(Self {
            path: path.to_owned(),
            name: format!("onnx {stem}"),
            model,
            input,
            channels,
            height,
            width,
            output,
        })
    }

    fn run(&self, frame: &Frame) -> Result<Masks> {
        let sensor = frame.sensor();
        let own = (usize::from(sensor.height), usize::from(sensor.width));
        let (height, width) = (self.height.unwrap_or(own.0), self.width.unwrap_or(own.1));
        let mut data = Vec::new();
        let channels = self.channels.of(frame);
        for channel in &channels {
            let image = Image {
                values: channel,
                height: own.0,
                width: own.1,
            };
            image.resized(height, width, &mut data);
        }
        let input = Value::from_shape([1, channels.len(), height, width], data)?;
        let outputs = guarded(|| {
            let inputs = vec![(self.input, input.into())];
            Ok(self.model.run(inputs, &[self.output], None)?)
        })?;
        let output = outputs
            .into_iter()
            .next()
            .ok_or_else(|| anyhow!("the model gave no output"))?;
        let logits = Logits::new(output)?;
        Masks::new(sensor, &logits.labels(own.0, own.1))
    }
}

impl Segmenter for OnnxModel {
    fn name(&self) -> &str {
        &self.name
    }

    fn segment(&mut self, frame: &Frame) -> Result<Masks> {
        self.run(frame).with_context(|| {
            format!(
                "{}: the model cannot be run; docs/segmentation.md tells how to export one",
                self.path.display()
            )
        })
    }
}

/// Returns the size that the model fixes, if any.
fn side(dimension: &Dimension) -> Result<Option<usize>> {
    match dimension {
        Dimension::Fixed(size @ 1..=SIDE_MAX) => Ok(Some(*size)),
        Dimension::Fixed(size) => {
            bail!("the input is {size} pixels wide or high; 1 to {SIDE_MAX} are possible")
        }
        Dimension::Symbolic(_) => Ok(None),
    }
}

/// Runs code of the runtime, which may panic on an inconsistent model.
fn guarded<T>(run: impl FnOnce() -> Result<T>) -> Result<T> {
    // After a failure only the model is used again, and a run does not change it.
    catch_unwind(AssertUnwindSafe(run))
        .unwrap_or_else(|_| Err(anyhow!("the ONNX runtime fails on the model")))
}

impl Channels {
    /// Returns each channel's values in raster order.
    fn of(self, frame: &Frame) -> Vec<Vec<f32>> {
        let counts = |counts: &[u32]| counts.iter().map(|count| *count as f32).collect();
        let colour = |counts: &[u32]| {
            let full = f32::from(FULL);
            counts.iter().map(|c| (*c as f32 / full).min(1.0)).collect()
        };
        let (on, off) = (frame.on(), frame.off());
        match self {
            Self::Signed => {
                let pairs = on.iter().zip(off);
                let sums = pairs.map(|(on, off)| (i64::from(*on) - i64::from(*off)) as f32);
                vec![sums.collect()]
            }
            Self::Polarities => vec![counts(on), counts(off)],
            Self::Picture => vec![colour(on), vec![0.0; on.len()], colour(off)],
        }
    }
}

/// One channel in raster order.
#[derive(Debug, Clone, Copy)]
struct Image<'v> {
    values: &'v [f32],
    height: usize,
    width: usize,
}

impl Image<'_> {
    /// Appends the image at another size.
    fn resized(&self, height: usize, width: usize, to: &mut Vec<f32>) {
        let columns: Vec<Place> = Place::all(self.width, width);
        for row in Place::all(self.height, height) {
            to.extend(columns.iter().map(|column| {
                let at = |row: usize| {
                    let value = |column: usize| self.value(row, column);
                    column.blend(value(column.before), || value(column.after))
                };
                row.blend(at(row.before), || at(row.after))
            }));
        }
    }

    fn value(&self, row: usize, column: usize) -> f32 {
        let value = self.values.get(row * self.width + column);
        value.copied().unwrap_or_default()
    }
}

/// Position of a new pixel among the old ones along one axis.
#[derive(Debug, Clone, Copy)]
struct Place {
    before: usize,
    after: usize,
    share_after: f32,
}

impl Place {
    /// Returns the position of each of `new` pixels along an axis of `old` pixels; both are at least 1.
    fn all(old: usize, new: usize) -> Vec<Self> {
        let last = old.saturating_sub(1);
        let scale = old as f64 / new as f64;
        (0..new)
            .map(|pixel| {
                let place = ((pixel as f64 + 0.5) * scale - 0.5).clamp(0.0, last as f64);
                let before = place as usize;
                Self {
                    before,
                    after: (before + 1).min(last),
                    share_after: (place - before as f64) as f32,
                }
            })
            .collect()
    }

    /// Interpolates between two values; `after` is called only if it has a share.
    fn blend(self, before: f32, after: impl FnOnce() -> f32) -> f32 {
        if self.share_after == 0.0 {
            return before;
        }
        before + self.share_after * (after() - before)
    }
}

/// A model's output: layers of h x w logits.
struct Logits {
    values: Vec<f32>,
    layers: usize,
    height: usize,
    width: usize,
    /// Whether the first layer is the background; otherwise, pixels where all logits are 0 or less are background.
    has_background: bool,
}

impl Logits {
    fn new(output: Value) -> Result<Self> {
        let (shape, values, is_float) = match output {
            Value::FloatTensor(tensor) => (tensor.shape().to_vec(), tensor.into_data(), true),
            Value::Int32Tensor(tensor) => (tensor.shape().to_vec(), signs(&tensor), false),
            Value::Int8Tensor(tensor) => (tensor.shape().to_vec(), signs(&tensor), false),
            Value::UInt8Tensor(tensor) => (tensor.shape().to_vec(), signs(&tensor), false),
            _ => bail!("the output is no tensor of numbers"),
        };
        let (layers, height, width, has_background) = match *shape.as_slice() {
            [masks, height, width] | [masks, 1, height, width] => (masks, height, width, false),
            [1, classes, height, width] => (classes, height, width, true),
            _ => bail!(
                "the output must have the shape 1 x K x h x w or N x h x w, and has {shape:?}"
            ),
        };
        ensure!(
            is_float || !has_background,
            "logits of classes must be float32"
        );
        ensure!(
            values.iter().all(|value| value.is_finite()),
            "the output is not finite: its logits are infinite or no numbers"
        );
        let is_filled = height > 0 && width > 0 || layers == 0;
        ensure!(
            is_filled && values.len() == layers.saturating_mul(height).saturating_mul(width),
            "the output has no pixels: its shape is {shape:?}"
        );
        Ok(Self {
            values,
            layers,
            height,
            width,
            has_background,
        })
    }

    /// Returns the label of every pixel of the frame.
    fn labels(&self, height: usize, width: usize) -> Vec<u32> {
        let mut labels = vec![0; height * width];
        let least = if self.has_background {
            f32::NEG_INFINITY
        } else {
            0.0
        };
        let mut greatest = vec![least; labels.len()];
        let mut resized = Vec::with_capacity(labels.len());
        let layers = self.values.chunks_exact((self.height * self.width).max(1));
        // Class 0 is label 0; the first mask is label 1.
        for (label, values) in (u32::from(!self.has_background)..).zip(layers.take(self.layers)) {
            let layer = Image {
                values,
                height: self.height,
                width: self.width,
            };
            resized.clear();
            layer.resized(height, width, &mut resized);
            for ((known, greatest), logit) in labels.iter_mut().zip(&mut greatest).zip(&resized) {
                // False for NaN.
                if *logit > *greatest {
                    (*known, *greatest) = (label, *logit);
                }
            }
        }
        labels
    }
}

/// Converts integers to logits.
fn signs<T: Copy + Default + PartialOrd>(tensor: &Tensor<T>) -> Vec<f32> {
    let is_above = |value: &T| *value > T::default();
    tensor
        .iter()
        .map(|value| if is_above(value) { 1.0 } else { -1.0 })
        .collect()
}
