//! Models of devices: identity, start and stop, the stream's parser and its inverse.
//!
//! A folder per model. `mod.rs` has the [`Model`]: how it is recognised, configured, started and
//! stopped; `parse.rs` turns its stream into events; `write.rs` turns events into its stream;
//! `camera.rs` is the [`Peripheral`] that answers a host as the device would.

pub mod davis;
pub mod dvs128;
pub mod dvxplorer;
pub mod dvxplorer_mipi;
pub mod inivation;
pub mod mcu;
pub mod prophesee;

use std::time::Duration;

use anyhow::Result;
use eecvs_nostd::{Event, Sensor};
use event_files::Skipped;

use crate::link::control::Control;
use crate::peripheral::Peripheral;

/// Every model that is known; [`find`] looks here.
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

/// A USB vendor and product.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Identity {
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Major number of `bcdDevice` that tells variants of one product apart, where it does.
    pub major: Option<u8>,
}

/// How a device's stream is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transfers {
    /// Bulk endpoint, with the direction's bit.
    pub endpoint: u8,
    /// Interface that has it.
    pub interface: u8,
    /// Transfers in flight.
    pub count: usize,
    /// Bytes of each: a multiple of the endpoint's packets, or a full packet would not fit.
    pub bytes: usize,
    /// After this time a transfer is handed over as far as it was filled.
    pub timeout: Duration,
}

/// What an opened device says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Info {
    /// Name for people: `DAVIS346`.
    pub name: String,
    /// Serial number, where it has one.
    pub serial: Option<String>,
    /// Version of firmware and logic, as the device gives it.
    pub firmware: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Which stream it will send, where the model has several: `evt3`.
    pub stream: &'static str,
}

/// A kind of device.
pub trait Model: Sync {
    /// Name on the command line: `davis346`.
    fn name(&self) -> &'static str;

    /// Identities that it has on the bus.
    fn identities(&self) -> &'static [Identity];

    /// How its stream is read.
    fn transfers(&self) -> Transfers;

    /// Whether its stream wants SuperSpeed (5 Gbit/s).
    fn needs_super_speed(&self) -> bool {
        false
    }

    /// Names of the streams that it may send, [`Info::stream`], the usual one first; with the
    /// model's name and a `/` at most 32 bytes, as packets carry them.
    fn streams(&self) -> &'static [&'static str];

    /// What a device of this model with such a sensor would say of itself, for streams that come
    /// without it, in files and packets; `None` where it has no stream of that name.
    fn describe(&self, sensor: Sensor, stream: &str) -> Option<Info> {
        let named = |name: &&&str| **name == stream;
        let stream = self.streams().iter().find(named)?;
        Some(Info {
            name: self.name().to_owned(),
            serial: None,
            firmware: "not told".to_owned(),
            sensor,
            stream,
        })
    }

    /// Asks a device what it is, and leaves it silent.
    ///
    /// # Errors
    /// The device does not answer, or not as this model does.
    fn identify(&self, control: &mut dyn Control) -> Result<Info>;

    /// Lets the events come: transfers are in flight already.
    ///
    /// # Errors
    /// The device refuses a step; the message names it.
    fn start(&self, info: &Info, control: &mut dyn Control) -> Result<()>;

    /// Ends the stream; what was sent before still comes.
    ///
    /// # Errors
    /// As for [`Model::start`].
    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()>;

    /// Parser of its stream, at its beginning.
    fn parser(&self, info: &Info) -> Box<dyn Parse>;

    /// Writer of its stream; `None` where the device has no sensor of this size.
    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>>;

    /// The device itself, simulated: it answers control requests as the real one does, and sends
    /// `stream` from its endpoint while it is started. `None` as for [`Model::writer`].
    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>>;
}

/// The bytes that a simulated device sends, as they become due.
pub trait Stream: Send {
    /// Appends at most `room` bytes that are due now; none where nothing is.
    ///
    /// # Errors
    /// The recording behind it cannot be read.
    fn take(&mut self, room: usize, bytes: &mut Vec<u8>) -> Result<Due>;
}

/// Whether a [`Stream`] goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Due {
    /// More will come; ask again.
    More,
    /// That was the last byte.
    Ended,
}

/// Events that a byte of a stream can hold at the most: a vector of 16 in a word of 16 bits.
pub const EVENTS_PER_BYTE_MAX: usize = 8;

/// Bytes of a device's stream in, events out.
///
/// No input makes a parser panic, and nothing is allocated but for `events`, which gets at most
/// [`EVENTS_PER_BYTE_MAX`] for every byte; of a stream of frames, at most a window for each.
pub trait Parse: Send {
    /// Size of the sensor: every event is inside.
    fn sensor(&self) -> Sensor;

    /// Takes the next bytes of the stream, cut anywhere, and appends their events. Bytes of an
    /// incomplete word are kept for the next call.
    fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>);

    /// The bytes that follow do not go on from those before: some were lost, or a transfer came
    /// damaged. What is known of the row, the column and an incomplete word is forgotten, and events
    /// come again from the next word of time on. `now_us` is the device's time by the host's clock,
    /// where the two are related: times that wrap are carried on to the nearest one.
    fn resume(&mut self, now_us: Option<u64>);

    /// Time of the stream so far, in the device's microseconds, wraps carried; `None` before the first.
    fn time_us(&self) -> Option<u64>;

    /// Events so far.
    fn events(&self) -> u64;

    /// Words that are no events, by name: wraps, resets, triggers, padding, samples of other sensors.
    fn words(&self) -> Skipped;

    /// What was lost or left out, by cause: events without a time, outside of the sensor, words that
    /// the device cannot have sent, bytes of an incomplete word.
    fn losses(&self) -> Skipped;
}

/// Events in, bytes of a device's stream out: the inverse of [`Parse`].
pub trait WriteStream: Send {
    /// Appends the words of `events`, whose times are in the device's order.
    ///
    /// # Errors
    /// An event that the device's stream cannot hold; the message names its number and field.
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()>;

    /// Appends what the device sends when it stops.
    ///
    /// # Errors
    /// As for [`WriteStream::write`].
    fn finish(&mut self, bytes: &mut Vec<u8>) -> Result<()>;
}

/// The model with this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static dyn Model> {
    MODELS.iter().copied().find(|model| model.name() == name)
}

/// The model of a device on the bus; `release` is its `bcdDevice`.
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
    // A variant that names its release comes before the one that does not.
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
