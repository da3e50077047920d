//! A simulated DAVIS camera.
//!
//! It sends events alone: hosts that ask for frames and inertial samples find the registers that these need, and get
//! none. The filters of the logic, which the larger camera has, can be set and change nothing.

use eecvs_nostd::Sensor;

use super::Davis;
use crate::device::Stream;
use crate::device::inivation::camera::{LogicCamera, messages};
use crate::device::inivation::registers::{
    ADC_CLOCK, APS_COLUMNS, APS_HAS_GLOBAL_SHUTTER, APS_ORIENTATION, APS_ROWS, CHIP,
    CLOCK_DEVIATION, DEBUG_ENDPOINT, DVS_COLUMNS, DVS_HAS_BACKGROUND_FILTER, DVS_HAS_PIXEL_FILTER,
    DVS_HAS_POLARITY_FILTER, DVS_HAS_REGION_FILTER, DVS_HAS_SKIP_FILTER, DVS_ORIENTATION, DVS_ROWS,
    DVS_RUN, ENDPOINT, IMU_KIND, IS_MASTER, LOGIC_CLOCK, LOGIC_KNOWN, LOGIC_PATCH, LOGIC_VERSION,
    MUX_CHIP_RUN, MUX_RUN, MUX_TIME_RUN, RegisterFile, USB_CLOCK, USB_RUN, VENDOR,
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
        (DVS_HAS_PIXEL_FILTER, is_super.into()),
        (DVS_HAS_BACKGROUND_FILTER, is_super.into()),
        (DVS_HAS_REGION_FILTER, is_super.into()),
        (DVS_HAS_SKIP_FILTER, is_super.into()),
        (DVS_HAS_POLARITY_FILTER, is_super.into()),
        (APS_COLUMNS, sensor.width.into()),
        (APS_ROWS, sensor.height.into()),
        (APS_ORIENTATION, 0),
        (APS_HAS_GLOBAL_SHUTTER, 1),
        (IMU_KIND, if is_super { 2 } else { 1 }),
        (IS_MASTER, 1),
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
