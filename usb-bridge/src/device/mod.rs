//! Device models: identification, start and stop, the parser of the stream and its inverse.
//!
//! Each model has a folder. `mod.rs` has the [`Model`]: how the device is recognised, configured, started and
//! stopped. `parse.rs` turns its stream into events, `write.rs` turns events into its stream, and `camera.rs` is
//! the [`Peripheral`] that answers a host as the device would.

pub mod davis;
pub mod dvs128;
pub mod dvxplorer;
pub mod dvxplorer_mipi;
pub mod inivation;
pub mod mcu;
pub mod prophesee;
pub mod stream_endpoint;

use std::time::Duration;

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};
use event_files::Skipped;

use crate::link::control::Control;
use crate::peripheral::Peripheral;

/// All known models; [`find`] and [`recognise`] search here.
pub static MODELS: &[&dyn Model] = &[
    &dvs128::Dvs128,
    &davis::DAVIS240,
    &davis::DAVIS346,
    &dvxplorer::Dvxplorer,
    &dvxplorer_mipi::DvxplorerMipi,
    &prophesee::EVK,
    &prophesee::EVK4_EVT21,
    &prophesee::EVK3_HD,
    &prophesee::EVK3_GENX320,
    &prophesee::EVK2,
    &mcu::MCU,
];

/// Vendor and product ID of a USB device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Identity {
    /// USB vendor ID.
    pub vendor: u16,
    /// USB product ID.
    pub product: u16,
    /// Major number of `bcdDevice`, if it distinguishes variants of one product.
    pub major: Option<u8>,
}

/// How a device's stream is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transfers {
    /// Bulk endpoint, with the direction bit.
    pub endpoint: u8,
    /// Number of the interface with this endpoint.
    pub interface: u8,
    /// Number of transfers in flight.
    pub count: usize,
    /// Bytes per transfer: a multiple of the endpoint's packet size, or a full packet might not fit.
    pub bytes: usize,
    /// Time after which a transfer is handed over as far as it is filled.
    pub timeout: Duration,
}

/// Identity that an opened device reports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Info {
    /// Name for people: `DAVIS346`.
    pub name: String,
    /// Serial number, if the device has one.
    pub serial: Option<String>,
    /// Versions of firmware and logic, as the device reports them.
    pub firmware: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Which stream the device will send, if the model has several: `evt3`.
    pub stream: &'static str,
}

/// A kind of device.
pub trait Model: Sync {
    /// Returns the name used on the command line: `davis346`.
    fn name(&self) -> &'static str;

    /// Returns the USB IDs of the model; empty if it can only be simulated.
    fn identities(&self) -> &'static [Identity];

    /// Returns how the stream is read.
    fn transfers(&self) -> Transfers;

    /// Returns whether the stream needs SuperSpeed (5 Gbit/s).
    fn needs_super_speed(&self) -> bool {
        false
    }

    /// Returns the names of the streams that the model may send (see [`Info::stream`]), the usual one first. The
    /// model's name, a `/` and a stream's name together have at most 32 bytes, the size of their field in packets.
    fn streams(&self) -> &'static [&'static str];

    /// Returns what a device of this model with such a sensor would report, for streams in files and packets, which
    /// come without it. `None` if the model has no stream of that name.
    fn describe(&self, sensor: Sensor, stream: &str) -> Option<Info> {
        let named = |name: &&&str| **name == stream;
        let stream = self.streams().iter().find(named)?;
        Some(Info {
            name: self.name().to_owned(),
            serial: None,
            firmware: "unknown".to_owned(),
            sensor,
            stream,
        })
    }

    /// Identifies a device and leaves it silent.
    ///
    /// # Errors
    /// The device does not answer, or not like this model.
    fn identify(&self, control: &mut dyn Control) -> Result<Info>;

    /// Starts the stream; transfers are in flight already.
    ///
    /// # Errors
    /// The device refuses a step; the message names it.
    fn start(&self, info: &Info, control: &mut dyn Control) -> Result<()>;

    /// Stops the stream; what was sent before still arrives.
    ///
    /// # Errors
    /// As for [`Model::start`].
    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()>;

    /// Returns a parser of the stream from its beginning.
    fn parser(&self, info: &Info) -> Box<dyn Parse>;

    /// Returns a writer of the stream; `None` if the device has no sensor of this size.
    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>>;

    /// Returns a simulated device, which answers control requests like the real one and sends `stream` from its
    /// endpoint while it is started. `None` as for [`Model::writer`].
    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>>;
}

/// The bytes that a simulated device sends, as they become due.
pub trait Stream: Send {
    /// Appends at most `room` bytes that are due now, possibly none.
    ///
    /// # Errors
    /// The recording cannot be read.
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due>;

    /// Begins anew: the device has been started.
    fn start(&mut self) {}

    /// Sets the device's clock to 0, as the host has asked.
    fn reset_time(&mut self) {}
}

/// Whether a [`Stream`] continues.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Due {
    /// More bytes will come; ask again.
    More,
    /// That was the last byte.
    Ended,
}

/// Most events that a byte of a stream can hold: a vector of 16 events in a 16-bit word.
pub const EVENTS_PER_BYTE_MAX: usize = 8;

/// Parses the bytes of a device's stream into events.
///
/// No input makes a parser panic. Only `events` is allocated: it grows by at most [`EVENTS_PER_BYTE_MAX`] per byte
/// or, for a stream of frames, by at most a window of events per frame.
pub trait Parse: Send {
    /// Returns the size of the sensor; every event is inside it.
    fn sensor(&self) -> Sensor;

    /// Parses the next bytes of the stream, cut anywhere, and appends their events. Bytes of an incomplete word are
    /// kept for the next call.
    fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>);

    /// Informs the parser that the next bytes do not continue the previous ones: some were lost, or a transfer was
    /// damaged. The parser forgets the row, the column and an incomplete word, and decodes events again from the
    /// next time word on. `now_us` is the device's time according to the host's clock, if the two are related:
    /// times that wrap continue at the nearest time to it.
    fn resume(&mut self, now_us: Option<u64>);

    /// Returns the latest time in the stream, in the device's microseconds with wraps included; `None` before the
    /// first.
    fn time_us(&self) -> Option<u64>;

    /// Returns the number of events so far.
    fn events(&self) -> u64;

    /// Returns the counts of words that are not events, by name: wraps, resets, triggers, padding, samples of other
    /// sensors.
    fn words(&self) -> Skipped;

    /// Returns what was lost or left out, by cause: events without a time, events outside the sensor, words that
    /// the device cannot have sent, bytes of an incomplete word.
    fn losses(&self) -> Skipped;
}

/// Writes events as bytes of a device's stream: the inverse of [`Parse`].
pub trait WriteStream: Send {
    /// Appends the words of `events`, whose times must be in the device's order.
    ///
    /// # Errors
    /// The device's stream cannot hold an event; the message names the event's number and field.
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()>;

    /// Appends the words of time that the device has sent by `t_us` without an event. A time before that of the last
    /// words adds none.
    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>);

    /// Appends the word that reports a reset of the device's clock; the times of later events count from 0. Returns
    /// `false` if the device has no such word, and then keeps its clock.
    fn reset_time(&mut self, bytes: &mut Vec<u8>) -> bool;

    /// Returns to the state of a device that has just been started.
    fn restart(&mut self);

    /// Appends what the device sends when it stops.
    ///
    /// # Errors
    /// As for [`WriteStream::write`].
    fn finish(&mut self, bytes: &mut Vec<u8>) -> Result<()>;
}

/// Returns the model with this name, if there is one.
#[must_use]
pub fn find(name: &str) -> Option<&'static dyn Model> {
    MODELS.iter().copied().find(|model| model.name() == name)
}

/// Returns the model of a device on the bus, if it is known; `release` is its `bcdDevice`.
#[must_use]
pub fn recognise(vendor: u16, product: u16, release: u16) -> Option<&'static dyn Model> {
    let is_it = |identity: &Identity| {
        (identity.vendor, identity.product) == (vendor, product)
            && identity
                .major
                .is_none_or(|major| u16::from(major) == release >> 8)
    };
    let has = |model: &&dyn Model, exact: bool| {
        model
            .identities()
            .iter()
            .any(|identity| is_it(identity) && identity.major.is_some() == exact)
    };
    // An identity with a release number takes precedence over one without.
    let of = |exact| MODELS.iter().copied().find(|model| has(model, exact));
    of(true).or_else(|| of(false))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::packet::ENCODING_BYTES;

    #[test]
    fn identities_are_unique_and_streams_come_from_the_device() {
        let mut seen = std::collections::HashSet::new();
        for model in MODELS {
            assert!(find(model.name()).is_some_and(|found| found.name() == model.name()));
            assert_ne!(model.transfers().endpoint & 0x80, 0, "{}", model.name());
            assert!(!model.streams().is_empty());
            for stream in model.streams() {
                let encoding = format!("{}/{stream}", model.name());
                assert!(encoding.len() <= ENCODING_BYTES, "{encoding}");
            }
            for identity in model.identities() {
                assert!(seen.insert(*identity), "{identity:?} is there twice");
                let release = u16::from(identity.major.unwrap_or(0)) << 8;
                let found = recognise(identity.vendor, identity.product, release);
                assert!(found.is_some_and(|found| found.name() == model.name()));
            }
        }
        assert!(recognise(0x152A, 0, 0).is_none());
    }
}
