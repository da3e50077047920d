//! DVXplorer with its sensor behind MIPI (DVXplorer Mini and others): Cypress CX3, SuperSpeed.
//!
//! It has the USB identity of the DVXplorer, with major number 4 in its release. Its firmware configures the
//! sensor, and there is no multiplexer: the sensor's mode alone starts and stops the stream; from firmware 10 on, the
//! readout does.

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
    DVS_ORIENTATION, DVS_RUN, ENDPOINT, IMU_ACCELEROMETER_RUN, IMU_GYROSCOPE_RUN,
    IMU_TEMPERATURE_RUN, Register, VENDOR, are_long, clear_all, read, write_all,
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

/// Returns the registers that make a camera with this `bcdDevice` send.
fn runs(release: u16) -> &'static [Register] {
    // Firmware 10 and later has the sensor to itself.
    let first = usize::from(are_long(release));
    RUNS.get(first..).unwrap_or_default()
}

/// Readout of the whole sensor by firmware 10 and later: the fastest, contrast thresholds in the middle, data at least
/// every 2,000 us.
const READOUT: [(Register, u32); 11] = [
    ((1, 13), 8),
    ((1, 14), 9),
    ((1, 15), 9),
    ((1, 4), 0),
    ((1, 5), 0),
    ((1, 6), 0),
    ((1, 8), 1),
    ((1, 9), 0),
    ((1, 10), 0),
    ((1, 11), 1),
    ((1, 12), 2000),
];

/// Whether firmware 10 and later mirrors columns or rows; such a camera's orientation holds the letters X and Y for those
/// that it must.
const FLIP_COLUMNS: Register = (1, 24);
const FLIP_ROWS: Register = (1, 25);
/// Applies the settings of the readout's region.
const CROP_APPLY: Register = (1, 23);

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
        let found = found(NAME, &VERSIONS, runs(control.release()), control)?;
        Ok(Info {
            name: format!("{} MIPI", found.chip.map_or("DVXplorer", label)),
            serial: control.serial(),
            firmware: found.firmware,
            sensor: found.sensor,
            stream: NAME,
        })
    }

    fn start(&self, _: &Info, control: &mut dyn Control) -> Result<()> {
        if are_long(control.release()) {
            let flips = read(control, DVS_ORIENTATION)?;
            write_all(control, &READOUT)?;
            let start = [
                (
                    FLIP_COLUMNS,
                    u32::from(flips >> 8 & 0xFF == u32::from(b'X')),
                ),
                (FLIP_ROWS, u32::from(flips & 0xFF == u32::from(b'Y'))),
                (CROP_APPLY, 0),
                (DVS_RUN, 1),
            ];
            return write_all(control, &start);
        }
        let events = [
            (SENSOR_RESTART, 2),
            (SENSOR_TIME_RESET, 1),
            (SENSOR_TIME_RESET, 0),
            (SENSOR_MODE, MODE_STREAM),
        ];
        write_all(control, &events)
    }

    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        let runs = runs(control.release());
        clear_all(control, runs).with_context(|| format!("{} cannot be stopped", info.name))
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
