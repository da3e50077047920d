//! Event frames: how many ON and OFF events each pixel has.
//!
//! ```text
//! F[p, y, x] = number of events of polarity p at (x, y) in the window        ON first
//! ```
//!
//! for every window that has events: the two-channel histogram of Maqueda, Loquercio, Gallego, Garcia, Scaramuzza,
//! *Event-based Vision meets Deep Learning on Steering Prediction for Self-driving Cars* (2018). Counts are f32, or
//! u16 or u8, which lose a pixel's 65,536th or 256th event of a polarity and all later ones. A frame carries no
//! times: the decoder spreads n events evenly over the window, the i-th at T (i + 1/2) / n.

use eecvs_nostd::{Polarity, Sensor};

use super::dense_array::{Active, Array, Window};
use super::representation::{Found, Representation};
use super::stored::Range;

/// Makes event frames.
#[derive(Debug, Clone)]
pub struct EventFrame {
    active: Active,
}

impl EventFrame {
    /// Makes frames of the sensor's size.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            active: Active::new(sensor),
        }
    }
}

impl Representation for EventFrame {
    type Work = ();

    fn channels(&self) -> usize {
        2
    }

    fn range(&self) -> Range {
        Range::Counts
    }

    fn has_times(&self) -> bool {
        false
    }

    fn make(&mut self, window: &Window<'_>) -> Array {
        self.active.sums(window.events, 2, |event, counts| {
            let channel = usize::from(event.polarity == Polarity::Off);
            if let Some(count) = counts.get_mut(channel) {
                *count += 1.0;
            }
        })
    }

    fn decode(&self, numbers: &[f64], _step: f64, (): &mut (), found: &mut Vec<Found>) {
        for (count, polarity) in numbers.iter().zip([Polarity::On, Polarity::Off]) {
            // Stored counts are whole numbers.
            found.extend(Found::evenly(*count as u64, polarity));
        }
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;
    use crate::baseline::stored::Stored;
    use crate::baseline::tests::{decoded, source};

    #[test]
    fn counts_are_kept_and_times_are_not() {
        let events = [
            event(0, 1, 2, true),
            event(1, 1, 2, true),
            event(2, 1, 2, false),
            event(3, 4, 4, true),
        ];
        let source = source(&events);
        let expected = [
            event(8192, 1, 2, true),
            event(16_384, 1, 2, false),
            event(16_384, 4, 4, true),
            event(24_576, 1, 2, true),
        ];
        for stored in Stored::ALL {
            let mut frames = EventFrame::new(SENSOR);
            let found = decoded(&mut frames, &source, stored);
            assert_eq!(found, expected, "{}", stored.name());
        }
    }

    #[test]
    fn bytes_hold_255_of_a_pixels_events() {
        let events = vec![event(7, 1, 2, true); 300];
        let source = source(&events);
        for (stored, count) in [
            (Stored::F32, 300),
            (Stored::Bits16, 300),
            (Stored::Bits8, 255),
        ] {
            let mut frames = EventFrame::new(SENSOR);
            assert_eq!(decoded(&mut frames, &source, stored).len(), count);
        }
    }
}
