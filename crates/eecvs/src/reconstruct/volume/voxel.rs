//! Time bins of events, computed exactly: sums of polarities, or of bilinear weights.
//!
//! ```text
//! nearest:  V[b, y, x] = sum of p over the pixel's events with floor(B (t - t0) / T) = b
//! bilinear: V[b, y, x] = sum of p max(0, 1 - |b - tau|), tau = (B - 1) (t - t0) / T
//! ```
//!
//! T is the window's duration, so windows of equal length have bins of equal length. The bilinear weights are those
//! of Zhu et al. (2019), except that there the first and the last event span the bins. All sums are of integers
//! (bilinear weights in units of 1 / T), so each value is rounded only once and does not depend on the order of the
//! events.

use eecvs_nostd::{Event, Polarity};

use super::super::DecodedWindow;

/// How an event is distributed over the bins.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Weights {
    /// Adds 1 to the bin that contains its time.
    #[default]
    Nearest,
    /// Splits 1 between the two bins nearest to its time.
    Bilinear,
}

/// Bins and the layout of their channels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Form {
    pub bins: u16,
    pub weights: Weights,
    pub split: bool,
}

impl Form {
    pub fn channels(self) -> usize {
        usize::from(self.bins) * if self.split { 2 } else { 1 }
    }
}

/// A contribution to one value.
#[derive(Debug, Clone, Copy)]
struct Part {
    channel: u32,
    /// y W + x.
    pixel: u32,
    /// In units of 1 / `scale`.
    value: i64,
}

/// The nonzero values of a window.
#[derive(Debug)]
pub(super) struct Voxels {
    /// Sorted by channel and pixel.
    parts: Vec<Part>,
    scale: f64,
}

impl Voxels {
    pub fn new(window: &DecodedWindow, form: Form) -> Self {
        let header = &window.header;
        let width = u32::from(header.sensor.width);
        let duration_us = u64::from(header.duration_us.max(1));
        let bins = u64::from(form.bins.max(1));
        let mut parts = Vec::with_capacity(window.events.len());
        for event in &window.events {
            let pixel = u32::from(event.y) * width + u32::from(event.x);
            let (first, value) = sign(event, form);
            // Decoded times lie within their window.
            let since_us = event.t_us.saturating_sub(header.t0_us).min(duration_us - 1);
            let mut add = |bin: u64, value: i64| {
                if value != 0 {
                    let channel = first + bin as u32;
                    parts.push(Part {
                        channel,
                        pixel,
                        value,
                    });
                }
            };
            match form.weights {
                Weights::Nearest => add(since_us * bins / duration_us, value),
                Weights::Bilinear => {
                    let place = since_us * (bins - 1);
                    let (bin, rest) = (place / duration_us, place % duration_us);
                    add(bin, value * (duration_us - rest) as i64);
                    add(bin + 1, value * rest as i64);
                }
            }
        }
        parts.sort_unstable_by_key(|part| (part.channel, part.pixel));
        parts.dedup_by(|part, sum| {
            let same = (part.channel, part.pixel) == (sum.channel, sum.pixel);
            if same {
                // The sum fits: at most 2^24 events with a weight of at most 2^32 each.
                sum.value += part.value;
            }
            same
        });
        let scale = match form.weights {
            Weights::Nearest => 1.0,
            Weights::Bilinear => duration_us as f64,
        };
        Self { parts, scale }
    }

    /// Writes channel `channel` into a plane of zeros.
    pub fn plane(&self, channel: usize, plane: &mut [f32]) {
        let start = self
            .parts
            .partition_point(|part| (part.channel as usize) < channel);
        let parts = self.parts.iter().skip(start);
        for part in parts.take_while(|part| part.channel as usize == channel) {
            if let Some(value) = plane.get_mut(part.pixel as usize) {
                *value = (part.value as f64 / self.scale) as f32;
            }
        }
    }
}

/// Returns the first channel of an event's polarity, and the event's sign there.
fn sign(event: &Event, form: Form) -> (u32, i64) {
    match (event.polarity, form.split) {
        (Polarity::On, _) => (0, 1),
        (Polarity::Off, false) => (0, -1),
        (Polarity::Off, true) => (u32::from(form.bins), 1),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::super::test_header;
    use super::*;

    fn window(duration_us: u32, events: &[(u32, u16, u16, bool)]) -> DecodedWindow {
        DecodedWindow {
            header: test_header::header(duration_us),
            pixels: vec![],
            events: events
                .iter()
                .map(|&(since_us, x, y, on)| Event {
                    t_us: 5000 + u64::from(since_us % duration_us),
                    x,
                    y,
                    polarity: Polarity::from_bool(on),
                })
                .collect(),
        }
    }

    /// Evaluates the module's formulas in f64, one event at a time.
    fn formula(window: &DecodedWindow, form: Form) -> Vec<f64> {
        let (bins, duration_us) = (usize::from(form.bins), f64::from(window.header.duration_us));
        let mut values = vec![0.0; form.channels() * 32];
        for event in &window.events {
            let since_us = (event.t_us - 5000) as f64;
            let at = usize::from(event.y) * 8 + usize::from(event.x);
            let (first, sign) = match (form.split, event.polarity) {
                (true, Polarity::Off) => (bins, 1.0),
                (false, Polarity::Off) => (0, -1.0),
                _ => (0, 1.0),
            };
            for bin in 0..bins {
                let weight = match form.weights {
                    Weights::Nearest => {
                        let own = (since_us * bins as f64 / duration_us).floor() as usize;
                        f64::from(u8::from(own == bin))
                    }
                    Weights::Bilinear => {
                        let tau = (bins - 1) as f64 * since_us / duration_us;
                        (1.0 - (bin as f64 - tau).abs()).max(0.0)
                    }
                };
                values[(first + bin) * 32 + at] += sign * weight;
            }
        }
        values
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn values_are_the_formula_s(
            duration_us in 1_u32..5000,
            events in proptest::collection::vec((any::<u32>(), 0_u16..8, 0_u16..4, any::<bool>()), 0..200),
            bins in 1_u16..20,
            bilinear in any::<bool>(),
            split in any::<bool>(),
        ) {
            let weights = if bilinear { Weights::Bilinear } else { Weights::Nearest };
            let form = Form { bins, weights, split };
            let window = window(duration_us, &events);
            let voxels = Voxels::new(&window, form);
            let wanted = formula(&window, form);
            for (channel, wanted) in wanted.chunks(32).enumerate() {
                let mut plane = [0.0; 32];
                voxels.plane(channel, &mut plane);
                for (value, wanted) in plane.iter().zip(wanted) {
                    prop_assert!((f64::from(*value) - wanted).abs() < 1e-4, "{value} for {wanted}");
                }
            }
        }
    }

    #[test]
    fn opposite_events_cancel() {
        let window = window(100, &[(10, 3, 2, true), (12, 3, 2, false)]);
        let form = Form {
            bins: 4,
            weights: Weights::Nearest,
            split: false,
        };
        let mut plane = [0.0; 32];
        Voxels::new(&window, form).plane(0, &mut plane);
        assert_eq!(plane, [0.0; 32]);
    }
}
