//! Time surfaces: the decayed age of the last event of each pixel and polarity.
//!
//! ```text
//! S[p, y, x] = exp(-(end - t_last) / tau)      0 if there was no event; ON first; tau = T
//! ```
//!
//! at the end of every window that has events: the exponential decay of Lagorce, Orchard, Galluppi, Shi, Benosman,
//! *HOTS: A Hierarchy of Event-Based Time-Surfaces for Pattern Recognition* (2017), for the whole sensor at once
//! and with the window as time constant. Surfaces outlive their windows. Values are f32, or equal levels of u16 or
//! u8 from 0 to 1. The decoder returns one event for every value whose age, -tau ln S, is at most T; all but the
//! last event of a pixel and polarity are lost.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Polarity, Sensor};

use super::dense_array::{Array, Window};
use super::recent::Recent;
use super::representation::{Found, Representation};
use super::stored::Range;

/// Time constant tau, in us.
const DECAY_US: f64 = WINDOW_US as f64;

/// Makes time surfaces.
#[derive(Debug, Clone)]
pub struct TimeSurface {
    recent: Recent,
}

impl TimeSurface {
    /// Starts the surfaces of a sensor without events.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            recent: Recent::new(sensor, 1),
        }
    }
}

fn value(age_us: u64) -> f64 {
    (-(age_us as f64) / DECAY_US).exp()
}

/// Returns the age of a value, to the microsecond; `None` if it is older than the window.
fn age_us(value: f64) -> Option<u32> {
    let age_us = (-DECAY_US * value.ln()).round();
    // A value of 0, of no event, has an infinite age.
    (age_us <= f64::from(WINDOW_US)).then(|| age_us.max(1.0) as u32)
}

impl Representation for TimeSurface {
    type Work = ();

    fn channels(&self) -> usize {
        2
    }

    fn range(&self) -> Range {
        Range::UpTo(1.0)
    }

    fn has_times(&self) -> bool {
        true
    }

    fn make(&mut self, window: &Window<'_>) -> Array {
        self.recent.array(window, |window, t_us| {
            t_us.map_or(0.0, |t_us| value(window.age_us(t_us)))
        })
    }

    fn nothing(&self) -> Option<f64> {
        Some(0.0)
    }

    fn is_news(&self, number: f64) -> bool {
        age_us(number).is_some()
    }

    fn decode(&self, numbers: &[f64], _step: f64, (): &mut (), found: &mut Vec<Found>) {
        for (number, polarity) in numbers.iter().zip([Polarity::On, Polarity::Off]) {
            found.extend(age_us(*number).map(|age_us| Found {
                since_us: WINDOW_US - age_us,
                polarity,
            }));
        }
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::baseline::stored::{Quantiser, Stored};
    use crate::baseline::tests::{decoded, source};

    #[test]
    fn ages_come_back_as_near_as_the_type_can_tell() {
        assert!((value(u64::from(WINDOW_US)) - (-1.0_f64).exp()).abs() < 1e-15);
        assert_eq!(age_us(0.0), None);
        assert_eq!(age_us(value(u64::from(WINDOW_US) + 1)), None);
        assert_eq!(age_us(1.0), Some(1));
        // Half a level over the least value of a window, 1 / e; rounding adds a microsecond.
        for (stored, most) in [
            (Stored::F32, 0.0),
            (Stored::Bits16, 0.5 / 65_535.0),
            (Stored::Bits8, 0.5 / 255.0),
        ] {
            let quantiser = Quantiser::new(Range::UpTo(1.0), stored, 0.0);
            for age in (1..u64::from(WINDOW_US)).step_by(7) {
                let most = DECAY_US * most * 1.01 / value(age) + f64::from(u8::from(most > 0.0));
                match age_us(quantiser.rounded(value(age))) {
                    Some(found) => assert!(u64::from(found).abs_diff(age) as f64 <= most),
                    None => assert!(age as f64 + most > DECAY_US, "{age}"),
                }
            }
        }
    }

    #[test]
    fn the_last_of_each_polarity_comes_back_once() {
        let events = [
            event(100, 1, 2, true),
            event(200, 1, 2, true),
            event(300, 1, 2, false),
            event(40_000, 5, 2, false),
        ];
        let mut surfaces = TimeSurface::new(SENSOR);
        let found = decoded(&mut surfaces, &source(&events), Stored::F32);
        assert_eq!(found, events[1..]);
    }
}
