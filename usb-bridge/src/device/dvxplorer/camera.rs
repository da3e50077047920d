//! A simulated DVXplorer camera.

use eecvs_nostd::Sensor;

use super::{
    CHIP_FULL, CHIP_LITE, MODE_STREAM, PRODUCT, SENSOR_LITE, SENSOR_MODE, VERSIONS, label,
};
use crate::device::Stream;
use crate::device::inivation::camera::{LogicCamera, messages};
use crate::device::inivation::registers::{
    CHIP, CLOCK_DEVIATION, DEBUG_ENDPOINT, DVS_COLUMNS, DVS_ORIENTATION, DVS_ROWS, DVS_RUN,
    ENDPOINT, LOGIC_CLOCK, LOGIC_KNOWN, LOGIC_PATCH, LOGIC_VERSION, MUX_CHIP_RUN, MUX_RUN,
    MUX_TIME_RUN, RegisterFile, USB_CLOCK, USB_RUN, VENDOR,
};
use crate::peripheral::Speed;
use crate::peripheral::descriptors::Endpoint;

/// Returns a camera with a sensor of this size, as just plugged in.
pub(super) fn camera(sensor: Sensor, stream: Box<dyn Stream>) -> LogicCamera {
    let runs = |registers: &RegisterFile| {
        registers.all_set(&[USB_RUN, MUX_RUN, MUX_TIME_RUN, MUX_CHIP_RUN, DVS_RUN])
            && registers.get(SENSOR_MODE) == MODE_STREAM
    };
    of_release(0, sensor, stream, runs)
}

/// Returns a camera whose release has this major number; it sends while `runs` returns true.
pub(in crate::device) fn of_release(
    major: u8,
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
    ]);
    LogicCamera::new(
        Speed::Super,
        (
            VENDOR,
            PRODUCT,
            u16::from(major) << 8 | (VERSIONS.firmware_min + 1),
        ),
        label(chip),
        &[Endpoint::bulk(ENDPOINT), messages(DEBUG_ENDPOINT)],
        registers,
        runs,
        stream,
    )
}
