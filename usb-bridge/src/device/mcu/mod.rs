//! The encoder's own microcontroller: frames on a vendor-class bulk endpoint, or the same bytes on a serial port.
//!
//! | file | content |
//! |---|---|
//! | `messages.rs` | frames and packets in received bytes |
//! | `parse.rs` | frames to events |
//! | `write.rs` | events to frames |
//! | `camera.rs` | the simulated encoder |
//!
//! docs/wire-format.md describes the bytes. They may be stored as they arrive: without the packets between them the
//! frames form an `.eecvs` file, and its reader skips packets. The encoder sends whenever a host reads, so there is
//! nothing to start. [`crate::encoder`] sets it up if that is requested.

pub mod camera;
pub mod messages;
pub mod parse;
pub mod write;

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Sensor;

use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::{Control, Request};
use crate::peripheral::Peripheral;
use camera::McuCamera;
use parse::McuParser;
use write::McuStream;

/// USB vendor and product ID: those of pid.codes for tests.
pub const IDENTITY: Identity = Identity {
    vendor: 0x1209,
    product: 0x0001,
    major: None,
};
/// Bulk endpoint to the host.
pub const TO_HOST: u8 = 0x81;
/// Bulk endpoint from the host.
pub const FROM_HOST: u8 = 0x01;
/// Vendor request that reads the encoder's counters: 40 bytes, of which the first is [`COUNTS_LAYOUT`].
pub const COUNTS: u8 = 0x01;
/// Length of the answer to [`COUNTS`], in bytes.
pub const COUNTS_BYTES: usize = 40;
/// Number of the layout of that answer.
pub const COUNTS_LAYOUT: u8 = 1;

/// Vendor request that begins a session.
pub const RESTART: u8 = 0x02;

/// Name of the model.
pub const NAME: &str = "eecvs";

/// Name of its stream.
const STREAM: &str = "frames";

/// Placeholder for a sensor that is not known yet; the frames report the real one.
pub const ANY_SENSOR: Sensor = Sensor {
    width: Sensor::SIDE_MAX,
    height: Sensor::SIDE_MAX,
};

/// The model of the encoder's microcontroller.
#[derive(Debug)]
pub struct Mcu;

/// The encoder's microcontroller.
pub static MCU: Mcu = Mcu;

impl Model for Mcu {
    fn name(&self) -> &'static str {
        NAME
    }

    fn identities(&self) -> &'static [Identity] {
        &[IDENTITY]
    }

    fn streams(&self) -> &'static [&'static str] {
        &[STREAM]
    }

    fn transfers(&self) -> Transfers {
        Transfers {
            endpoint: TO_HOST,
            interface: 0,
            count: 16,
            bytes: 1 << 12,
            timeout: Duration::from_millis(100),
        }
    }

    /// [`Info::sensor`] is [`ANY_SENSOR`]; the real size comes with the first frame, through [`Parse::sensor`].
    fn identify(&self, control: &mut dyn Control) -> Result<Info> {
        let mut counts = [0; COUNTS_BYTES];
        let request = Request::vendor_in(COUNTS, 0, 0);
        let length = control.control_in(request, &mut counts).context(
            "it has the USB IDs of an encoder, but these are test IDs that any device may use",
        )?;
        ensure!(
            length == COUNTS_BYTES && counts[0] == COUNTS_LAYOUT,
            "{}: this is not an encoder, or an encoder of another version: build its image from \
             the same sources as this program",
            control.name()
        );
        let release = control.release();
        Ok(Info {
            name: "EECVS encoder".to_owned(),
            serial: control.serial(),
            firmware: format!(
                "{:x}.{:x}.{:x}",
                release >> 8,
                release >> 4 & 0xf,
                release & 0xf
            ),
            sensor: ANY_SENSOR,
            stream: STREAM,
        })
    }

    fn start(&self, _: &Info, _: &mut dyn Control) -> Result<()> {
        Ok(())
    }

    fn stop(&self, _: &Info, _: &mut dyn Control) -> Result<()> {
        Ok(())
    }

    fn parser(&self, info: &Info) -> Box<dyn Parse> {
        Box::new(McuParser::new(info.sensor))
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        Some(Box::new(McuStream::new(sensor)))
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        Some(Box::new(McuCamera::new(sensor, stream)))
    }
}
