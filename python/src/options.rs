//! The options of an encoder, from keywords: those of `eecvs encode`.

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;

use eecvs::encode::options::{CoderName, EncodeOptions, ModeName, TransformChoice};
use eecvs::encode::{Limits, all_cores};
use eecvs::thresholds_file::ThresholdsFile;
use eecvs_nostd::window::EVENTS_MAX;
use eecvs_nostd::{FRAME_BYTES_MAX, Kernel, OUTPUT_BYTES_MIN, Region, Sensor, Transform};
use event_types::stream::Result;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::number;

/// Everything that can be asked of an encoder.
pub struct Asked {
    /// Options of the codec.
    pub encode: EncodeOptions,
    /// Limits of windows and frames.
    pub limits: Limits,
    /// Kernel of the DCT and the DTFT.
    pub kernel: Kernel,
    /// Whether a readout is looked for.
    pub scans: bool,
    /// Whether the duration of windows is chosen.
    pub auto_window: bool,
    /// Number of encoding threads.
    pub threads: NonZeroUsize,
    /// Whether events that came too late are a warning in place of an exception.
    pub allow_loss: bool,
    /// Whether events are sorted first.
    pub sort: bool,
    hot: Hot,
}

/// Pixels that are never sent.
enum Hot {
    Pixels(Vec<(u16, u16)>),
    File(PathBuf),
}

/// A keyword and its setter.
type Setter = fn(&mut Asked, &Bound<'_, PyAny>) -> PyResult<()>;

const SETTERS: &[(&str, Setter)] = &[
    ("mode", |asked, value| {
        let modes = [
            ("hybrid", ModeName::Hybrid),
            ("transform", ModeName::Transform),
        ];
        asked.encode.mode = name(value, &modes)?;
        Ok(())
    }),
    ("time_tolerance_us", |asked, value| {
        set(&mut asked.encode.time_tolerance_us, value)
    }),
    ("bins", |asked, value| set(&mut asked.encode.bins, value)),
    ("max_emd_us", |asked, value| {
        positive(&mut asked.encode.max_emd_us, value)
    }),
    ("max_nmse", |asked, value| {
        set(&mut asked.encode.max_nmse, value)
    }),
    ("coder", |asked, value| {
        let coders = [
            ("plain", CoderName::Plain),
            ("fast", CoderName::Fast),
            ("quick", CoderName::Quick),
            ("dense", CoderName::Dense),
        ];
        asked.encode.coder = Some(name(value, &coders)?);
        Ok(())
    }),
    ("effort", |asked, value| {
        set(&mut asked.encode.effort, value)
    }),
    ("key_windows", |asked, value| {
        set(&mut asked.encode.key_windows, value)
    }),
    ("key_us", |asked, value| {
        positive(&mut asked.encode.key_us, value)
    }),
    ("scans", |asked, value| {
        asked.scans = name(value, &[("auto", true), ("off", false)])?;
        Ok(())
    }),
    ("region", |asked, value| {
        let parts: [Bound<'_, PyAny>; 4] = value.extract()?;
        let [x, y, width, height] = &parts;
        asked.encode.region = Some(Region {
            x: number::named(x, "x", 0..=Sensor::SIDE_MAX - 1)?,
            y: number::named(y, "y", 0..=Sensor::SIDE_MAX - 1)?,
            width: number::named(width, "the width", 1..=Sensor::SIDE_MAX)?,
            height: number::named(height, "the height", 1..=Sensor::SIDE_MAX)?,
        });
        Ok(())
    }),
    ("hot_pixels", |asked, value| {
        asked.hot = if value.is_instance_of::<PyString>() || value.hasattr("__fspath__")? {
            Hot::File(value.extract()?)
        } else {
            let pixels = value
                .try_iter()?
                .map(|pixel| {
                    let place: [Bound<'_, PyAny>; 2] = pixel?.extract()?;
                    let [x, y] = &place;
                    Ok((
                        number::named(x, "x", 0..=Sensor::SIDE_MAX - 1)?,
                        number::named(y, "y", 0..=Sensor::SIDE_MAX - 1)?,
                    ))
                })
                .collect::<PyResult<_>>();
            Hot::Pixels(pixels?)
        };
        Ok(())
    }),
    ("isolated", |asked, value| {
        set(&mut asked.encode.isolated, value)
    }),
    ("keep_order", |asked, value| {
        set(&mut asked.encode.keep_order, value)
    }),
    ("bytes_per_second", |asked, value| {
        positive(&mut asked.encode.bytes_per_second, value)
    }),
    ("transform", |asked, value| {
        let transforms = [
            ("auto", TransformChoice::Auto),
            ("best", TransformChoice::Best),
            ("dct", TransformChoice::Only(Transform::Dct)),
            ("dtft", TransformChoice::Only(Transform::Dtft)),
            ("dwt", TransformChoice::Only(Transform::Dwt)),
        ];
        asked.encode.transform = name(value, &transforms)?;
        Ok(())
    }),
    ("few_as_times", |asked, value| {
        set(&mut asked.encode.few_as_times, value)
    }),
    ("m", |asked, value| set(&mut asked.encode.m, value)),
    ("grid", |asked, value| set(&mut asked.encode.grid, value)),
    ("step_log2", |asked, value| {
        set(&mut asked.encode.step_log2, value)
    }),
    ("max_error", |asked, value| {
        set(&mut asked.encode.max_error, value)
    }),
    ("window_us", |asked, value| {
        asked.encode.window_us = positive_number(value)?;
        Ok(())
    }),
    ("origin_us", |asked, value| {
        set(&mut asked.encode.origin_us, value)
    }),
    ("every_window", |asked, value| {
        set(&mut asked.encode.every_window, value)
    }),
    ("thresholds", |asked, value| {
        let path: PathBuf = value.extract()?;
        let read = ThresholdsFile::read(&path).and_then(|file| file.thresholds());
        let name = path.display().to_string();
        let read =
            read.map_err(|error| crate::errors::exception(value.py(), &error, Some(&name)))?;
        asked.encode.thresholds = Some(read);
        Ok(())
    }),
    ("auto_window", |asked, value| {
        set(&mut asked.auto_window, value)
    }),
    ("kernel", |asked, value| {
        let kernels = [
            ("table", Kernel::Table),
            ("recurrence", Kernel::Recurrence),
            ("precise", Kernel::Precise),
            ("micromath", Kernel::Micromath),
            ("libm", Kernel::Libm),
        ];
        asked.kernel = name(value, &kernels)?;
        Ok(())
    }),
    ("window_events", |asked, value| {
        asked.limits.window_events = number::within(value, 1..=EVENTS_MAX)?;
        Ok(())
    }),
    ("frame_bytes", |asked, value| {
        asked.limits.frame_bytes = number::within(value, OUTPUT_BYTES_MIN..=FRAME_BYTES_MAX)?;
        Ok(())
    }),
    ("reorder_us", |asked, value| {
        set(&mut asked.limits.reorder_us, value)
    }),
    ("threads", |asked, value| {
        asked.threads =
            NonZeroUsize::new(number::within(value, 1..=1024)?).unwrap_or(NonZeroUsize::MIN);
        Ok(())
    }),
    ("allow_loss", |asked, value| {
        set(&mut asked.allow_loss, value)
    }),
    ("sort", |asked, value| set(&mut asked.sort, value)),
];

/// A value of an option.
trait Value: Sized {
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self>;
}

macro_rules! whole_numbers {
    ($($number:ty)*) => {$(
        impl Value for $number {
            fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
                number::within(value, Self::MIN..=Self::MAX)
            }
        }
    )*};
}

whole_numbers!(i8 u8 u16 u32 u64);

impl Value for f64 {
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        number::real(value)
    }
}

impl Value for bool {
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        value.extract()
    }
}

impl<T: Value> Value for Option<T> {
    fn of(value: &Bound<'_, PyAny>) -> PyResult<Self> {
        T::of(value).map(Some)
    }
}

fn set<T: Value>(slot: &mut T, value: &Bound<'_, PyAny>) -> PyResult<()> {
    *slot = T::of(value)?;
    Ok(())
}

fn positive(slot: &mut Option<NonZeroU32>, value: &Bound<'_, PyAny>) -> PyResult<()> {
    *slot = Some(positive_number(value)?);
    Ok(())
}

fn positive_number(value: &Bound<'_, PyAny>) -> PyResult<NonZeroU32> {
    let number = number::within(value, 1..=u32::MAX)?;
    Ok(NonZeroU32::new(number).unwrap_or(NonZeroU32::MIN))
}

fn name<T: Copy>(value: &Bound<'_, PyAny>, names: &[(&str, T)]) -> PyResult<T> {
    let text: String = value.extract()?;
    let found = names.iter().find(|(name, _)| *name == text);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
        PyValueError::new_err(format!("{text:?}: it must be one of {}", names.join(", ")))
    })
}

impl Asked {
    /// Takes keywords; a value of None is the default.
    ///
    /// # Errors
    /// `TypeError` for a keyword that is not known or of the wrong type, `ValueError` for a value out of range.
    pub fn of(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut asked = Self {
            encode: EncodeOptions::default(),
            limits: Limits::default(),
            kernel: Kernel::Table,
            scans: true,
            auto_window: false,
            threads: all_cores(),
            allow_loss: false,
            sort: false,
            hot: Hot::Pixels(Vec::new()),
        };
        for (keyword, value) in keywords.into_iter().flatten() {
            let keyword: String = keyword.extract()?;
            let setter = SETTERS.iter().find(|(name, _)| *name == keyword);
            let (_, setter) = setter.ok_or_else(|| {
                PyTypeError::new_err(format!("an encoder has no option {keyword:?}"))
            })?;
            if !value.is_none() {
                setter(&mut asked, &value).map_err(|error| named(value.py(), &keyword, &error))?;
            }
        }
        if keywords.is_some_and(|keywords| {
            keywords.contains("key_us").unwrap_or(false)
                && keywords.contains("key_windows").unwrap_or(false)
        }) {
            return Err(PyValueError::new_err(
                "key_us= and key_windows= exclude each other",
            ));
        }
        Ok(asked)
    }

    /// Returns the pixels that are never sent.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn hot(&self, sensor: Sensor) -> Result<Vec<(u16, u16)>> {
        match &self.hot {
            Hot::Pixels(pixels) => Ok(pixels.clone()),
            Hot::File(path) => eecvs::hot_pixels::read(path, sensor),
        }
    }
}

/// Puts the keyword before an exception's text.
fn named(py: Python<'_>, keyword: &str, error: &PyErr) -> PyErr {
    let text = format!("{keyword}: {}", error.value(py));
    if error.is_instance_of::<PyTypeError>(py) {
        PyTypeError::new_err(text)
    } else if error.get_type(py).is(py.get_type::<PyValueError>()) {
        PyValueError::new_err(text)
    } else {
        error.clone_ref(py)
    }
}
