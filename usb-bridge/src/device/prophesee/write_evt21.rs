//! Writes events as EVT 2.1, the way a camera sends them.
//!
//! `EVT_TIME_HIGH` is written when it changes, at most every 64 us; in a silence of up to 2^32 us every 4,096 us,
//! in a longer one every 36 minutes. Consecutive events of the same time, row and polarity in increasing columns of
//! one group of 32 form one word. The order of events is kept.

use anyhow::{Context, Result};
use eecvs_nostd::{Event, Sensor};
use event_types::evt21::{HIGH_BITS, LOW_BITS, Order, time_word, vector};

use super::high_time::Way;
use crate::device::WriteStream;

/// Step of `EVT_TIME_HIGH` in a silence, and the length of the longest silence that has this step.
const SILENCE: (u64, u64) = (4096 >> LOW_BITS, 1 << (32 - LOW_BITS));

/// Writer of EVT 2.1.
pub struct Evt21Stream {
    sensor: Sensor,
    order: Order,
    high: Way<HIGH_BITS>,
    events: u64,
}

impl Evt21Stream {
    /// Starts a stream of a camera with this sensor, whose time begins at 0.
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
            let (count, word) = vector(rest);
            let (now, later) = rest.split_at(count);
            for (event, index) in now.iter().zip(self.events..) {
                super::check_inside(index, event, self.sensor)?;
            }
            let high = first.t_us >> LOW_BITS;
            if self.high.last() != Some(high) {
                let time = |high| bytes.extend(order.bytes(time_word(high)));
                let gone = self.high.go(high, SILENCE, time);
                gone.ok()
                    .with_context(|| super::time_refused(self.events, first.t_us))?;
            }
            bytes.extend(order.bytes(word));
            self.events += count as u64;
            rest = later;
        }
        Ok(())
    }

    fn advance(&mut self, t_us: u64, bytes: &mut Vec<u8>) {
        let high = t_us >> LOW_BITS;
        let high = high - high % SILENCE.0;
        if self.high.last().is_some_and(|last| last >= high) {
            return;
        }
        let order = self.order;
        let time = |high| bytes.extend(order.bytes(time_word(high)));
        // A silence so long that no receiver could follow is shown as far as one can.
        let _ = self.high.go(high, SILENCE, time);
    }

    fn reset_time(&mut self, _: &mut Vec<u8>) -> bool {
        false
    }

    fn restart(&mut self) {
        *self = Self::new(self.sensor, self.order);
    }

    fn finish(&mut self, _: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;

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

    /// A camera's words are a file's, but for what `EVT_TIME_HIGH` says in silences.
    #[test]
    fn events_are_the_words_of_a_file() {
        let sensor = Sensor::new(346, 260).unwrap();
        let mut events = Vec::new();
        for y in 0..sensor.height {
            let kept = |x: &u16| (x * 7 + y) % (3 + y % 38) > 1 || *x > 320;
            events.extend((0..sensor.width).filter(kept).map(|x| Event {
                t_us: u64::from(y) * 37,
                x,
                y,
                polarity: Polarity::from_bool(y % 2 == 0),
            }));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.evt21");
        let mut file = event_files::create(&path, sensor).unwrap();
        file.write(&events).unwrap();
        file.finish().unwrap();
        let bytes = std::fs::read(path).unwrap();
        let end = bytes.windows(6).position(|part| part == b"% end\n");
        let mut sent = Vec::new();
        Evt21Stream::new(sensor, Order::Little)
            .write(&events, &mut sent)
            .unwrap();
        assert!(sent.len() > 1000 && sent == bytes[end.unwrap() + 6..]);
    }
}
