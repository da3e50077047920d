//! DVXplorer with its sensor behind MIPI (DVXplorer Mini and others): Cypress CX3, SuperSpeed.
//!
//! It has the USB identity of the DVXplorer, with major number 4 in its release. Its firmware configures the
//! sensor, and there is no multiplexer: the sensor's mode alone starts and stops the stream.

pub mod camera;
pub mod parse;
pub mod write;

use std::time::Duration;

use anyhow::{Context, Result};
use eecvs_nostd::Sensor;

use self::parse::MipiParser;
use self::write::MipiWriter;
use super::dvxplorer::{
    MODE_STREAM, PRODUCT, SENSOR_MODE, SENSOR_TIME_RESET, VERSIONS, fits, label,
};
use super::inivation::registers::{
    DVS_RUN, ENDPOINT, IMU_ACCELEROMETER_RUN, IMU_GYROSCOPE_RUN, IMU_TEMPERATURE_RUN, Register,
    VENDOR, clear_all, write_all,
};
use super::inivation::system::found;
use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::Control;
use crate::peripheral::Peripheral;

/// Name of the model.
pub const NAME: &str = "dvxplorer-mipi";

/// The DVXplorer with its sensor behind MIPI.
pub struct DvxplorerMipi;

/// Major number of its release.
const MAJOR: u8 = 4;

/// Registers that make the camera send, in the order in which they are cleared.
const RUNS: [Register; 5] = [
    SENSOR_MODE,
    DVS_RUN,
    IMU_ACCELEROMETER_RUN,
    IMU_GYROSCOPE_RUN,
    IMU_TEMPERATURE_RUN,
];

/// Restarts the counter of the sensor's time.
const SENSOR_RESTART: Register = (5, 0x3201);

impl Model for DvxplorerMipi {
    fn name(&self) -> &'static str {
        NAME
    }

    fn identities(&self) -> &'static [Identity] {
        &[Identity {
            vendor: VENDOR,
            product: PRODUCT,
            major: Some(MAJOR),
        }]
    }

    fn streams(&self) -> &'static [&'static str] {
        &[NAME]
    }

    fn transfers(&self) -> Transfers {
        Transfers {
            endpoint: ENDPOINT,
            interface: 0,
            count: 16,
            bytes: 8192,
            timeout: Duration::from_millis(100),
        }
    }

    fn identify(&self, control: &mut dyn Control) -> Result<Info> {
        let found = found(NAME, &VERSIONS, &RUNS, control)?;
        Ok(Info {
            name: format!("{} MIPI", label(found.chip)),
            serial: control.serial(),
            firmware: found.firmware,
            sensor: found.sensor,
            stream: NAME,
        })
    }

    fn start(&self, _: &Info, control: &mut dyn Control) -> Result<()> {
        let events = [
            (SENSOR_RESTART, 2),
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
        Box::new(MipiParser::begin(info.sensor))
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        fits(sensor).then(|| Box::new(MipiWriter::new(sensor)) as _)
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        fits(sensor).then(|| Box::new(camera::camera(sensor, stream)) as _)
    }
}
