//! A simulated DVXplorer with its sensor behind MIPI.

use eecvs_nostd::Sensor;

use super::MAJOR;
use crate::device::Stream;
use crate::device::dvxplorer::camera::of_release;
use crate::device::dvxplorer::{MODE_STREAM, SENSOR_MODE};
use crate::device::inivation::camera::LogicCamera;
use crate::device::inivation::registers::RegisterFile;

/// Returns a camera with a sensor of this size, as just plugged in.
pub(super) fn camera(sensor: Sensor, stream: Box<dyn Stream>) -> LogicCamera {
    let runs = |registers: &RegisterFile| registers.get(SENSOR_MODE) == MODE_STREAM;
    of_release(MAJOR, sensor, stream, runs)
}
