//! EVT 2.1 as a camera sends it, of any events.
//!
//! `EVT_TIME_HIGH` comes when it changes, every 64 us at the most; in a silence of up to 2^32 us
//! every 4,096 us, in a longer one every 36 minutes. Events one after the other that share time, row and
//! polarity in rising columns of one group of 32 are one word. The order of events is kept.

use anyhow::{Context, Result};
use eecvs_nostd::{Event, Polarity, Sensor};

use super::high_time::Way;
use super::parse_evt21::{
    HIGH_BITS, LOW_BITS, Order, TIME_HIGH, TIME_SHIFT, TYPE_SHIFT, X_SHIFT, Y_SHIFT,
};
use crate::device::WriteStream;

/// `EVT_TIME_HIGH`s from one to the next in a silence, and those of the longest such silence.
const SILENCE: (u64, u64) = (4096 >> LOW_BITS, 1 << (32 - LOW_BITS));

/// Writer of EVT 2.1.
pub struct Evt21Stream {
    sensor: Sensor,
    order: Order,
    high: Way<HIGH_BITS>,
    events: u64,
}

impl Evt21Stream {
    /// At the start of a stream of a camera with this sensor, whose time begins at 0.
    #[must_use]
    pub fn new(sensor: Sensor, order: Order) -> Self {
        Self {
            sensor,
            order,
            high: Way::new(),
            events: 0,
        }
    }
}

impl WriteStream for Evt21Stream {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        let order = self.order;
        let mut rest = events;
        while let Some(first) = rest.first() {
            let (count, columns) = run(rest);
            let (now, later) = rest.split_at(count);
            for (event, index) in now.iter().zip(self.events..) {
                super::check_inside(index, event, self.sensor)?;
            }
            let high = first.t_us >> LOW_BITS;
            if self.high.last() != Some(high) {
                let time = |high| {
                    bytes.extend(order.bytes(TIME_HIGH << TYPE_SHIFT | high << Y_SHIFT));
                };
                let gone = self.high.go(high, SILENCE, time);
                gone.ok()
                    .with_context(|| super::time_refused(self.events, first.t_us))?;
            }
            let word = u64::from(first.polarity == Polarity::On) << TYPE_SHIFT
                | (first.t_us & ((1 << LOW_BITS) - 1)) << TIME_SHIFT
                | u64::from(first.x & !31) << X_SHIFT
                | u64::from(first.y) << Y_SHIFT
                | u64::from(columns);
            bytes.extend(order.bytes(word));
            self.events += count as u64;
            rest = later;
        }
        Ok(())
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}

/// Number of events at the start of `events` that one word can hold in their order, and its columns.
fn run(events: &[Event]) -> (usize, u32) {
    let Some(first) = events.first() else {
        return (0, 0);
    };
    let group = |event: &Event| (event.t_us, event.y, event.polarity, event.x / 32);
    let mut columns = 1_u32 << (first.x % 32);
    let mut count = 1;
    for event in &events[1..] {
        let column = event.x % 32;
        // Above all that are there.
        if group(event) != group(first) || columns >> column != 0 {
            break;
        }
        columns |= 1 << column;
        count += 1;
    }
    (count, columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_a_sensor() {
        let event = |t_us, x, on| Event {
            t_us,
            x,
            y: 0x45,
            polarity: Polarity::from_bool(on),
        };
        let events = [
            event(0x1234_5678, 0x65, true),
            event(0x1234_5678, 0x67, true),
            event(0x1234_5678, 0x67, true),
            event(0x1234_5679, 0x80, false),
        ];
        let sensor = Sensor::new(320, 320).unwrap();
        let words = |order: Order| {
            let mut bytes = Vec::new();
            Evt21Stream::new(sensor, order)
                .write(&events, &mut bytes)
                .unwrap();
            bytes
        };
        let high = 0x1234_5678_u64 >> 6;
        let (low, x, y) = (0x38_u64 << 54, 0x60_u64 << 43, 0x45_u64 << 32);
        let expected = [
            8 << 60 | high << 32,
            1 << 60 | low | x | y | 0xa0,
            1 << 60 | low | x | y | 0x80,
            0x39 << 54 | 0x80 << 43 | y | 1,
        ];
        let little: Vec<u8> = expected
            .iter()
            .flat_map(|word| word.to_le_bytes())
            .collect();
        assert_eq!(words(Order::Little), little);
        let halves = expected.iter().flat_map(|word| {
            let (upper, lower) = ((word >> 32) as u32, *word as u32);
            [upper.to_le_bytes(), lower.to_le_bytes()].concat()
        });
        assert_eq!(words(Order::UpperFirst), halves.collect::<Vec<_>>());
    }

    /// The example of the format's description.
    #[test]
    fn the_upper_half_comes_first() {
        let word = 0x0102_0304_0506_0708;
        let bytes = [4, 3, 2, 1, 8, 7, 6, 5];
        assert_eq!(Order::UpperFirst.bytes(word), bytes);
        assert_eq!(Order::UpperFirst.word(bytes), word);
        assert_eq!(Order::Little.word(Order::Little.bytes(word)), word);
    }
}
