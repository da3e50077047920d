//! TORE volumes: the logarithm of the age of the last k events of every pixel and polarity.
//!
//! Baldwin, Liu, Almatrafi, Asari, Hirakawa, *Time-Ordered Recent Event (TORE) Volumes for Event Cameras* (2021),
//! with their k = 3 or any other. At the end of every window that has events, for the i-th latest event of pixel
//! (x, y) and polarity p:
//!
//! ```text
//! age = end - t, 5 s at the most; 5 s if there is no event
//! V[p, i, y, x] = max(0, ln(age + 1) - ln(150 + 1))        age in us
//! ```
//!
//! ON first. Queues outlive their windows. The array is f32, or equal levels of u16 or u8 up to the largest value.
//! The decoder returns an event for every age of at most T. The definition does not distinguish ages from 0 to 150
//! us; they are decoded as 75 us. Of more than k events of a pixel and polarity, the oldest are lost.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Polarity, Sensor};

use super::dense_array::{Array, Window};
use super::recent::Recent;
use super::representation::{Found, Representation};
use super::stored::Range;

/// The paper's k.
pub const DEPTH: usize = 3;
/// Ages up to this one, in us, are not distinguished.
const AGE_MIN: f64 = 150.0;
/// Ages are limited to this one, in us.
const AGE_MAX: f64 = 5e6;

/// Makes TORE volumes.
#[derive(Debug, Clone)]
pub struct Tore {
    recent: Recent,
}

impl Tore {
    /// Starts the volumes of a sensor without events, with queues of `depth` events per pixel and polarity; 0 is
    /// taken as 1.
    #[must_use]
    pub fn new(sensor: Sensor, depth: usize) -> Self {
        Self {
            recent: Recent::new(sensor, depth.max(1)),
        }
    }
}

fn value_max() -> f64 {
    (AGE_MAX + 1.0).ln() - (AGE_MIN + 1.0).ln()
}

/// Returns the value of an event that is `age_us` old.
fn value(age_us: u64) -> f64 {
    let age = (age_us as f64).min(AGE_MAX);
    ((age + 1.0).ln() - (AGE_MIN + 1.0).ln()).max(0.0)
}

/// Returns the age of a value, to the microsecond.
fn age_us(value: f64) -> u64 {
    if value <= 0.0 {
        return (AGE_MIN / 2.0) as u64;
    }
    ((value + (AGE_MIN + 1.0).ln()).exp() - 1.0).round() as u64
}

impl Representation for Tore {
    type Work = ();

    fn channels(&self) -> usize {
        self.recent.channels()
    }

    fn range(&self) -> Range {
        Range::UpTo(value_max())
    }

    fn has_times(&self) -> bool {
        true
    }

    fn make(&mut self, window: &Window<'_>) -> Array {
        self.recent.array(window, |window, t_us| {
            t_us.map_or_else(value_max, |t_us| value(window.age_us(t_us)))
        })
    }

    fn nothing(&self) -> Option<f64> {
        Some(value_max())
    }

    fn is_news(&self, number: f64) -> bool {
        age_us(number) <= u64::from(WINDOW_US)
    }

    fn decode(&self, numbers: &[f64], _step: f64, (): &mut (), found: &mut Vec<Found>) {
        let queues = numbers.chunks(self.channels() / 2);
        for (queue, polarity) in queues.zip([Polarity::On, Polarity::Off]) {
            for number in queue.iter().filter(|number| self.is_news(**number)) {
                let age_us = age_us(*number).max(1) as f64;
                found.push(Found::at(f64::from(WINDOW_US) - age_us, polarity));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::baseline::representation::arrays;
    use crate::baseline::stored::{Quantiser, Stored};
    use crate::baseline::tests::{decoded, source};

    #[test]
    fn values_are_those_of_the_definition() {
        assert_eq!(value(0), 0.0);
        assert_eq!(value(150), 0.0);
        assert!((value(301) - 2.0_f64.ln()).abs() < 1e-12);
        assert!((value(u64::MAX) - value_max()).abs() < 1e-12);
        let [f32s, u16s, u8s] =
            Stored::ALL.map(|stored| Quantiser::new(Range::UpTo(value_max()), stored, 0.0));
        for age in [151, 152, 1000, 32_768, 4_999_999] {
            let stored = f32s.rounded(value(age));
            // f32 has 24 significant bits, for values up to 10.4.
            let off = age_us(stored).abs_diff(age);
            assert!(off as f64 <= 1e-6 * age as f64 + 0.5, "{age}: {off}");
            let off = age_us(u16s.rounded(value(age))).abs_diff(age);
            assert!(off as f64 <= 1e-4 * age as f64);
            // The first of 255 levels begins at an age of 154 us; younger ages are not distinguished.
            let age_u8 = age_us(u8s.rounded(value(age)));
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
        let source = source(&events);
        for (depth, kept) in [(DEPTH, &events[1..]), (4, &events[..]), (0, &events[3..])] {
            let mut tore = Tore::new(SENSOR, depth);
            assert_eq!(decoded(&mut tore, &source, Stored::F32), kept);
        }
        for stored in Stored::ALL {
            let mut tore = Tore::new(SENSOR, DEPTH);
            let made = arrays(&mut tore, &source, stored, &mut |_, _, _| Ok(())).unwrap();
            assert_eq!(made.array_bytes, 128 + 64 * 48 * 6 * stored.bytes());
        }
    }

    #[test]
    fn a_queue_outlives_its_window_but_its_events_come_once() {
        let window_us = u64::from(WINDOW_US);
        let events = [
            event(0, 1, 1, true),
            event(1000, 1, 1, true),
            event(window_us + 5, 1, 1, true),
            // Two windows later, and at an age that is not distinguished.
            event(4 * window_us - 100, 1, 1, true),
        ];
        let source = source(&events);
        let mut tore = Tore::new(SENSOR, DEPTH);
        let found = decoded(&mut tore, &source, Stored::F32);
        let mut expected = events;
        expected[3].t_us = 4 * window_us - 75;
        assert_eq!(found, expected);
    }

    #[test]
    fn numbers_of_earlier_windows_are_not_kept_for_the_link() {
        let events = [event(0, 1, 1, true), event(40_000, 9, 1, true)];
        let mut windows = Vec::new();
        let mut tore = Tore::new(SENSOR, 2);
        arrays(
            &mut tore,
            &source(&events),
            Stored::F32,
            &mut |_, _, array| {
                windows.push((array.pixels.clone(), array.codes.clone()));
                Ok(())
            },
        )
        .unwrap();
        let nothing = (value_max() as f32).to_bits();
        for ((pixels, codes), number) in windows.iter().zip([64 + 1, 64 + 9]) {
            assert_eq!(pixels, &[number]);
            assert_ne!(codes[0], nothing);
            assert_eq!(codes[1..], [nothing; 3]);
        }
        assert_eq!(windows.len(), 2);
    }
}
