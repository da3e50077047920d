//! The TORE volume: the last k events of every pixel and polarity, by the logarithm of their age.
//!
//! Baldwin, Liu, Almatrafi, Asari, Hirakawa, *Time-Ordered Recent Event (TORE) Volumes for Event
//! Cameras* (2021), with k = 3. At the end of every window that has events, for the i-th latest event
//! of pixel (x, y) and polarity p:
//!
//! ```text
//! age = end - t, 5 s at the most; 5 s where there is none
//! V[p, i, y, x] = max(0, ln(age + 1) - ln(150 + 1))        age in us
//! ```
//!
//! Queues outlive their windows. The array is f32, or its value over the largest one in levels of u16
//! or u8. The decoder takes every age of up to T for an event of the window; one of age 0 to 150 us,
//! which the definition does not tell apart, lies in their middle. Of more than k events of a pixel
//! and polarity the oldest are lost.

use std::time::Instant;

use eecvs_nostd::{Event, Polarity};

use super::dense_array::{self, windows};
use crate::source::{Source, WINDOW_US};

/// k.
const DEPTH: usize = 3;
/// Ages that are not told apart, in us.
const AGE_MIN: f64 = 150.0;
/// Ages from here on are this, in us.
const AGE_MAX: f64 = 5e6;

/// Type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Value {
    /// 4 bytes.
    F32,
    /// 2 bytes.
    U16,
    /// 1 byte.
    U8,
}

impl Value {
    /// All types.
    pub const ALL: [Self; 3] = [Self::F32, Self::U16, Self::U8];

    /// As rows have it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::U16 => "u16",
            Self::U8 => "u8",
        }
    }

    const fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::U16 => 2,
            Self::U8 => 1,
        }
    }

    /// What is left of a value once it has been stored.
    fn stored(self, value: f64) -> f64 {
        let levels = match self {
            Self::F32 => return f64::from(value as f32),
            Self::U16 => f64::from(u16::MAX),
            Self::U8 => f64::from(u8::MAX),
        };
        (value / value_max() * levels).round() / levels * value_max()
    }
}

fn value_max() -> f64 {
    (AGE_MAX + 1.0).ln() - (AGE_MIN + 1.0).ln()
}

/// Of an event `age_us` old.
fn value(age_us: u64) -> f64 {
    let age = (age_us as f64).min(AGE_MAX);
    ((age + 1.0).ln() - (AGE_MIN + 1.0).ln()).max(0.0)
}

/// The age of a value, to the microsecond.
fn age_us(value: f64) -> u64 {
    if value <= 0.0 {
        return (AGE_MIN / 2.0) as u64;
    }
    ((value + (AGE_MIN + 1.0).ln()).exp() - 1.0).round() as u64
}

/// Times of the last events of a pixel and polarity, the latest first.
type Queue = [Option<u64>; DEPTH];

/// Bytes of all arrays, seconds spent on them (the arrays' memory not included), and the events that
/// the decoder finds.
#[must_use]
pub fn round_trip(source: &Source, stored: Value) -> (usize, f64, Vec<Event>) {
    let width = usize::from(source.sensor.width);
    let mut queues: Vec<[Queue; 2]> = vec![Default::default(); source.sensor.pixels() as usize];
    let (mut bytes, mut events) = (0, Vec::new());
    // Only these have an event that is young enough, or that rounding makes so.
    let (mut active, mut before): (Vec<(u16, u16)>, Vec<_>) = Default::default();
    let mut number_before = None;
    let started = Instant::now();
    for window in windows(source) {
        before.clear();
        if number_before.map(|number: u64| number + 1) == Some(window.number) {
            before.append(&mut active);
        }
        active.clear();
        number_before = Some(window.number);
        for event in window.events {
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            if let Some(queues) = queues.get_mut(pixel) {
                let queue = &mut queues[usize::from(event.polarity == Polarity::On)];
                queue.rotate_right(1);
                queue[0] = Some(event.t_us);
                active.push((event.y, event.x));
            }
        }
        active.sort_unstable();
        active.dedup();
        bytes += dense_array::bytes(source, 2 * DEPTH, stored.bytes());
        let end_us = window.start_us + u64::from(WINDOW_US);
        let old = before
            .iter()
            .filter(|pixel| active.binary_search(pixel).is_err());
        for (y, x) in active.iter().chain(old).copied() {
            let pixel = usize::from(y) * width + usize::from(x);
            for (queue, is_on) in queues.get(pixel).into_iter().flatten().zip([false, true]) {
                for t_us in queue.iter().flatten() {
                    let age_us = age_us(stored.stored(value(end_us - t_us)));
                    if age_us <= u64::from(WINDOW_US) {
                        let t_us = end_us - age_us.max(1);
                        let polarity = Polarity::from_bool(is_on);
                        events.push(Event {
                            t_us,
                            x,
                            y,
                            polarity,
                        });
                    }
                }
            }
        }
    }
    (bytes, started.elapsed().as_secs_f64(), events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::memory_reader::{SENSOR, event};

    fn source(events: &[Event]) -> Source {
        Source {
            name: "test".to_owned(),
            sensor: SENSOR,
            events: events.to_vec().into(),
        }
    }

    fn sorted(mut events: Vec<Event>) -> Vec<Event> {
        events.sort_by_key(|event| (event.t_us, event.y, event.x));
        events
    }

    #[test]
    fn values_are_those_of_the_definition() {
        assert_eq!(value(0), 0.0);
        assert_eq!(value(150), 0.0);
        assert!((value(301) - 2.0_f64.ln()).abs() < 1e-12);
        assert!((value(u64::MAX) - value_max()).abs() < 1e-12);
        for age in [151, 152, 1000, 32_768, 4_999_999] {
            let stored = Value::F32.stored(value(age));
            // f32 has 24 bits of a value up to 10.4.
            let off = age_us(stored).abs_diff(age);
            assert!(off as f64 <= 1e-6 * age as f64 + 0.5, "{age}: {off}");
            assert!(
                age_us(Value::U16.stored(value(age))).abs_diff(age) as f64 <= 1e-4 * age as f64
            );
            // The first of 255 levels begins at an age of 154; below it is what is not told apart.
            let age_u8 = age_us(Value::U8.stored(value(age)));
            let most = if age < 154 {
                80.0
            } else {
                0.021 * age as f64 + 1.0
            };
            assert!(age_u8.abs_diff(age) as f64 <= most, "{age}: {age_u8}");
        }
    }

    #[test]
    fn the_last_three_of_each_polarity_are_kept() {
        let events = [
            event(1000, 1, 1, true),
            event(2000, 1, 1, true),
            event(3000, 1, 1, true),
            event(4000, 1, 1, false),
            event(5000, 1, 1, true),
            event(6000, 2, 1, true),
        ];
        let (bytes, _, found) = round_trip(&source(&events), Value::F32);
        assert_eq!(bytes, 128 + 64 * 48 * 6 * 4);
        assert_eq!(sorted(found), events[1..]);
        assert_eq!(round_trip(&source(&events), Value::U8).0, 128 + 64 * 48 * 6);
    }

    #[test]
    fn a_queue_outlives_its_window_but_its_events_come_once() {
        let window_us = u64::from(WINDOW_US);
        let events = [
            event(0, 1, 1, true),
            event(1000, 1, 1, true),
            event(window_us + 5, 1, 1, true),
            // Two windows later, and within the ages that are not told apart.
            event(4 * window_us - 100, 1, 1, true),
        ];
        let (bytes, _, found) = round_trip(&source(&events), Value::F32);
        assert_eq!(bytes, 3 * (128 + 64 * 48 * 6 * 4));
        let mut expected = events;
        expected[3].t_us = 4 * window_us - 75;
        assert_eq!(sorted(found), expected);
    }
}
