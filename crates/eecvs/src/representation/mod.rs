//! Dense representations of events for networks, made directly from events, a block at a time.
//!
//! | representation | channels | value |
//! |---|---|---|
//! | [`Voxel`] | B, or 2 B split | sums of polarities, or of bilinear weights, of B time bins |
//! | [`Counts`] | 2 B | numbers of ON and of OFF events of B time bins: a stacked histogram |
//! | [`TimeSurface`] | 2 | exp(-age / tau) of the latest ON and OFF event |
//! | [`Tore`] | 2 k | logarithms of the ages of the latest k ON and k OFF events |
//!
//! All are C x H x W in raster order, ON before OFF. Values that [`crate::reconstruct::volume`] rounds once are sums in
//! `f32` here: a value of n events is off by n 2^-24 of its size at the most, and may depend on the order of the events.
//! Events outside of the times or of the sensor are an error: nothing is left out.
//!
//! ```
//! use eecvs::representation::{Counts, Span};
//! use event_types::stream::MemoryReader;
//! use event_types::{Event, Polarity, Sensor};
//!
//! let sensor = Sensor::new(4, 2).expect("sides from 1 to 2048");
//! let event = |t_us| Event { t_us, x: 3, y: 1, polarity: Polarity::On };
//! let mut reader = MemoryReader::new(sensor, (0..10).map(event).collect());
//! let counts = Counts { span: Span::half_open(0, 10)?, bins: 2, most: 255 };
//! let mut cells = vec![0_u8; counts.channels() * 8];
//! counts.fill(&mut reader, &mut cells)?;
//! assert_eq!((cells[7], cells[8 + 7]), (5, 5));
//! # Ok::<(), eecvs::Error>(())
//! ```

mod counts;
mod recent;
mod voxel;

pub use counts::{Cell, Counts};
pub use recent::{TORE_AGE_MAX_US, TORE_AGE_MIN_US, TimeSurface, Tore};
pub use voxel::Voxel;

use event_types::stream::{EventReader, Result};
use event_types::{Event, Sensor, bail, ensure};

/// Longest span, so that its product with a number of bins fits into 64 bits: 71 years.
const DURATION_MAX_US: u64 = 1 << 51;

/// The times that a representation covers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Span {
    start_us: u64,
    /// At least 1.
    duration_us: u64,
    /// Whether the time `start_us + duration_us` belongs to it, in the last bin.
    is_closed: bool,
}

impl Span {
    /// Returns the times from the first one on to before the other one.
    ///
    /// # Errors
    /// There is no such time, or they are 2^51 us or more.
    pub fn half_open(start_us: u64, end_us: u64) -> Result<Self> {
        let duration_us = end_us.saturating_sub(start_us);
        ensure!(
            (1..DURATION_MAX_US).contains(&duration_us),
            Refused,
            "times from {start_us} us to before {end_us} us: they must be 1 us or more, and fewer than 2^51"
        );
        Ok(Self {
            start_us,
            duration_us,
            is_closed: false,
        })
    }

    /// Returns the times from the first one to the last one, which both belong to it, as of the first and the last of some
    /// events. If they are the same, the span is 1 us long.
    ///
    /// # Errors
    /// The last one is before the first one, or they are 2^51 us or more apart.
    pub fn closed(first_us: u64, last_us: u64) -> Result<Self> {
        ensure!(
            first_us <= last_us,
            Refused,
            "times from {first_us} us to {last_us} us: the last one is before the first one"
        );
        Ok(Self {
            is_closed: true,
            ..Self::half_open(first_us, last_us.max(first_us.saturating_add(1)))?
        })
    }

    /// Returns an error if an event is outside of these times or of the sensor; `index` is the first one's number.
    fn check(&self, sensor: Sensor, events: &[Event], index: u64) -> Result<()> {
        let limit_us = self.duration_us + u64::from(self.is_closed);
        let is_outside = |event: &Event| {
            event.t_us.wrapping_sub(self.start_us) >= limit_us
                || event.x >= sensor.width
                || event.y >= sensor.height
        };
        // Without a branch per event, several are compared at once.
        if !events
            .iter()
            .fold(false, |any, event| any | is_outside(event))
        {
            return Ok(());
        }
        for (index, event) in (index..).zip(events) {
            check_place(sensor, event, index)?;
            ensure!(
                !is_outside(event),
                Refused,
                "event {index} at {} us is outside the times of the volume, from {} us on for {} us",
                event.t_us,
                self.start_us,
                self.duration_us
            );
        }
        Ok(())
    }
}

/// Returns an error if an event is outside of the sensor; `index` is the first one's number.
///
/// # Errors
/// As stated.
pub fn check_places(sensor: Sensor, events: &[Event], index: u64) -> Result<()> {
    // Without a branch per event, several are compared at once.
    let is_outside = |event: &Event| (event.x >= sensor.width) | (event.y >= sensor.height);
    if !events
        .iter()
        .fold(false, |any, event| any | is_outside(event))
    {
        return Ok(());
    }
    (index..)
        .zip(events)
        .try_for_each(|(index, event)| check_place(sensor, event, index))
}

fn check_place(sensor: Sensor, event: &Event, index: u64) -> Result<()> {
    ensure!(
        sensor.contains(event.x, event.y),
        Refused,
        "event {index} at x = {}, y = {} is outside the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// Reads all events in blocks, with the pixel number of each known to be on the sensor.
fn each_block(
    reader: &mut dyn EventReader,
    check: impl Fn(&[Event], u64) -> Result<()>,
    mut block: impl FnMut(&[Event]),
) -> Result<()> {
    let mut events = Vec::new();
    let mut index = 0;
    while reader.read(&mut events)? > 0 {
        check(&events, index)?;
        block(&events);
        index += events.len() as u64;
        events.clear();
    }
    Ok(())
}

/// Returns the pixels of the sensor, and an error unless `cells` has room for `channels` planes of them.
fn planes(sensor: Sensor, channels: usize, cells: usize) -> Result<usize> {
    let pixels = sensor.pixels() as usize;
    if channels == 0 || channels * pixels != cells {
        bail!(
            Refused,
            "an array of {channels} x {} x {} values is needed, not one of {cells}",
            sensor.height,
            sensor.width
        );
    }
    Ok(pixels)
}

/// Divides times of a span by its duration, exactly: a multiplication in place of a division of 64 bits.
#[derive(Debug, Clone, Copy)]
struct Divider {
    duration_us: u64,
    reciprocal: f64,
}

impl Divider {
    fn new(span: Span) -> Self {
        Self {
            duration_us: span.duration_us,
            reciprocal: 1.0 / span.duration_us as f64,
        }
    }

    /// Returns quotient and remainder of `number` and the duration; the quotient is below 2^17.
    #[inline]
    fn divide(self, number: u64) -> (u64, u64) {
        // Off by one at most, since the rounded product is off by less than 2^-34.
        let quotient = (number as f64 * self.reciprocal) as u64;
        let rest = number.wrapping_sub(quotient * self.duration_us);
        if rest as i64 >= self.duration_us as i64 {
            (quotient + 1, rest - self.duration_us)
        } else if (rest as i64) < 0 {
            (quotient - 1, rest.wrapping_add(self.duration_us))
        } else {
            (quotient, rest)
        }
    }
}

#[cfg(test)]
mod tests {
    use event_types::stream::MemoryReader;
    use event_types::test_events::event;
    use proptest::prelude::*;

    use super::*;
    use crate::reconstruct::volume::Weights;

    const SENSOR: Sensor = Sensor {
        width: 5,
        height: 3,
    };

    proptest! {
        #[test]
        fn quotients_are_exact(duration_us in 1..DURATION_MAX_US, since in 0..DURATION_MAX_US, bins in 1_u64..4097) {
            let span = Span::half_open(0, duration_us).unwrap();
            let number = since % (duration_us + 1) * bins;
            let exact = (number / duration_us, number % duration_us);
            prop_assert_eq!(Divider::new(span).divide(number), exact);
            let edge = number / duration_us * duration_us;
            prop_assert_eq!(Divider::new(span).divide(edge), (edge / duration_us, 0));
        }

        #[test]
        fn values_are_the_formulas(
            times in proptest::collection::vec((0_u64..1000, 0_u16..5, 0_u16..3, any::<bool>()), 1..200),
            bins in 1_u16..9,
        ) {
            let mut events: Vec<_> = times.iter().map(|(t, x, y, on)| event(70 + t, *x, *y, *on)).collect();
            events.sort_by_key(|event| event.t_us);
            let reader = || MemoryReader::new(SENSOR, events.clone()).in_batches(7);
            let span = Span::half_open(70, 1070).unwrap();
            let b = f64::from(bins);
            for (weights, split) in [(Weights::Nearest, false), (Weights::Nearest, true), (Weights::Bilinear, false), (Weights::Bilinear, true)] {
                let voxel = Voxel { span, bins, weights, split };
                let mut found = vec![0.0; voxel.channels() * 15];
                voxel.fill(&mut reader(), &mut found).unwrap();
                let mut wanted = vec![0.0; found.len()];
                for event in &events {
                    let u = (event.t_us - 70) as f64 / 1000.0;
                    let on = event.polarity.sign() > 0;
                    let first = if split && !on { usize::from(bins) } else { 0 };
                    let sign = if split || on { 1.0 } else { -1.0 };
                    for bin in 0..usize::from(bins) {
                        let weight = match weights {
                            Weights::Nearest => f64::from(u8::from((u * b + 1e-9).floor() as usize == bin)),
                            Weights::Bilinear => (1.0 - (bin as f64 - (b - 1.0) * u).abs()).max(0.0),
                        };
                        wanted[(first + bin) * 15 + usize::from(event.y) * 5 + usize::from(event.x)] += sign * weight;
                    }
                }
                for (found, wanted) in found.iter().zip(&wanted) {
                    prop_assert!((f64::from(*found) - wanted).abs() < 1e-4, "{} for {}", found, wanted);
                }
            }
            let counts = Counts { span, bins, most: 3 };
            let (mut bytes, mut floats) = (vec![0_u8; counts.channels() * 15], vec![0_f32; counts.channels() * 15]);
            counts.fill(&mut reader(), &mut bytes).unwrap();
            counts.fill(&mut reader(), &mut floats).unwrap();
            let split = Voxel { span, bins, weights: Weights::Nearest, split: true };
            let mut sums = vec![0.0; split.channels() * 15];
            split.fill(&mut reader(), &mut sums).unwrap();
            for ((byte, float), sum) in bytes.iter().zip(&floats).zip(&sums) {
                prop_assert_eq!(f32::from(*byte), sum.min(3.0));
                prop_assert_eq!(*float, sum.min(3.0));
            }
            let surface = TimeSurface { end_us: 1070, tau_us: 250.0 };
            let mut found = vec![9.0; 2 * 15];
            surface.fill(&mut reader(), &mut found).unwrap();
            let tore = Tore { end_us: 1070, depth: 2 };
            let mut ages = vec![9.0; 4 * 15];
            tore.fill(&mut reader(), &mut ages).unwrap();
            for cell in 0..30 {
                let (off, x, y) = (cell >= 15, (cell % 5) as u16, (cell % 15 / 5) as u16);
                let of_cell = events.iter().rev().filter(|event| {
                    (event.x, event.y) == (x, y) && (event.polarity.sign() < 0) == off
                });
                let times: Vec<u64> = of_cell.map(|event| event.t_us).collect();
                let value = times.first().map_or(0.0, |t| (-((1070 - t) as f64) / 250.0).exp());
                prop_assert!((f64::from(found[cell]) - value).abs() < 1e-6);
                for (at, plane) in [0, 1].into_iter().zip([usize::from(off) * 2, usize::from(off) * 2 + 1]) {
                    let age = times.get(at).map_or(5e6, |t| (1070 - t) as f64);
                    let value = ((age + 1.0).ln() - 151_f64.ln()).max(0.0);
                    let found = f64::from(ages[plane * 15 + cell % 15]);
                    prop_assert!((found - value).abs() < 1e-5, "{} for {}", found, value);
                }
            }
        }
    }

    #[test]
    fn what_is_outside_is_refused() {
        let span = Span::half_open(10, 20).unwrap();
        let fill = |event, span| {
            let counts = Counts {
                span,
                bins: 2,
                most: 255,
            };
            counts.fill(&mut MemoryReader::new(SENSOR, vec![event]), &mut [0_u8; 60])
        };
        assert!(fill(event(10, 4, 2, true), span).is_ok());
        for outside in [
            event(9, 0, 0, true),
            event(20, 0, 0, true),
            event(10, 5, 0, true),
            event(10, 0, 3, true),
        ] {
            let error = fill(outside, span).unwrap_err();
            assert!(error.to_string().starts_with("event 0 at"), "{error}");
        }
        let closed = Span::closed(10, 20).unwrap();
        assert!(fill(event(20, 0, 0, true), closed).is_ok());
        assert!(fill(event(21, 0, 0, true), closed).is_err());
        assert!(Span::half_open(10, 10).is_err());
        assert!(Span::closed(10, 9).is_err());
        assert_eq!(Span::closed(10, 10).unwrap().duration_us, 1);
        let counts = Counts {
            span,
            bins: 2,
            most: 255,
        };
        let mut reader = MemoryReader::new(SENSOR, vec![]);
        assert!(counts.fill(&mut reader, &mut [0_u8; 59]).is_err());
    }
}
