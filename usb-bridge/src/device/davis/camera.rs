//! A simulated DAVIS camera.

use eecvs_nostd::Sensor;

use super::Davis;
use crate::device::Stream;
use crate::device::inivation::camera::{LogicCamera, messages};
use crate::device::inivation::registers::{
    ADC_CLOCK, CHIP, CLOCK_DEVIATION, DEBUG_ENDPOINT, DVS_COLUMNS, DVS_ORIENTATION, DVS_ROWS,
    DVS_RUN, ENDPOINT, LOGIC_CLOCK, LOGIC_KNOWN, LOGIC_PATCH, LOGIC_VERSION, MUX_CHIP_RUN, MUX_RUN,
    MUX_TIME_RUN, RegisterFile, USB_CLOCK, USB_RUN, VENDOR,
};
use crate::peripheral::Speed;
use crate::peripheral::descriptors::Endpoint;

/// Returns a camera of this model with a sensor of this size, as just plugged in.
pub(super) fn camera(davis: &Davis, sensor: Sensor, stream: Box<dyn Stream>) -> LogicCamera {
    let is_super = davis.speed == Speed::Super;
    let registers = RegisterFile::new(&[
        (DVS_COLUMNS, sensor.width.into()),
        (DVS_ROWS, sensor.height.into()),
        (DVS_ORIENTATION, 0),
        (LOGIC_VERSION, LOGIC_KNOWN),
        (LOGIC_PATCH, davis.versions.patch_min),
        (CHIP, davis.chip),
        (LOGIC_CLOCK, 90),
        (ADC_CLOCK, 30),
        (USB_CLOCK, if is_super { 80 } else { 30 }),
        (CLOCK_DEVIATION, 1000),
    ]);
    let endpoints = [Endpoint::bulk(ENDPOINT), messages(DEBUG_ENDPOINT)];
    LogicCamera::new(
        davis.speed,
        (
            VENDOR,
            davis.identities[0].product,
            davis.versions.firmware_min,
        ),
        davis.label,
        if is_super {
            &endpoints
        } else {
            &endpoints[..1]
        },
        registers,
        |registers| registers.all_set(&[USB_RUN, MUX_RUN, MUX_TIME_RUN, MUX_CHIP_RUN, DVS_RUN]),
        stream,
    )
}
