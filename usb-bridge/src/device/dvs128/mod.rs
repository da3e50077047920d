//! DVS128: 128 x 128 pixels, Cypress FX2 without registers, High speed.
//!
//! | vendor request to the device | meaning |
//! |---|---|
//! | 0xB3, 0xB4 | start, stop |
//! | 0xB8, 36 bytes | 12 biases of 3 bytes, big-endian |
//! | 0xBB, 0xBD | reset of the time, of the pixels |
//! | 0xBE, bit 0 of the value | whether it is the time master for other cameras |
//!
//! The camera reports no size. A simulated camera that plays a recording of a smaller sensor shows it in the upper
//! left of 128 x 128 pixels.

pub mod camera;
pub mod parse;
pub mod write;

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Sensor;

use self::camera::Dvs128Camera;
use self::parse::Dvs128Parser;
use self::write::Dvs128Writer;
use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::{Control, Request};
use crate::peripheral::Peripheral;

/// Name of the model.
pub const NAME: &str = "dvs128";

/// Size of the sensor.
pub const SENSOR: Sensor = Sensor {
    width: 128,
    height: 128,
};

/// The DVS128.
pub struct Dvs128;

const ENDPOINT: u8 = 0x86;
const VENDOR: u16 = 0x152A;
const PRODUCT: u16 = 0x8400;

/// Oldest firmware whose records have the format that [`parse`] reads.
const FIRMWARE_MIN: u16 = 14;

const START: u8 = 0xB3;
const STOP: u8 = 0xB4;
const BIASES: u8 = 0xB8;
const RESET_TIME: u8 = 0xBB;
const RESET_PIXELS: u8 = 0xBD;
const MASTER: u8 = 0xBE;

/// Biases for fast changes: cas, injGnd, reqPd, puX, diffOff, req, refr, puY, diffOn, diff, foll, pr.
const BIAS_VALUES: [u32; 12] = [
    1_992, 1_108_364, 16_777_215, 8_159_221, 132, 309_590, 969, 16_777_215, 209_996, 13_125, 271,
    217,
];

const BIAS_BYTES: usize = 3 * BIAS_VALUES.len();

fn send(control: &mut dyn Control, request: u8, value: u16, data: &[u8]) -> Result<()> {
    control
        .control_out(Request::vendor_out(request, value, 0), data)
        .with_context(|| format!("{NAME}: request {request:#04x} failed"))
}

impl Model for Dvs128 {
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
        &[NAME]
    }

    fn transfers(&self) -> Transfers {
        Transfers {
            endpoint: ENDPOINT,
            interface: 0,
            count: 8,
            bytes: 4096,
            timeout: Duration::from_millis(100),
        }
    }

    fn identify(&self, control: &mut dyn Control) -> Result<Info> {
        let firmware = control.release() & 0xFF;
        ensure!(
            firmware >= FIRMWARE_MIN,
            "{}: firmware {firmware} is too old: install version {FIRMWARE_MIN} or later",
            control.name()
        );
        // It may still be running for a program that crashed.
        send(control, STOP, 0, &[])?;
        control.clear_halt(ENDPOINT).with_context(|| {
            format!("{NAME}: cannot clear the halt of endpoint {ENDPOINT:#04x}")
        })?;
        Ok(Info {
            name: "DVS128".into(),
            serial: control.serial(),
            firmware: format!("firmware {firmware}"),
            sensor: SENSOR,
            stream: NAME,
        })
    }

    fn start(&self, _: &Info, control: &mut dyn Control) -> Result<()> {
        let mut biases = [0; BIAS_BYTES];
        for (bytes, value) in biases.chunks_exact_mut(3).zip(BIAS_VALUES) {
            bytes.copy_from_slice(&value.to_be_bytes()[1..]);
        }
        send(control, BIASES, 0, &biases)?;
        send(control, MASTER, 1, &[])?;
        send(control, START, 0, &[])
    }

    fn stop(&self, _: &Info, control: &mut dyn Control) -> Result<()> {
        send(control, STOP, 0, &[])
    }

    fn parser(&self, _: &Info) -> Box<dyn Parse> {
        Box::new(Dvs128Parser::begin())
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        fits(sensor).then(|| Box::new(Dvs128Writer::new(sensor)) as _)
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        fits(sensor).then(|| Box::new(Dvs128Camera::new(stream)) as _)
    }
}

const fn fits(sensor: Sensor) -> bool {
    sensor.width <= SENSOR.width && sensor.height <= SENSOR.height
}
