//! Writes events as EVT 3.0, the way a camera sends them.
//!
//! `TIME_HIGH` is written when it changes, and again before the first event of every further 16 us (a sensor sends
//! it every 16 us, with or without events). `TIME_LOW` and `ADDR_Y` follow it, and are written again when they
//! change, so that a receiver is correct again 16 us after a loss. In a silence of up to 2^32 us every value of
//! `TIME_HIGH` is written, one per 4,096 us; in a longer silence one every 2 s. Five or more consecutive events of
//! the same time, row and polarity in increasing columns form a vector, as in files
//! ([`event_files::evt::evt3::group`]). The order of events is kept.

use anyhow::{Context, Result};
use eecvs_nostd::{Event, Sensor};
use event_files::evt::evt3::group::Group;
use event_files::evt::evt3::{ADDR_Y, TIME_BITS, TIME_HIGH, TIME_LOW};

use super::high_time::Way;
use crate::device::WriteStream;

/// Interval after which `TIME_HIGH` is repeated with the next event: 2^4 us.
const REPEAT_BITS: u32 = 4;
/// Longest silence in which every `TIME_HIGH` is written: 2^32 us.
const SILENCE: u64 = 1 << (32 - TIME_BITS);

/// Writer of EVT 3.0.
pub struct Evt3Stream {
    sensor: Sensor,
    high: Way<TIME_BITS>,
    /// Time of the latest event without its lowest [`REPEAT_BITS`] bits.
    block: Option<u64>,
    low: Option<u16>,
    row: Option<u16>,
    events: u64,
}

impl Evt3Stream {
    /// Starts a stream of a camera with this sensor, whose time begins at 0.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            sensor,
            high: Way::new(),
            block: None,
            low: None,
            row: None,
            events: 0,
        }
    }

    /// Makes the next event's words self-contained, so that a reader can start there.
    pub fn say_all(&mut self) {
        self.block = None;
    }

    fn time(&mut self, t_us: u64, bytes: &mut Vec<u8>) -> Result<()> {
        let high = t_us >> TIME_BITS;
        if self.block != Some(t_us >> REPEAT_BITS) {
            if self.high.last() == Some(high) {
                put(bytes, TIME_HIGH, (high & 0xfff) as u16);
            } else {
                self.high
                    .go(high, (1, SILENCE), |low| put(bytes, TIME_HIGH, low as u16))
                    .ok()
                    .with_context(|| super::time_refused(self.events, t_us))?;
            }
            self.block = Some(t_us >> REPEAT_BITS);
            (self.low, self.row) = (None, None);
        }
        // `low` is below 2^12.
        let low = (t_us & 0xfff) as u16;
        if self.low != Some(low) {
            put(bytes, TIME_LOW, low);
            self.low = Some(low);
        }
        Ok(())
    }
}

fn put(bytes: &mut Vec<u8>, kind: u16, value: u16) {
    bytes.extend((kind << 12 | value).to_le_bytes());
}

impl WriteStream for Evt3Stream {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        let mut rest = events;
        while let (Some(first), Some(group)) = (rest.first(), Group::of(rest, self.sensor.width)) {
            let (now, later) = rest.split_at(group.events);
            for (event, index) in now.iter().zip(self.events..) {
                super::check_inside(index, event, self.sensor)?;
            }
            self.time(first.t_us, bytes)?;
            if self.row != Some(first.y) {
                put(bytes, ADDR_Y, first.y);
                self.row = Some(first.y);
            }
            for word in group.words() {
                bytes.extend(word.to_le_bytes());
            }
            self.events += group.events as u64;
            rest = later;
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        let high = t_us >> TIME_BITS;
        if self.high.last().is_some_and(|last| last >= high) {
            return;
        }
        let time = |low| put(bytes, TIME_HIGH, low as u16);
        // A silence so long that no receiver could follow is shown as far as one can.
        let _ = self.high.go(high, (1, SILENCE), time);
        self.block = None;
    }

    fn reset_time(&mut self, _: &mut Vec<u8>) -> bool {
        false
    }

    fn restart(&mut self) {
        *self = Self::new(self.sensor);
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::parse_evt3::Evt3Parser;
    use eecvs_nostd::Polarity;

    use super::*;
    use crate::device::Parse;

    const SENSOR: Sensor = Sensor {
        width: 1280,
        height: 720,
    };

    fn words_of(events: &[Event]) -> Vec<u16> {
        let mut bytes = Vec::new();
        Evt3Stream::new(SENSOR).write(events, &mut bytes).unwrap();
        let (words, rest) = bytes.as_chunks();
        assert!(rest.is_empty());
        words.iter().map(|word| u16::from_le_bytes(*word)).collect()
    }

    fn event(t_us: u64, x: u16, y: u16, on: bool) -> Event {
        Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        }
    }

    #[test]
    fn words_are_those_of_a_sensor() {
        let t_us = 3 << 12;
        assert_eq!(
            words_of(&[
                event(t_us + 5, 0x123, 0x45, true),
                event(t_us + 5, 0x124, 0x45, false),
                event(t_us + 6, 1, 0x45, false),
                event(t_us + 6, 1, 0x46, false),
                event(t_us + 17, 1, 0x46, false),
            ]),
            [
                0x8003, 0x6005, 0x0045, 0x2923, 0x2124, 0x6006, 0x2001, 0x0046, 0x2001, 0x8003,
                0x6011, 0x0046, 0x2001
            ]
        );
    }

    #[test]
    fn neighbours_are_vectors() {
        let row = |columns: &[u16]| {
            let events: Vec<_> = columns.iter().map(|x| event(0, *x, 7, true)).collect();
            words_of(&events)[3..].to_vec()
        };
        assert_eq!(row(&[10, 11]), [0x280a, 0x280b]);
        assert_eq!(row(&[10, 11, 14, 40, 41]), [0x380a, 0x4013, 0x4000, 0x50c0]);
        assert_eq!(
            row(&[1275, 1276, 1277, 1278, 1279]),
            [0x3ce0, 0x4000, 0x4000, 0x50f8]
        );
    }

    /// What a file has of events is what a camera sends of them: only time and row are stated more often here.
    #[test]
    fn events_are_the_words_of_a_file() {
        let mut events = Vec::new();
        for y in 0..SENSOR.height {
            // Runs with gaps of 1 to 39 columns, the last ones at the sensor's edge.
            let kept = |x: &u16| (x * 7 + y) % (3 + y % 38) > 1 || *x > 1240;
            let at = |x| event(u64::from(y) * 37, x, y, y % 2 == 0);
            events.extend((0..SENSOR.width).filter(kept).map(at));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.raw");
        let mut file = event_files::create(&path, SENSOR).unwrap();
        file.write(&events).unwrap();
        file.finish().unwrap();
        let bytes = std::fs::read(path).unwrap();
        let end = bytes.windows(6).position(|part| part == b"% end\n");
        let (words, rest) = bytes[end.unwrap() + 6..].as_chunks();
        assert!(rest.is_empty());
        let of_events = |word: &u16| ![ADDR_Y, TIME_LOW, TIME_HIGH].contains(&(word >> 12));
        let filed: Vec<u16> = words.iter().map(|word| u16::from_le_bytes(*word)).collect();
        let filed: Vec<u16> = filed.into_iter().filter(of_events).collect();
        let sent: Vec<u16> = words_of(&events).into_iter().filter(of_events).collect();
        assert!(
            filed.iter().any(|word| word >> 12 == 5) && filed.iter().any(|word| word >> 12 == 2)
        );
        assert!(sent == filed);
    }

    #[test]
    fn silences_are_walked_through() {
        let seconds = |s: u64| s * 1_000_000;
        let words = words_of(&[
            event(0, 1, 1, true),
            event(seconds(40), 1, 1, true),
            event(seconds(40_000), 1, 1, true),
        ]);
        let high = words.iter().filter(|word| **word >> 12 == TIME_HIGH);
        let expected = 1 + seconds(40) / 4096 + (seconds(39_960) / 4096).div_ceil(512);
        assert!((high.count() as u64).abs_diff(expected) <= 1);
        let mut stream = Evt3Stream::new(SENSOR);
        let error = stream
            .write(
                &[event(0, 1, 1, true), event(1 << 50, 1, 1, true)],
                &mut vec![],
            )
            .unwrap_err();
        assert!(error.to_string().starts_with("event 1: "), "{error}");
        let outside = stream
            .write(&[event(1, 1280, 1, true)], &mut vec![])
            .unwrap_err();
        assert!(outside.to_string().starts_with("event 1 "), "{outside}");
    }

    #[test]
    fn a_time_after_many_wraps_is_reached() {
        let events = [
            event(1 << 32, 5, 6, false),
            event((1 << 32) + 1, 5, 6, true),
        ];
        let (mut bytes, mut parsed) = (Vec::new(), Vec::new());
        Evt3Stream::new(SENSOR).write(&events, &mut bytes).unwrap();
        assert!(bytes.len() < 1 << 14);
        let mut parser = Evt3Parser::new(SENSOR);
        parser.parse(&bytes, &mut parsed);
        assert_eq!(parsed, events);
        assert_eq!(parser.time_us(), Some((1 << 32) + 1));
    }
}
