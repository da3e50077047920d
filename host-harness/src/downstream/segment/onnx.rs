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
//! | 1 x h x w, 1 x 1 x h x w of integers | the label of each value above 0, at most [`LABELS_MAX`] of them |
//!
//! Logits are float32. Masks may also be integers (or Booleans), which are taken as logits of 1 if above 0, else of
//! -1. Values of masks that all lie in \[0, 1\] on the frames on which a model is tried are probabilities, cut at
//! 0.5. Input and output are resized bilinearly about the pixels' centres.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use anyhow::{Context, Result, anyhow, bail, ensure};
use eecvs_nostd::{Event, Polarity, Sensor};
use rten::{DataType, Dimension, Model, NodeId, Value, ValueType};
use rten_tensor::Tensor;
use rten_tensor::prelude::*;
use sha2::{Digest, Sha256};

use super::{Frame, Masks, Segmenter};

/// Number of events at which a picture's colour saturates.
pub const FULL: u8 = 3;
/// Largest number of labels in an output of integers.
pub const LABELS_MAX: usize = 255;
/// Longest side of a model's input, in pixels.
const SIDE_MAX: usize = 4096;
/// Size of the frames on which a model is tried: that of the emulated scenes, which are part of every study.
const TRIED: Sensor = Sensor {
    width: 346,
    height: 260,
};
/// Name of the output that is used if there are several.
const OUTPUT: &str = "masks";
/// Probability above which a pixel belongs to a mask.
const CUT: f32 = 0.5;
/// How far a probability may be outside [0, 1], since sums of shares are rounded.
const ROUNDING: f32 = 1e-3;

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
    /// Name of the output, and the number of outputs among which it was chosen.
    output_name: String,
    outputs: usize,
    /// Whether the values of the output's masks are probabilities.
    has_probabilities: bool,
}

/// Meaning of the input's channels.
#[derive(Debug, Clone, Copy)]
enum Channels {
    Signed,
    Polarities,
    Picture,
}

impl OnnxModel {
    /// Loads a model, and tries it on a frame without events and on one with events.
    ///
    /// # Errors
    /// Fails if the file cannot be read or is not an ONNX model, the runtime lacks an operator, the input or output
    /// differs from what [the module](self) describes, or an output is not finite. The message names the file.
    pub fn open(path: &Path) -> Result<Self> {
        let opened = Self::load(path).and_then(|mut model| {
            // A failure now is better than one after minutes of other work.
            let [empty, busy] = &*FRAMES;
            let (empty, busy) = (model.output(empty)?, model.output(busy)?);
            model.has_probabilities = empty.fits_unit() && busy.fits_unit();
            model.name = format!("{} ({})", model.name, model.meaning(&busy));
            Ok(model)
        });
        opened.with_context(|| {
            format!(
                "{}: not a segmentation model that can be run; docs/segmentation.md says how to \
                 export one",
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
        let file = std::fs::File::open(path).context("the file cannot be opened")?;
        // A device or a pipe may have no end.
        let is_file = file.metadata().is_ok_and(|metadata| metadata.is_file());
        ensure!(is_file, "it is not a file");
        let model = guarded(|| Ok(Model::load_file(path)?))?;
        let [input] = *model.input_ids() else {
            bail!(
                "the model has {} inputs, but only the frame is given; make the others constants",
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
                "the input must have the shape 1 x C x H x W, but has {} dimensions",
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
            Dimension::Fixed(other) => {
                bail!("the input has {other} channels; 1, 2 or 3 are supported")
            }
            Dimension::Symbolic(name) => {
                bail!("the number of the input's channels, {name:?}, must be fixed: 1, 2 or 3")
            }
        };
        let (height, width) = (side(height)?, side(width)?);
        let name = |id: NodeId| {
            let info = model.node_info(id);
            info.and_then(|info| info.name().map(str::to_owned))
        };
        let outputs = model.output_ids();
        let output = *outputs
            .iter()
            .find(|id| name(**id).as_deref() == Some(OUTPUT))
            .or(outputs.first())
            .ok_or_else(|| anyhow!("the model has no output"))?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        Ok(Self {
            path: path.to_owned(),
            name: format!("onnx {stem}"),
            output_name: name(output).unwrap_or_default(),
            outputs: outputs.len(),
            model,
            input,
            channels,
            height,
            width,
            output,
            has_probabilities: false,
        })
    }

    /// Describes how the output is read, and identifies the file.
    fn meaning(&self, output: &Output) -> String {
        let mut meaning = match &output.values {
            Values::Labels { .. } => "labels".to_owned(),
            Values::Layers { .. } if output.has_background => {
                format!("the greatest of {} classes", output.layers)
            }
            Values::Layers {
                is_float: false, ..
            } => "masks of integers".to_owned(),
            Values::Layers { .. } if self.has_probabilities => {
                format!("probabilities above {CUT}")
            }
            Values::Layers { .. } => "logits above 0".to_owned(),
        };
        if self.outputs > 1 {
            meaning += &format!(" of output `{}`", self.output_name);
        }
        let digest = std::fs::read(&self.path).map(Sha256::digest);
        if let Ok([first, second, third, fourth, ..]) = digest.as_deref() {
            meaning += &format!(", sha256 {first:02x}{second:02x}{third:02x}{fourth:02x}");
        }
        meaning
    }

    fn run(&self, frame: &Frame) -> Result<Masks> {
        let sensor = frame.sensor();
        let output = self.output(frame)?;
        if self.has_probabilities {
            ensure!(
                output.fits_unit(),
                "the output `{}` held probabilities in [0, 1] when the model was tried, but has \
                 other values for this frame: export logits, which are negative outside segments, \
                 or probabilities",
                self.output_name
            );
        }
        let cut = if self.has_probabilities { CUT } else { 0.0 };
        let (height, width) = (usize::from(sensor.height), usize::from(sensor.width));
        Masks::new(sensor, &output.labels(height, width, cut))
    }

    /// Runs the model on a frame.
    fn output(&self, frame: &Frame) -> Result<Output> {
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
        });
        let outputs =
            outputs.with_context(|| format!("on a frame of {width} x {height} pixels"))?;
        let output = outputs
            .into_iter()
            .next()
            .ok_or_else(|| anyhow!("the model gave no output"))?;
        Output::new(output, height, width)
            .map_err(|error| anyhow!("the output `{}` {error:#}", self.output_name))
    }
}

/// Frames on which a model is tried: one without events, and one with 1 to 4 events of either polarity per pixel in
/// blocks.
static FRAMES: LazyLock<[Frame; 2]> = LazyLock::new(|| {
    let mut events = Vec::new();
    for y in 0..TRIED.height {
        for x in (y / 8 % 3 * 16..TRIED.width)
            .step_by(48)
            .flat_map(|x| x..x + 16)
        {
            for number in 0..1 + (x / 16 + y / 8) % 4 {
                events.push(Event {
                    t_us: 0,
                    x,
                    y,
                    polarity: Polarity::from_bool((x / 4 + y / 4 + number) % 3 > 0),
                });
            }
        }
    }
    [&[][..], &events].map(|events| Frame::new(TRIED, events))
});

impl Segmenter for OnnxModel {
    fn name(&self) -> &str {
        &self.name
    }

    fn segment(&self, frame: &Frame) -> Result<Masks> {
        self.run(frame).with_context(|| {
            format!(
                "{}: the model cannot be run; docs/segmentation.md says how to export one",
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
            bail!("the input is {size} pixels wide or high; 1 to {SIDE_MAX} are supported")
        }
        Dimension::Symbolic(_) => Ok(None),
    }
}

/// Runs code of the runtime, which may panic on an inconsistent model.
fn guarded<T>(run: impl FnOnce() -> Result<T>) -> Result<T> {
    // After a failure only the model is used again, and a run does not change it.
    catch_unwind(AssertUnwindSafe(run))
        .unwrap_or_else(|_| Err(anyhow!("the ONNX runtime failed on the model")))
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

/// A model's output of h x w pixels.
struct Output {
    values: Values,
    layers: usize,
    height: usize,
    width: usize,
    /// Whether the first layer is the background; otherwise, pixels where no layer is above the cut are background.
    has_background: bool,
}

enum Values {
    /// One layer after the other; integers are 1 or -1.
    Layers { values: Vec<f32>, is_float: bool },
    /// The label of every pixel, and the labels that occur, in ascending order, the background's 0 first.
    Labels { labels: Vec<i32>, known: Vec<i32> },
}

impl Output {
    /// Takes the output for an input of `height` x `width` pixels.
    fn new(output: Value, height: usize, width: usize) -> Result<Self> {
        match output {
            Value::FloatTensor(tensor) => {
                let shape = Shape::new(tensor.shape(), height, width)?;
                let values = tensor.into_data();
                ensure!(
                    values.iter().all(|value| value.is_finite()),
                    "has values that are not finite: NaN or infinite"
                );
                Ok(shape.of_layers(values, true))
            }
            Value::Int32Tensor(tensor) => Self::of_integers(&tensor, height, width),
            Value::Int8Tensor(tensor) => Self::of_integers(&tensor, height, width),
            Value::UInt8Tensor(tensor) => Self::of_integers(&tensor, height, width),
            _ => bail!("is not a tensor of float32 or integers"),
        }
    }

    fn of_integers<T>(tensor: &Tensor<T>, height: usize, width: usize) -> Result<Self>
    where
        T: Copy + Into<i32>,
    {
        let shape = Shape::new(tensor.shape(), height, width)?;
        ensure!(
            !shape.has_background,
            "has {} classes of integers; the values of classes must be float32",
            shape.layers
        );
        let values = tensor.iter().map(|value| (*value).into());
        if shape.layers != 1 {
            let signs = values.map(|value: i32| if value > 0 { 1.0 } else { -1.0 });
            return Ok(shape.of_layers(signs.collect(), false));
        }
        let labels: Vec<i32> = values.map(|value| value.max(0)).collect();
        let mut known: BTreeSet<i32> = labels.iter().copied().collect();
        known.insert(0);
        ensure!(
            known.len() <= LABELS_MAX + 1,
            "has {} labels, but at most {LABELS_MAX} are supported; logits must be float32",
            known.len() - 1
        );
        Ok(Self {
            layers: known.len(),
            values: Values::Labels {
                labels,
                known: known.into_iter().collect(),
            },
            height: shape.height,
            width: shape.width,
            // The layers are the labels' places, those of the background first.
            has_background: true,
        })
    }

    /// Returns whether the values are of masks and all lie in [0, 1], as probabilities do.
    fn fits_unit(&self) -> bool {
        let Values::Layers { values, is_float } = &self.values else {
            return false;
        };
        let unit = -ROUNDING..=1.0 + ROUNDING;
        *is_float && !self.has_background && values.iter().all(|value| unit.contains(value))
    }

    /// Returns the values of a layer; `room` is for values that are not stored.
    fn layer<'v>(&'v self, number: usize, room: &'v mut Vec<f32>) -> &'v [f32] {
        let pixels = self.height * self.width;
        match &self.values {
            Values::Layers { values, .. } => {
                let layer = values.get(number * pixels..(number + 1) * pixels);
                layer.unwrap_or_default()
            }
            Values::Labels { labels, known } => {
                let known = known.get(number);
                room.clear();
                room.extend(labels.iter().map(|label| f32::from(Some(label) == known)));
                room
            }
        }
    }

    /// Returns the label of every pixel of the frame; masks begin above `cut`.
    fn labels(&self, height: usize, width: usize, cut: f32) -> Vec<u32> {
        let mut labels = vec![0; height * width];
        let least = if self.has_background {
            f32::NEG_INFINITY
        } else {
            cut
        };
        let mut greatest = vec![least; labels.len()];
        let mut resized = Vec::with_capacity(labels.len());
        let mut room = Vec::new();
        // Class 0 is label 0; the first mask is label 1.
        for (label, number) in (u32::from(!self.has_background)..).zip(0..self.layers) {
            let layer = Image {
                values: self.layer(number, &mut room),
                height: self.height,
                width: self.width,
            };
            resized.clear();
            layer.resized(height, width, &mut resized);
            for ((known, greatest), value) in labels.iter_mut().zip(&mut greatest).zip(&resized) {
                if *value > *greatest {
                    (*known, *greatest) = (label, *value);
                }
            }
        }
        labels
    }
}

/// Number and size of an output's layers.
#[derive(Debug, Clone, Copy)]
struct Shape {
    layers: usize,
    height: usize,
    width: usize,
    /// Whether the first layer is the background.
    has_background: bool,
}

impl Shape {
    /// Reads the shape of an output for an input of `height` x `width` pixels.
    fn new(shape: &[usize], height: usize, width: usize) -> Result<Self> {
        let found = match *shape {
            [masks, height, width] | [masks, 1, height, width] => Self {
                layers: masks,
                height,
                width,
                has_background: false,
            },
            [1, classes, height, width] => Self {
                layers: classes,
                height,
                width,
                has_background: true,
            },
            _ => bail!("must have the shape 1 x K x h x w or N x h x w, but has {shape:?}"),
        };
        ensure!(
            found.height > 0 && found.width > 0 || found.layers == 0,
            "has no pixels: its shape is {shape:?}"
        );
        // Otherwise rows, columns and classes would be taken for each other, and the segments would mean nothing.
        let is_picture = |h: usize, w: usize| is_proportional((h, w), (height, width));
        if !is_picture(found.height, found.width) {
            let channels_last = match *shape {
                [1, h, w, _] | [h, w, _] => is_picture(h, w),
                _ => false,
            };
            ensure!(
                !channels_last,
                "has the shape {shape:?} for {height} rows and {width} columns: export channels before rows and columns"
            );
            ensure!(
                !is_picture(found.width, found.height),
                "has the shape {shape:?} for {height} rows and {width} columns: export rows before columns"
            );
        }
        Ok(found)
    }

    const fn of_layers(self, values: Vec<f32>, is_float: bool) -> Output {
        Output {
            values: Values::Layers { values, is_float },
            layers: self.layers,
            height: self.height,
            width: self.width,
            has_background: self.has_background,
        }
    }
}

/// Returns whether a size is a multiple or a fraction of the size of `other`, to a pixel of either.
fn is_proportional(size: (usize, usize), other: (usize, usize)) -> bool {
    let crossed = (
        size.0.saturating_mul(other.1),
        size.1.saturating_mul(other.0),
    );
    let pixel = size.0.max(size.1).max(other.0).max(other.1);
    size.0 > 0 && size.1 > 0 && crossed.0.abs_diff(crossed.1) <= pixel
}
