//! Parses EVT 2.1 as a camera sends it, in the words of [`event_types::evt21`].
//!
//! Time wraps every 4.8 hours; `high_time.rs` extends it. After a break, events are decoded again from the next
//! `EVT_TIME_HIGH` on.

use eecvs_nostd::{Event, Polarity, Sensor};
use event_files::Skipped;
use event_types::evt21::{
    HIGH_BITS, LOW_BITS, Order, SIDE, TIME_HIGH, TIME_SHIFT, TYPE_SHIFT, X_SHIFT, Y_SHIFT,
    time_high,
};

use super::high_time::HighTime;
use crate::device::Parse;

/// Parser of EVT 2.1.
pub struct Evt21Parser {
    sensor: Sensor,
    order: Order,
    /// Bytes of an incomplete word, of which the first `begun` have arrived.
    part: [u8; 8],
    begun: usize,
    high: HighTime<HIGH_BITS>,
    /// Upper time in microseconds, if known.
    high_us: Option<u64>,
    latest_us: Option<u64>,
    events: u64,
    times: u64,
    with_events: u64,
    words: Skipped,
    losses: Skipped,
}

impl Evt21Parser {
    /// Starts at the beginning of the stream of a camera with this sensor.
    #[must_use]
    pub fn new(sensor: Sensor, order: Order) -> Self {
        Self {
            sensor,
            order,
            part: [0; 8],
            begun: 0,
            high: HighTime::new(),
            high_us: None,
            latest_us: None,
            events: 0,
            times: 0,
            with_events: 0,
            words: Skipped::default(),
            losses: Skipped::default(),
        }
    }

    /// Returns the number of words so far, of whatever kind: those in [`Parse::words`], those with events and
    /// unknown ones.
    #[must_use]
    pub fn words_seen(&self) -> u64 {
        let named = self.words().iter().map(|(_, count)| count).sum::<u64>();
        let unknown = self.losses.iter().find(|(name, _)| *name == UNKNOWN);
        named + self.with_events + unknown.map_or(0, |(_, count)| count)
    }

    fn take(&mut self, words: &[[u8; 8]], events: &mut Vec<Event>) {
        let before = events.len();
        let Sensor { width, height } = self.sensor;
        let (mut with_events, mut latest_us) = (0, self.latest_us);
        for word in words {
            let word = self.order.word(*word);
            let kind = word >> TYPE_SHIFT;
            if kind > 1 {
                self.other(word);
                continue;
            }
            let columns = word as u32;
            let x = (word >> X_SHIFT & SIDE) as u16;
            let y = (word >> Y_SHIFT & SIDE) as u16;
            // For an empty vector this is 0, which any sensor holds.
            let last = u32::from(x) + (columns | 1).ilog2();
            let (Some(high_us), true, true) = (
                self.high_us,
                last < u32::from(width) && y < height,
                columns != 0,
            ) else {
                self.lossy(word, events);
                continue;
            };
            let t_us = high_us | word >> TIME_SHIFT & ((1 << LOW_BITS) - 1);
            let polarity = Polarity::from_bool(kind == 1);
            latest_us = Some(t_us);
            with_events += 1;
            let mut left = columns;
            loop {
                events.push(Event {
                    t_us,
                    x: x + left.trailing_zeros() as u16,
                    y,
                    polarity,
                });
                left &= left - 1;
                if left == 0 {
                    break;
                }
            }
        }
        self.with_events += with_events;
        self.latest_us = latest_us.max(self.high_us);
        self.events += (events.len() - before) as u64;
    }

    /// Decodes a word in which some or all events have no time or no pixel, or which has no events.
    #[cold]
    fn lossy(&mut self, word: u64, events: &mut Vec<Event>) {
        let columns = word as u32;
        if columns == 0 {
            self.words.add("empty vectors", 1);
            return;
        }
        self.with_events += 1;
        let Some(high_us) = self.high_us else {
            let count = u64::from(columns.count_ones());
            self.losses.add("events before the first time", count);
            return;
        };
        let y = (word >> Y_SHIFT & SIDE) as u16;
        let mut left = columns;
        while left != 0 {
            // At most 2047 + 31.
            let x = (word >> X_SHIFT & SIDE) as u16 + left.trailing_zeros() as u16;
            left &= left - 1;
            if self.sensor.contains(x, y) {
                events.push(Event {
                    t_us: high_us | word >> TIME_SHIFT & ((1 << LOW_BITS) - 1),
                    x,
                    y,
                    polarity: Polarity::from_bool(word >> TYPE_SHIFT == 1),
                });
            } else {
                self.losses.add("events outside of the sensor", 1);
            }
        }
    }

    fn other(&mut self, word: u64) {
        match word >> TYPE_SHIFT {
            TIME_HIGH => {
                self.times += 1;
                self.high_us = Some(self.high.extend(time_high(word)) << LOW_BITS);
            }
            0xa => self.words.add("triggers", 1),
            0xe => self.words.add("other words", 1),
            0xf => self.words.add("continued words", 1),
            _ => self.losses.add(UNKNOWN, 1),
        }
    }
}

const UNKNOWN: &str = "unknown words";

impl Parse for Evt21Parser {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        let mut bytes = bytes;
        if self.begun > 0 {
            let (now, later) = bytes.split_at(bytes.len().min(8 - self.begun));
            self.part[self.begun..][..now.len()].copy_from_slice(now);
            self.begun += now.len();
            bytes = later;
            if self.begun < 8 {
                return;
            }
            self.begun = 0;
            self.take(&[self.part], events);
        }
        let (words, rest) = bytes.as_chunks();
        self.take(words, events);
        self.part[..rest.len()].copy_from_slice(rest);
        self.begun = rest.len();
    }

    fn resume(&mut self, now_us: Option<u64>) {
        let lost = std::mem::take(&mut self.begun) as u64;
        self.losses.add("bytes of an incomplete word", lost);
        self.high.resume(now_us.map(|now_us| now_us >> LOW_BITS));
        self.high_us = None;
    }

    fn time_us(&self) -> Option<u64> {
        self.latest_us
    }

    fn events(&self) -> u64 {
        self.events
    }

    fn words(&self) -> Skipped {
        let mut words = self.words.clone();
        words.add("times, upper bits", self.times);
        words
    }

    fn losses(&self) -> Skipped {
        self.losses.clone()
    }
}
