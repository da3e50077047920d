//! A simulated DVXplorer camera.

use eecvs_nostd::Sensor;

use super::{CHIP_FULL, CHIP_LITE, MODE_STREAM, PRODUCT, SENSOR_LITE, SENSOR_MODE, label};
use crate::device::Stream;
use crate::device::inivation::camera::{LogicCamera, messages};
use crate::device::inivation::registers::{
    CHIP, CLOCK_DEVIATION, DEBUG_ENDPOINT, DVS_COLUMNS, DVS_ORIENTATION, DVS_ROWS, DVS_RUN,
    ENDPOINT, IS_MASTER, LOGIC_CLOCK, LOGIC_KNOWN, LOGIC_PATCH, LOGIC_VERSION, MUX_CHIP_RUN,
    MUX_RUN, MUX_TIME_RUN, RegisterFile, USB_CLOCK, USB_RUN, VENDOR, are_long,
};
use crate::peripheral::Speed;
use crate::peripheral::descriptors::Endpoint;

/// Release of the FX3 variant with firmware 9, the only ones that some hosts accept.
const RELEASE: u16 = 0x0309;

/// Returns a camera with a sensor of this size, as just plugged in.
pub(super) fn camera(sensor: Sensor, stream: Box<dyn Stream>) -> LogicCamera {
    let runs = |registers: &RegisterFile| {
        registers.all_set(&[USB_RUN, MUX_RUN, MUX_TIME_RUN, MUX_CHIP_RUN, DVS_RUN])
            && registers.get(SENSOR_MODE) == MODE_STREAM
    };
    of_release(RELEASE, sensor, stream, runs)
}

/// Returns a camera with this `bcdDevice`; it sends while `runs` returns true.
pub(in crate::device) fn of_release(
    release: u16,
    sensor: Sensor,
    stream: Box<dyn Stream>,
    runs: fn(&RegisterFile) -> bool,
) -> LogicCamera {
    let lite = sensor.width <= SENSOR_LITE.width && sensor.height <= SENSOR_LITE.height;
    let chip = if lite { CHIP_LITE } else { CHIP_FULL };
    let registers = RegisterFile::new(&[
        (DVS_COLUMNS, sensor.width.into()),
        (DVS_ROWS, sensor.height.into()),
        (DVS_ORIENTATION, 0),
        (LOGIC_VERSION, LOGIC_KNOWN),
        (LOGIC_PATCH, 4),
        (CHIP, chip),
        (LOGIC_CLOCK, 100),
        (USB_CLOCK, 80),
        (CLOCK_DEVIATION, 1000),
        (IS_MASTER, 1),
    ]);
    let registers = if are_long(release) {
        registers.with_long()
    } else {
        registers
    };
    LogicCamera::new(
        Speed::Super,
        (VENDOR, PRODUCT, release),
        label(chip),
        &[Endpoint::bulk(ENDPOINT), messages(DEBUG_ENDPOINT)],
        registers,
        runs,
        stream,
    )
}
