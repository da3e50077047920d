//! Scenes of the emulator, as recordings.

use event_emulator::{Effect, Model, PRESETS, PixelParameters, Preset, SceneConfig, SceneTruth};
use event_types::stream::Result;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::errors::exception;
use crate::given::Size;
use crate::layout::Layout;
use crate::number;
use crate::recording::{Origin, Recording, Reopen, Source};
use crate::window::not_one_of;

/// Emulates a seeded scene: the same events on every machine and with any number of threads.
///
/// Args:
///     scene: One of ``SCENES``.
///     seed: Seed of the texture, of the pixels and of the noise.
///     sensor: (width, height) in pixels; by default the scene's, 346 x 260.
///     duration_us: Duration in microseconds; by default the scene's, 1,000,000.
///     start_us: Time of the start in microseconds.
///     model: 2: light sampled as finely as it changes, and a parameter for each effect of the pixel; or 1: light in
///         steps of 1 ms, and events that no version changes.
///     pixel: Parameters of model 2 by their names, as in the file that ``eecvs emulate --print-pixel`` prints.
///     without: Effects of model 2 that are switched off: ``"shot-noise"``, ``"leak"``, ``"refractory"``, ...
///     dtype: Layout of the arrays, as for ``open``.
///
/// Returns:
///     A Recording, which is emulated anew whenever it is read; ``causes()`` is the truth about its noise in model 2,
///     ``truth()`` that about its objects and their motion.
///
/// Raises:
///     RefusedError: A scene that cannot exist; a parameter that is out of range.
#[pyfunction]
#[pyo3(signature = (
    scene, *, seed=1, sensor=None, duration_us=None, start_us=0, model=2, pixel=None, without=None, dtype=None
))]
#[allow(clippy::too_many_arguments)]
pub fn emulate(
    py: Python<'_>,
    scene: &str,
    #[pyo3(from_py_with = number::seed)] seed: u64,
    sensor: Option<Size>,
    #[pyo3(from_py_with = number::duration_us)] duration_us: Option<u64>,
    #[pyo3(from_py_with = number::start_us)] start_us: u64,
    #[pyo3(from_py_with = number::model)] model: u8,
    pixel: Option<&Bound<'_, PyDict>>,
    without: Option<Vec<String>>,
    dtype: Option<&str>,
) -> PyResult<Recording> {
    let Some(preset) = PRESETS.into_iter().find(|preset| preset.name() == scene) else {
        let names = PRESETS.map(Preset::name).join(", ");
        return Err(not_one_of("scene", scene, &names));
    };
    let mut config = SceneConfig::new(preset, seed);
    if let Some(size) = sensor {
        config.sensor = size.0;
    }
    config.duration_us = duration_us.unwrap_or(config.duration_us);
    config.start_us = start_us;
    let end_us = start_us.checked_add(config.duration_us);
    if end_us.is_none_or(|end_us| end_us > i64::MAX as u64) {
        return Err(PyValueError::new_err(
            "start_us + duration_us is beyond 2^63 - 1: arrays hold no such times",
        ));
    }
    config.model = if model == 1 {
        Model::Steps
    } else {
        Model::Physical
    };
    if config.model == Model::Steps && (pixel.is_some() || without.is_some()) {
        return Err(PyValueError::new_err(
            "model=1 has no pixel= and no without=",
        ));
    }
    let options = PyDict::new(py);
    options.set_item("seed", seed)?;
    let size = Size::of(sensor).map(|sensor| (sensor.width, sensor.height));
    options.set_item("sensor", size)?;
    options.set_item("duration_us", duration_us)?;
    options.set_item("start_us", start_us)?;
    options.set_item("model", model)?;
    options.set_item("pixel", pixel.map(PyDictMethods::copy).transpose()?)?;
    options.set_item("without", without.clone())?;
    options.set_item("dtype", dtype)?;
    let reopen = Reopen::new("emulate", scene, options)?;
    let source = Source {
        name: format!("scene {scene}"),
        stamp: None,
        origin: Origin::Scene {
            config,
            pixel: Box::new(parameters(py, pixel, without.unwrap_or_default())?),
        },
        sort: false,
        layout: Layout::of(dtype)?,
        keeps_damaged: false,
    };
    Recording::open(py, source, reopen)
}

/// Returns the parameters of a pixel: the defaults, without some effects, then with other values.
fn parameters(
    py: Python<'_>,
    pixel: Option<&Bound<'_, PyDict>>,
    without: Vec<String>,
) -> PyResult<PixelParameters> {
    let mut parameters = PixelParameters::default();
    for name in without {
        let effect = Effect::ALL.into_iter().find(|effect| effect.name() == name);
        let Some(effect) = effect else {
            let names = Effect::ALL.map(Effect::name).join(", ");
            return Err(not_one_of("without", &name, &names));
        };
        parameters.switch_off(effect);
    }
    for (name, value) in pixel.into_iter().flatten() {
        let name = name.extract::<String>()?;
        let value = number::real(&value).map_err(|error| number::name(&value, &name, &error))?;
        let set = parameters.set(&name, value);
        set.map_err(|error| exception(py, &error, None))?;
    }
    let checked = parameters.check();
    checked.map_err(|error| exception(py, &error, None))?;
    Ok(parameters)
}

/// Returns what is seen at each pixel of a scene at a time, as a `Truth`.
///
/// # Errors
/// The time is before the scene's beginning.
pub fn truth<'py>(py: Python<'py>, config: &SceneConfig, t_us: u64) -> PyResult<Bound<'py, PyAny>> {
    let sides = [config.sensor.height, config.sensor.width].map(usize::from);
    let pixels = sides[0] * sides[1];
    let made = py.detach(|| -> Result<_> {
        let truth = SceneTruth::new(config)?;
        let (mut object, mut flow) = (vec![0_u8; pixels], vec![[0.0_f32; 2]; pixels]);
        truth.objects_at(t_us, &mut object)?;
        truth.flow_at(t_us, &mut flow)?;
        let mut depth = truth.has_depth().then(|| vec![0.0_f32; pixels]);
        if let Some(depth) = &mut depth {
            truth.depth_at(t_us, depth)?;
        }
        let objects = truth.objects();
        let names: Vec<&str> = objects.iter().map(|kind| kind.name()).collect();
        Ok((object, flow.into_flattened(), depth, names))
    });
    let (object, flow, depth, names) = made.map_err(|error| exception(py, &error, None))?;
    let object = PyArray1::from_vec(py, object).reshape(sides)?;
    let flow = PyArray1::from_vec(py, flow).reshape([sides[0], sides[1], 2])?;
    let depth = depth.map(|depth| PyArray1::from_vec(py, depth).reshape(sides));
    let class = py.import("eecvs._types")?.getattr("Truth")?;
    class.call1((object, flow, depth.transpose()?, PyTuple::new(py, names)?))
}

/// Returns the names and descriptions of the scenes.
#[pyfunction]
pub fn _scenes() -> Vec<(&'static str, &'static str)> {
    let scenes = PRESETS.iter();
    scenes
        .map(|preset| (preset.name(), preset.about()))
        .collect()
}
