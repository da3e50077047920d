//! Decodes events from messages, whatever file the messages come from.
//!
//! [`super::message_events`] describes the events' times; `seek.rs` finds a time.

use std::io::Read;

use event_types::Sensor;
use event_types::stream::{ErrorKind, Result};

use super::fields::Serialisation;
use super::message::{Head, Kind};
use super::message_events::MessageEvents;
use super::topics::{Topics, Use};
use crate::input::{Batch, Decode, Reader};
use crate::{Assumption, Skipped};

/// Longest message, in bytes.
pub const MESSAGE_MAX: usize = 1 << 28;

/// A source of the messages of a bag, one after another.
pub trait Messages: Send {
    /// Implements [`Decode::format`].
    fn format(&self) -> &'static str;

    /// Reads the next message of the wanted topic into `message`, replacing its content, and counts messages of
    /// other topics in `skipped`; returns `None` at the end.
    ///
    /// # Errors
    /// The file is damaged or truncated.
    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>>;

    /// Returns the number of places from which messages can be read, in the file's order, if the file has an index
    /// of them; the first is its beginning. The position of reading does not change.
    ///
    /// # Errors
    /// The file cannot be read.
    fn places(&mut self, topics: &mut Topics) -> Result<Option<u64>> {
        let _ = topics;
        Ok(None)
    }

    /// Continues at one of [`Messages::places`], which must have been called.
    ///
    /// # Errors
    /// The file cannot be read.
    fn go(&mut self, place: u64, topics: &mut Topics) -> Result<()> {
        let _ = (place, topics);
        Ok(())
    }

    /// Returns an error at byte `at` of the latest message.
    fn error(&self, at: usize, what: &str) -> event_types::stream::Error;
}

/// First bytes of a Zstandard frame; a ROS 2 message begins with 0 and its encapsulation instead.
const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Decompresses a CDR message that rosbag2's compression mode `message` has compressed; leaves others as they are.
///
/// # Errors
/// The message is damaged, or longer than [`MESSAGE_MAX`]; the error says so.
pub fn unpack(message: &mut Vec<u8>) -> Result<(), String> {
    if !message.starts_with(&ZSTD_MAGIC) {
        return Ok(());
    }
    let broken = |what: &dyn std::fmt::Display| {
        format!("a message cannot be decompressed ({what}): it is damaged")
    };
    let mut unpacked = Vec::new();
    let decoder = ruzstd::decoding::StreamingDecoder::new(message.as_slice());
    let decoder = decoder.map_err(|error| broken(&error))?;
    let read = decoder
        .take(MESSAGE_MAX as u64 + 1)
        .read_to_end(&mut unpacked);
    read.map_err(|error| broken(&error))?;
    if unpacked.len() > MESSAGE_MAX {
        return Err(broken(&format_args!(
            "it has more than {MESSAGE_MAX} bytes"
        )));
    }
    *message = unpacked;
    Ok(())
}

/// A source of messages that may each be compressed, by rosbag2's compression mode `message`.
pub(super) struct Unpacked(pub(super) Box<dyn Messages>);

impl Messages for Unpacked {
    fn format(&self) -> &'static str {
        self.0.format()
    }

    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> Result<Option<(Kind, Serialisation)>> {
        let next = self.0.next(message, topics, skipped)?;
        if matches!(next, Some((_, Serialisation::Cdr))) {
            unpack(message).map_err(|what| self.0.error(0, &what))?;
        }
        Ok(next)
    }

    fn places(&mut self, topics: &mut Topics) -> Result<Option<u64>> {
        self.0.places(topics)
    }

    fn go(&mut self, place: u64, topics: &mut Topics) -> Result<()> {
        self.0.go(place, topics)
    }

    fn error(&self, at: usize, what: &str) -> event_types::stream::Error {
        self.0.error(at, what)
    }
}

/// How to treat the messages of each topic, by the number of its connection or channel.
pub type Uses = std::collections::HashMap<u64, Use>;

/// A reader of bags.
pub type RosReader = Reader<RosDecoder>;

impl RosReader {
    /// Reads `messages` up to the first message of the topic `place`, or of the first topic of events. `size` is
    /// used if the messages do not state the sensor's size.
    ///
    /// # Errors
    /// There is no such topic; the size is unknown; the file is damaged.
    pub fn new(
        messages: Box<dyn Messages>,
        place: Option<&str>,
        size: Option<Sensor>,
    ) -> Result<Self> {
        let mut messages: Box<dyn Messages> = Box::new(Unpacked(messages));
        let mut topics = Topics::new(place);
        let (mut message, mut skipped) = (Vec::new(), Skipped::default());
        let Some((kind, serialisation)) = messages.next(&mut message, &mut topics, &mut skipped)?
        else {
            return Err(messages.error(0, &topics.missing()));
        };
        let head = Head::read(&message, kind, serialisation)
            .map_err(|(at, what)| messages.error(at, &what))?;
        let sensor = match (head.width, head.height) {
            (0, 0) => size.ok_or_else(|| {
                let what = "the messages state no sensor size: give --width W --height H";
                messages.error(0, what).of_kind(ErrorKind::Undecided)
            })?,
            (width, height) => {
                let side = |side| u16::try_from(side).unwrap_or(0);
                Sensor::new(side(width), side(height)).ok_or_else(|| {
                    let what = format!("sensor size {width}x{height} is out of range");
                    messages.error(0, &what)
                })?
            }
        };
        let mut events = MessageEvents::new(sensor);
        events.skipped = skipped;
        events.take(message, head.content);
        Ok(Self::around(RosDecoder {
            messages,
            topics,
            told: (head.width, head.height),
            events,
        }))
    }
}

/// The decoder of [`RosReader`]: its state between two batches.
pub struct RosDecoder {
    pub(super) messages: Box<dyn Messages>,
    pub(super) topics: Topics,
    /// Width and height that the first message states.
    pub(super) told: (u32, u32),
    pub(super) events: MessageEvents,
}

impl RosDecoder {
    /// Begins the next message; returns `false` at the end.
    fn next(&mut self) -> Result<bool> {
        let events = &mut self.events;
        let next =
            self.messages
                .next(&mut events.message, &mut self.topics, &mut events.skipped)?;
        let Some((kind, serialisation)) = next else {
            return Ok(false);
        };
        let head = Head::read(&events.message, kind, serialisation)
            .map_err(|(at, what)| self.messages.error(at, &what))?;
        if (head.width, head.height) != self.told {
            let (width, height) = self.told;
            let what = format!(
                "the sensor size is {}x{} here but {width}x{height} before: convert the parts \
                 separately",
                head.width, head.height
            );
            return Err(self.messages.error(0, &what));
        }
        events.begin(head.content);
        Ok(true)
    }
}

impl Decode for RosDecoder {
    fn format(&self) -> &'static str {
        self.messages.format()
    }

    fn sensor(&self) -> Sensor {
        self.events.sensor()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.events.assumptions()
    }

    fn skipped(&self) -> &Skipped {
        self.events.skipped()
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.events.leave_out = true;
        true
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.seek_to(t_us)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        loop {
            let read = self.events.read(batch);
            let has_room = read.map_err(|(at, what)| self.messages.error(at, &what))?;
            if !has_room || !self.next()? {
                return Ok(());
            }
        }
    }
}
