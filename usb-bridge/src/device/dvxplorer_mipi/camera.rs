//! A simulated DVXplorer with its sensor behind MIPI.

use eecvs_nostd::Sensor;

use crate::device::Stream;
use crate::device::dvxplorer::camera::of_release;
use crate::device::dvxplorer::{MODE_STREAM, SENSOR_MODE};
use crate::device::inivation::camera::LogicCamera;
use crate::device::inivation::registers::{DVS_RUN, RegisterFile};

/// Major number 4 with firmware 10, the only one that some hosts accept.
const RELEASE: u16 = 0x040A;

/// Returns a camera with a sensor of this size, as just plugged in.
pub(super) fn camera(sensor: Sensor, stream: Box<dyn Stream>) -> LogicCamera {
    // Hosts of older firmware start the sensor, those of the newer the readout.
    let runs = |registers: &RegisterFile| {
        registers.get(SENSOR_MODE) == MODE_STREAM || registers.get(DVS_RUN) != 0
    };
    of_release(RELEASE, sensor, stream, runs)
}
