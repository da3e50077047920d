//! Events out of messages, whatever file these come from.
//!
//! Times, always of the sensor or its driver, never the computer's clock at the arrival:
//!
//! * `evt3`: the words' own, in us since the sensor's start; `time_base` is not used, as the
//!   package `event_camera_codecs` does not. Everything but the words' place in messages is as in
//!   EVT 3.0 files: rows, times and wraps carry over from one message to the next.
//! * `libcaer`: `time_base` + 1000 * the word's 31 bits, in ns; a time below the one before it in the
//!   same message has rolled over, which adds 2^31 us. Word: polarity bit 1, y bits 2 to 16, x bits
//!   17 to 31 (bit 0, libcaer's mark of validity, is not asked).
//! * `libcaer_cmp`: `time_base` + 1000 * 24 bits, which begin at 0 in every message. Words: type in
//!   the upper 4 bits (0 time bits 23..12, 1 time bits 11..0, 2 x, 3 y with polarity in bit 11: one
//!   event, 4 first y and polarity of vectors, 5 bit i: an event at y + i, then y advances by 8).
//!   x, first y and polarity carry over.
//! * `mono`: `time_base` + 32 bits of ns; x bits 32 to 47, y bits 48 to 62, polarity bit 63.
//! * `EventArray`: the structure's time.
//!
//! Nanoseconds are rounded down to microseconds.
//!
//! Seeking asks the index of a file for its places (chunks, or rows of a table) and no times of it: those
//! are the computer's at the arrival, which need not be the sensor's clock. The place is bisected by the
//! times of events, of the first message behind each place that is tried. `evt3` and `libcaer_cmp` are read
//! from their start: their words go on where the message before has ended, and `evt3` tells a time within
//! 16.8 s, so that what an event is depends on all that is before.

use eecvs_nostd::{Event, Polarity, Sensor};

use super::fields::{Fields, Serialisation};
use super::message::{Content, Encoding, Head, Kind};
use super::topics::{Topics, Use};
use crate::formats::Skipped;
use crate::formats::evt3::{VECTOR_EVENTS, WordDecoder};
use crate::formats::input::{Batch, Decode, Reader};
use crate::formats::raw_row::Outside;

/// Longest message.
pub const MESSAGE_MAX: usize = 1 << 28;

/// The messages of a bag, one after the other.
pub trait Messages: Send {
    /// As [`Decode::format`].
    fn format(&self) -> &'static str;

    /// Puts the next message of the wanted topic in place of `message`, and counts those of others;
    /// `None` at the end.
    ///
    /// # Errors
    /// A damaged or truncated file.
    fn next(
        &mut self,
        message: &mut Vec<u8>,
        topics: &mut Topics,
        skipped: &mut Skipped,
    ) -> anyhow::Result<Option<(Kind, Serialisation)>>;

    /// Number of places from which messages can be read on, in the file's order, where the file tells
    /// them; the first is its beginning. What is read next stays the same.
    ///
    /// # Errors
    /// I/O.
    fn places(&mut self, topics: &mut Topics) -> anyhow::Result<Option<u64>> {
        let _ = topics;
        Ok(None)
    }

    /// Reads on from one of [`Messages::places`], which has been asked.
    ///
    /// # Errors
    /// I/O.
    fn go(&mut self, place: u64, topics: &mut Topics) -> anyhow::Result<()> {
        let _ = (place, topics);
        Ok(())
    }

    /// Error at byte `at` of the message that was read last.
    fn error(&self, at: usize, what: &str) -> anyhow::Error;
}

/// What to do with a topic once it was found out, by number.
pub type Uses = std::collections::HashMap<u64, Use>;

/// Reader of bags.
pub type RosReader = Reader<RosDecoder>;

impl RosReader {
    /// Reads `messages` up to the first one of the topic `place`, or of the first topic of events.
    ///
    /// # Errors
    /// No such topic, no sensor size, a damaged file.
    pub fn new(
        mut messages: Box<dyn Messages>,
        place: Option<&str>,
        size: Option<Sensor>,
    ) -> anyhow::Result<Self> {
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
                let what = "the messages tell no sensor size: give --width W --height H";
                messages.error(0, what)
            })?,
            (width, height) => {
                let side = |side| u16::try_from(side).unwrap_or(0);
                Sensor::new(side(width), side(height)).ok_or_else(|| {
                    let what = format!("sensor size {width}x{height} is out of range");
                    messages.error(0, &what)
                })?
            }
        };
        Ok(Self::around(RosDecoder {
            messages,
            topics,
            told: (head.width, head.height),
            sensor,
            message,
            content: Some(head.content),
            alone: head.content.is_alone(),
            sought: false,
            evt3: WordDecoder::new(sensor, 0),
            libcaer_high_us: 0,
            libcaer_last_us: 0,
            vectors: VectorState::default(),
            events: 0,
            skipped,
        }))
    }
}

/// What words of `libcaer_cmp` have said.
#[derive(Debug, Default)]
struct VectorState {
    high: u16,
    low: u16,
    x: u16,
    y: u32,
    polarity: bool,
}

/// State between two batches.
pub struct RosDecoder {
    messages: Box<dyn Messages>,
    topics: Topics,
    /// Width and height as the first message tells them.
    told: (u32, u32),
    sensor: Sensor,
    message: Vec<u8>,
    /// What of the message is unread.
    content: Option<Content>,
    /// Whether the latest message can be read without those before it.
    alone: bool,
    /// Events are not counted from the file's beginning.
    sought: bool,
    evt3: WordDecoder,
    /// Rolled over within this message.
    libcaer_high_us: u64,
    libcaer_last_us: u64,
    vectors: VectorState,
    events: u64,
    skipped: Skipped,
}

impl RosDecoder {
    /// Begins the next message; false at the end.
    fn next(&mut self) -> anyhow::Result<bool> {
        let next = self
            .messages
            .next(&mut self.message, &mut self.topics, &mut self.skipped)?;
        let Some((kind, serialisation)) = next else {
            return Ok(false);
        };
        let head = Head::read(&self.message, kind, serialisation)
            .map_err(|(at, what)| self.messages.error(at, &what))?;
        if (head.width, head.height) != self.told {
            let (width, height) = self.told;
            let what = format!(
                "the sensor's size is {}x{} here and {width}x{height} before: convert the parts",
                head.width, head.height
            );
            return Err(self.messages.error(0, &what));
        }
        self.content = Some(head.content);
        self.alone = head.content.is_alone();
        (self.libcaer_high_us, self.libcaer_last_us) = (0, 0);
        (self.vectors.high, self.vectors.low) = (0, 0);
        Ok(true)
    }

    /// Whether the first event from a place on is before a time. Where there is none, or a damage, reading
    /// has to begin before.
    fn is_before(&mut self, place: u64, t_us: u64) -> bool {
        let Self {
            messages,
            topics,
            message,
            ..
        } = self;
        if messages.go(place, topics).is_err() {
            return false;
        }
        // What is passed here is not read.
        let mut skipped = Skipped::default();
        while let Ok(Some((kind, serialisation))) = messages.next(message, topics, &mut skipped) {
            let Ok(Head { content, .. }) = Head::read(message, kind, serialisation) else {
                return false;
            };
            if !content.is_empty() {
                return content.first_us(message).is_some_and(|first| first < t_us);
            }
        }
        false
    }

    fn outside(&self, at: usize, x: i64, y: i64) -> anyhow::Error {
        let Sensor { width, height } = self.sensor;
        let event = match self.sought {
            true => "an event".to_owned(),
            false => format!("event {}", self.events),
        };
        let what = format!(
            "{event} at x = {x}, y = {y} is outside of the sensor ({width}x{height}): the recording is \
             damaged"
        );
        self.messages.error(at, &what)
    }

    /// Gives an event of the message's byte `at`.
    fn push(
        &mut self,
        at: usize,
        (t_ns, x, y, on): (u64, u32, u32, bool),
        batch: &mut Batch<'_>,
    ) -> anyhow::Result<()> {
        let inside = u16::try_from(x).ok().zip(u16::try_from(y).ok());
        let inside = inside.filter(|(x, y)| self.sensor.contains(*x, *y));
        let Some((x, y)) = inside else {
            return Err(self.outside(at, x.into(), y.into()));
        };
        batch.push(Event {
            t_us: t_ns / 1000,
            x,
            y,
            polarity: Polarity::from_bool(on),
        });
        self.events += 1;
        Ok(())
    }

    /// Decodes packed events from position `at` on while the batch has room; returns where it stopped.
    fn packed(
        &mut self,
        encoding: Encoding,
        base_ns: u64,
        mut at: usize,
        end: usize,
        batch: &mut Batch<'_>,
    ) -> anyhow::Result<usize> {
        while at < end && batch.room() >= VECTOR_EVENTS {
            match encoding {
                Encoding::Evt3 => {
                    let word = u16::from_le_bytes(self.word(at));
                    let before = self.evt3.events;
                    let decoded = self.evt3.decode(word, batch, &mut self.skipped);
                    self.events += self.evt3.events - before;
                    if let Err(Outside { x, y }) = decoded {
                        return Err(self.outside(at, x.into(), y.into()));
                    }
                }
                Encoding::LibcaerCmp => {
                    let word = u16::from_le_bytes(self.word(at));
                    self.vector(at, word, base_ns, batch)?;
                }
                Encoding::Libcaer => {
                    let [data, time] = self.pair(at);
                    if time > i32::MAX as u32 {
                        let what = format!("time {time} has more than 31 bits: it is damaged");
                        return Err(self.messages.error(at + 4, &what));
                    }
                    let time_us = u64::from(time);
                    if time_us < self.libcaer_last_us {
                        self.libcaer_high_us += 1 << 31;
                    }
                    self.libcaer_last_us = time_us;
                    let t_ns = self.time(at, base_ns, (self.libcaer_high_us + time_us) * 1000)?;
                    let (x, y) = (data >> 17, data >> 2 & 0x7fff);
                    self.push(at, (t_ns, x, y, data & 2 != 0), batch)?;
                }
                Encoding::Mono => {
                    let [time_ns, data] = self.pair(at);
                    let t_ns = self.time(at, base_ns, time_ns.into())?;
                    let (x, y) = (data & 0xffff, data >> 16 & 0x7fff);
                    self.push(at, (t_ns, x, y, data >> 31 != 0), batch)?;
                }
            }
            at += encoding.word_bytes();
        }
        Ok(at)
    }

    /// Takes a word of `libcaer_cmp`.
    fn vector(
        &mut self,
        at: usize,
        word: u16,
        base_ns: u64,
        batch: &mut Batch<'_>,
    ) -> anyhow::Result<()> {
        let (value, row, on) = (word & 0xfff, u32::from(word & 0x7ff), word & 0x800 != 0);
        let state = &mut self.vectors;
        let time_us = u64::from(state.high) << 12 | u64::from(state.low);
        match word >> 12 {
            0 => state.high = value,
            1 => state.low = value,
            2 => state.x = word & 0x7ff,
            3 => {
                let x = state.x.into();
                let t_ns = self.time(at, base_ns, time_us * 1000)?;
                self.push(at, (t_ns, x, row, on), batch)?;
            }
            4 => (state.y, state.polarity) = (row, on),
            5 => {
                let (x, y, on) = (state.x.into(), state.y, state.polarity);
                state.y = y.saturating_add(8);
                let t_ns = self.time(at, base_ns, time_us * 1000)?;
                for bit in (0..8).filter(|bit| word >> bit & 1 == 1) {
                    self.push(at, (t_ns, x, y.saturating_add(bit), on), batch)?;
                }
            }
            _ => self.skipped.add("unknown words", 1),
        }
        Ok(())
    }

    fn time(&self, at: usize, base_ns: u64, since_ns: u64) -> anyhow::Result<u64> {
        base_ns.checked_add(since_ns).ok_or_else(|| {
            let what = format!("time_base {base_ns} ns leads beyond 2^64 ns: it is damaged");
            self.messages.error(at, &what)
        })
    }

    /// The word at `at`; the caller asks within the message only.
    fn word<const N: usize>(&self, at: usize) -> [u8; N] {
        let rest = self.message.get(at..).unwrap_or_default();
        rest.first_chunk().copied().unwrap_or([0; N])
    }

    fn pair(&self, at: usize) -> [u32; 2] {
        let [a, b, c, d, e, f, g, h] = self.word(at);
        [[a, b, c, d], [e, f, g, h]].map(u32::from_le_bytes)
    }

    /// Decodes the structure at a position.
    fn structure(&mut self, content: &mut Content, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        let Content::Array { cursor, left } = content else {
            return Ok(());
        };
        let at = cursor.at;
        let mut fields = Fields::resume(&self.message, *cursor);
        let mut event = || {
            let (x, y) = (fields.u16()?.into(), fields.u16()?.into());
            Ok((fields.time_ns()?, x, y, fields.u8()? != 0))
        };
        let event = event().map_err(|what: String| self.messages.error(at, &what))?;
        (*cursor, *left) = (fields.cursor, *left - 1);
        let behind = fields.left();
        if *left == 0 && behind > 3 {
            // CDR pads a message to 4 bytes.
            let what = format!("{behind} bytes are left behind the events: another layout");
            return Err(self.messages.error(cursor.at, &what));
        }
        self.push(at, event, batch)
    }
}

impl Decode for RosDecoder {
    fn format(&self) -> &'static str {
        self.messages.format()
    }

    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn seek(&mut self, t_us: u64) -> anyhow::Result<bool> {
        if !self.alone {
            return Ok(false);
        }
        let Some(places) = self.messages.places(&mut self.topics)? else {
            return Ok(false);
        };
        // The last place whose first event is before the time, or the beginning.
        let (mut place, mut end) = (0, places);
        while end.saturating_sub(place) > 1 {
            let middle = place + (end - place) / 2;
            match self.is_before(middle, t_us) {
                true => place = middle,
                false => end = middle,
            }
        }
        self.messages.go(place, &mut self.topics)?;
        self.content = None;
        self.sought = true;
        Ok(true)
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        while batch.room() >= VECTOR_EVENTS {
            match self.content {
                None | Some(Content::Array { left: 0, .. }) => {
                    if !self.next()? {
                        break;
                    }
                }
                Some(Content::Packed { at, end, .. }) if at >= end => self.content = None,
                Some(Content::Packed {
                    encoding,
                    base_ns,
                    at,
                    end,
                }) => {
                    let at = self.packed(encoding, base_ns, at, end, batch)?;
                    self.content = Some(Content::Packed {
                        encoding,
                        base_ns,
                        at,
                        end,
                    });
                }
                Some(mut content) => {
                    self.structure(&mut content, batch)?;
                    self.content = Some(content);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::formats::{EventReader, create, open};

    const SENSOR: Sensor = Sensor {
        width: 346,
        height: 260,
    };

    /// Events of several chunks, with many of each time.
    fn some_events(from: u64, n: u64) -> Vec<Event> {
        (from..from + n)
            .map(|i| Event {
                t_us: 1_700_000_000_000_000 + i / 7 * 7,
                x: (i % 346) as u16,
                y: (i / 346 % 260) as u16,
                polarity: Polarity::from_bool(i % 3 == 0),
            })
            .collect()
    }

    fn write(path: &Path, events: &[Event]) {
        let mut writer = create(path, SENSOR).unwrap();
        writer.write(events).unwrap();
        writer.finish().unwrap();
    }

    fn rest(reader: &mut dyn EventReader) -> Vec<Event> {
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        events
    }

    /// Seeks in `path`, to and fro, and reads every event from there on, and few before.
    fn check_seeks(path: &Path, want: &[Event], before_max: usize) {
        let mut reader = open(path, None).unwrap();
        assert_eq!(rest(reader.as_mut()), want);
        let (first, last) = (want[0].t_us, want[want.len() - 1].t_us);
        for target in [
            last,
            0,
            first,
            first + 7,
            (first + last) / 2,
            first + (last - first) / 3,
            last - 7,
            last + 1,
            u64::MAX,
        ] {
            assert!(reader.seek(target).unwrap(), "{}", path.display());
            let got = rest(reader.as_mut());
            assert!(want.ends_with(&got), "{}: {target}", path.display());
            let wanted = want.len() - want.partition_point(|event| event.t_us < target);
            assert!(got.len() >= wanted, "{}: {target}", path.display());
            assert!(
                got.len() <= wanted + before_max,
                "{}: {target}: {} events, {wanted} wanted",
                path.display(),
                got.len()
            );
        }
    }

    #[test]
    fn seeking_gives_every_event_from_a_time_on() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 700_000);
        for (name, chunk) in [("a.mcap", 145_000), ("a.bag", 115_000)] {
            let path = folder.path().join(name);
            write(&path, &want);
            check_seeks(&path, &want, chunk);
        }
    }

    #[test]
    fn seeking_goes_over_the_files_of_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| -> PathBuf { folder.path().join(name) };
        let want = some_events(0, 450_000);
        let mut list = "relative_file_paths:\n".to_owned();
        for (number, part) in want.chunks(150_000).enumerate() {
            let name = format!("part_{number}.mcap");
            write(&at(&name), part);
            list += &format!("  - {name}\n");
        }
        std::fs::write(at("metadata.yaml"), list).unwrap();
        check_seeks(folder.path(), &want, 145_000);
    }

    #[test]
    fn without_an_index_nothing_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 300_000);
        for name in ["a.mcap", "a.bag"] {
            let path = folder.path().join(name);
            write(&path, &want);
            let mut bytes = std::fs::read(&path).unwrap();
            bytes.truncate(bytes.len() - 5);
            std::fs::write(&path, &bytes).unwrap();
            let mut reader = open(&path, None).unwrap();
            let mut got = Vec::new();
            reader.read(&mut got).unwrap();
            assert!(!reader.seek(want[200_000].t_us).unwrap());
            while let Ok(1..) = reader.read(&mut got) {}
            assert_eq!(got, want, "{name}");
        }
    }

    /// Of a chunk in LZ4 that was cut off, whole blocks of 64 kB can be read.
    #[test]
    fn a_chunk_that_was_cut_off_gives_what_it_has() {
        let folder = tempfile::tempdir().unwrap();
        let want = some_events(0, 100_000);
        let path = folder.path().join("a.mcap");
        write(&path, &want);
        let bytes = std::fs::read(&path).unwrap();
        for part in 1..10 {
            std::fs::write(&path, &bytes[..bytes.len() * part / 10]).unwrap();
            let Ok(mut reader) = open(&path, None) else {
                assert!(part == 1);
                continue;
            };
            let mut got = Vec::new();
            let error = loop {
                match reader.read(&mut got) {
                    Ok(0) => panic!("the cut was not noticed"),
                    Ok(_) => {}
                    Err(error) => break error.to_string(),
                }
            };
            assert!(error.contains("cut off"), "{error}");
            assert!(want.starts_with(&got));
            assert!(
                got.len() + 25_000 > want.len() * part / 10,
                "{part}: {}",
                got.len()
            );
        }
    }
}
