//! DAVIS240 (Cypress FX2, High speed) and DAVIS346 (FX3, SuperSpeed): two models with the same stream.
//!
//! The registers are those of [`inivation`](super::inivation). The sensor's size is read from the camera, so a
//! simulated camera may report any size up to its chip's. Only events are requested; frames, inertial samples and
//! external inputs stay off.

mod biases;
pub mod camera;
pub mod parse;
pub mod write;

use std::time::Duration;

use anyhow::{Context, Result};
use eecvs_nostd::Sensor;

use self::parse::DavisParser;
use self::write::DavisWriter;
use super::inivation::registers::{
    APS_RUN, DVS_RUN, ENDPOINT, IMU_ACCELEROMETER_RUN, IMU_GYROSCOPE_RUN, IMU_TEMPERATURE_RUN,
    INPUT_RUN, MUX_CHIP_RUN, MUX_DROP_EVENTS, MUX_DROP_INPUTS, MUX_RUN, MUX_TIME_RUN, Register,
    USB_RUN, VENDOR, clear_all, end_transfers_early, write, write_all,
};
use super::inivation::system::{Versions, found};
use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::Control;
use crate::peripheral::{Peripheral, Speed};

/// The DAVIS240, and other cameras with its logic.
pub static DAVIS240: Davis = Davis {
    name: "davis240",
    label: "DAVIS240",
    identities: &[identity(0x841B)],
    speed: Speed::High,
    chip: 2,
    sensor: Sensor {
        width: 240,
        height: 180,
    },
    versions: Versions {
        firmware_min: 4,
        patch_min: 1,
    },
};

/// The DAVIS346.
pub static DAVIS346: Davis = Davis {
    name: "davis346",
    label: "DAVIS346",
    identities: &[identity(0x841A)],
    speed: Speed::Super,
    chip: 5,
    sensor: Sensor {
        width: 346,
        height: 260,
    },
    versions: Versions {
        firmware_min: 6,
        patch_min: 1,
    },
};

/// One of the DAVIS cameras.
#[derive(Debug)]
pub struct Davis {
    name: &'static str,
    label: &'static str,
    identities: &'static [Identity],
    speed: Speed,
    /// Number of the chip that is simulated.
    chip: u32,
    /// Size of that chip.
    sensor: Sensor,
    versions: Versions,
}

const fn identity(product: u16) -> Identity {
    Identity {
        vendor: VENDOR,
        product,
        major: None,
    }
}

/// Registers that make the camera send, from the sensor to the host, in the order in which they are cleared.
const RUNS: [Register; 10] = [
    DVS_RUN,
    APS_RUN,
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
const STREAM: &str = "davis";
const STREAM_INVERTED: &str = "davis-transposed";

/// Time in which the sensor's biases settle.
const SETTLE: Duration = Duration::from_millis(200);

/// Time in which the path to the host becomes ready.
const READY: Duration = Duration::from_millis(50);

impl Davis {
    const fn fits(&self, sensor: Sensor) -> bool {
        sensor.width <= self.sensor.width && sensor.height <= self.sensor.height
    }
}

impl Model for Davis {
    fn name(&self) -> &'static str {
        self.name
    }

    fn identities(&self) -> &'static [Identity] {
        self.identities
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
        let found = found(self.name, &self.versions, &RUNS, control)?;
        let inverted = found.inverted;
        Ok(Info {
            name: found
                .chip
                .and_then(biases::chip_name)
                .map_or_else(|| self.label.into(), String::from),
            serial: control.serial(),
            firmware: found.firmware,
            sensor: found.sensor,
            stream: if inverted { STREAM_INVERTED } else { STREAM },
        })
    }

    fn start(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        write_all(control, biases::of(&info.name))?;
        write(control, MUX_CHIP_RUN, 1)?;
        control.wait(SETTLE);
        end_transfers_early(control)?;
        let stream = [
            (USB_RUN, 1),
            (MUX_DROP_EVENTS, 1),
            (MUX_DROP_INPUTS, 1),
            (MUX_TIME_RUN, 1),
            (MUX_RUN, 1),
        ];
        write_all(control, &stream)?;
        control.wait(READY);
        write(control, DVS_RUN, 1)
    }

    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        clear_all(control, &RUNS).with_context(|| format!("{} cannot be stopped", info.name))
    }

    fn parser(&self, info: &Info) -> Box<dyn Parse> {
        let inverted = info.stream == STREAM_INVERTED;
        Box::new(DavisParser::begin(info.sensor, inverted))
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        let writer = || Box::new(DavisWriter::new(self.name, sensor)) as _;
        self.fits(sensor).then(writer)
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        let camera = || Box::new(camera::camera(self, sensor, stream)) as _;
        self.fits(sensor).then(camera)
    }
}
