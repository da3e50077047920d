//! DVXplorer (640 x 480) and DVXplorer Lite (320 x 240): Cypress FX3 with logic, SuperSpeed.
//!
//! The registers are those of [`inivation`](super::inivation); the sensor's own are module 5. The size is read from
//! the camera: a simulated camera may report any size up to 640 x 480, and is a Lite if the size fits a Lite. Only
//! events are requested. The variant whose sensor is behind MIPI has another stream:
//! [`dvxplorer_mipi`](super::dvxplorer_mipi).

pub mod camera;
pub mod parse;
mod sensor_registers;
pub mod write;

use std::time::Duration;

use anyhow::{Context, Result};
use eecvs_nostd::Sensor;

use self::parse::DvxplorerParser;
use self::sensor_registers::SENSOR_REGISTERS;
use self::write::DvxplorerWriter;
use super::inivation::registers::{
    DVS_RUN, ENDPOINT, IMU_ACCELEROMETER_RUN, IMU_GYROSCOPE_RUN, IMU_TEMPERATURE_RUN, INPUT_RUN,
    MUX_CHIP_RUN, MUX_DROP_EVENTS, MUX_DROP_INPUTS, MUX_RUN, MUX_TIME_RUN, Register, USB_RUN,
    VENDOR, clear_all, end_transfers_early, write, write_all,
};
use super::inivation::system::{Versions, found};
use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::Control;
use crate::peripheral::Peripheral;

/// Name of the model.
pub const NAME: &str = "dvxplorer";

/// Size of the sensor.
pub const SENSOR: Sensor = Sensor {
    width: 640,
    height: 480,
};

/// Size of the Lite's sensor.
pub const SENSOR_LITE: Sensor = Sensor {
    width: 320,
    height: 240,
};

/// The DVXplorer and DVXplorer Lite.
pub struct Dvxplorer;

/// USB product ID of every variant.
pub(super) const PRODUCT: u16 = 0x8419;

/// Numbers of the chips.
pub(super) const CHIP_FULL: u32 = 20;
pub(super) const CHIP_LITE: u32 = 19;

/// Oldest versions whose stream is known.
pub(super) const VERSIONS: Versions = Versions {
    firmware_min: 8,
    patch_min: 2,
};

/// Mode of the sensor: 0 off, 2 streaming.
pub(super) const SENSOR_MODE: Register = (5, 0x3000);
pub(super) const MODE_STREAM: u32 = 2;

/// Resets the sensor's own time: write 1, then 0.
pub(super) const SENSOR_TIME_RESET: Register = (5, 0x3238);

/// Registers that make the camera send, from the sensor to the host, in the order in which they are cleared.
const RUNS: [Register; 10] = [
    SENSOR_MODE,
    DVS_RUN,
    IMU_ACCELEROMETER_RUN,
    IMU_GYROSCOPE_RUN,
    IMU_TEMPERATURE_RUN,
    INPUT_RUN,
    MUX_RUN,
    MUX_TIME_RUN,
    USB_RUN,
    MUX_CHIP_RUN,
];

/// Names of the streams; in the second, the logic exchanges columns and rows.
const STREAM: &str = "dvxplorer";
const STREAM_INVERTED: &str = "dvxplorer-transposed";

/// Time in which the sensor wakes.
const SHORT: Duration = Duration::from_millis(10);

/// Time in which the path to the host becomes ready.
const READY: Duration = Duration::from_millis(50);

/// Returns the camera's name for people, by the number of its chip.
pub(super) const fn label(chip: u32) -> &'static str {
    match chip {
        CHIP_LITE => "DVXplorer Lite",
        _ => "DVXplorer",
    }
}

/// Returns whether events of this sensor fit the larger chip.
pub(super) const fn fits(sensor: Sensor) -> bool {
    sensor.width <= SENSOR.width && sensor.height <= SENSOR.height
}

impl Model for Dvxplorer {
    fn name(&self) -> &'static str {
        NAME
    }

    fn identities(&self) -> &'static [Identity] {
        &[Identity {
            vendor: VENDOR,
            product: PRODUCT,
            major: None,
        }]
    }

    fn streams(&self) -> &'static [&'static str] {
        &[STREAM, STREAM_INVERTED]
    }

    fn transfers(&self) -> Transfers {
        Transfers {
            endpoint: ENDPOINT,
            interface: 0,
            count: 16,
            bytes: 1 << 16,
            timeout: Duration::from_millis(100),
        }
    }

    fn identify(&self, control: &mut dyn Control) -> Result<Info> {
        let found = found(NAME, &VERSIONS, &RUNS, control)?;
        let inverted = found.inverted;
        Ok(Info {
            name: found.chip.map_or("DVXplorer", label).into(),
            serial: control.serial(),
            firmware: found.firmware,
            sensor: found.sensor,
            stream: if inverted { STREAM_INVERTED } else { STREAM },
        })
    }

    fn start(&self, _: &Info, control: &mut dyn Control) -> Result<()> {
        write(control, MUX_CHIP_RUN, 1)?;
        control.wait(SHORT);
        write_all(control, &SENSOR_REGISTERS)?;
        end_transfers_early(control)?;
        let stream = [
            (MUX_DROP_INPUTS, 1),
            (MUX_DROP_EVENTS, 0),
            (USB_RUN, 1),
            (MUX_TIME_RUN, 1),
            (MUX_RUN, 1),
        ];
        write_all(control, &stream)?;
        control.wait(READY);
        let events = [
            (DVS_RUN, 1),
            (SENSOR_TIME_RESET, 1),
            (SENSOR_TIME_RESET, 0),
            (SENSOR_MODE, MODE_STREAM),
        ];
        write_all(control, &events)
    }

    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        clear_all(control, &RUNS).with_context(|| format!("{} cannot be stopped", info.name))
    }

    fn parser(&self, info: &Info) -> Box<dyn Parse> {
        let inverted = info.stream == STREAM_INVERTED;
        Box::new(DvxplorerParser::begin(info.sensor, inverted))
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        fits(sensor).then(|| Box::new(DvxplorerWriter::new(sensor)) as _)
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        fits(sensor).then(|| Box::new(camera::camera(sensor, stream)) as _)
    }
}
