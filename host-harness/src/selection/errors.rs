//! The errors at which settings are compared: of times, and of the volume V4.
//!
//! V4 holds, per pixel, the events as signed impulses that are smoothed in time by a Gaussian of sigma = 4 ms:
//!
//! ```text
//! S(t) = sum_i s_i exp(-(t - t_i)^2 / 2 sigma^2),  s_i = 1 (ON) or -1 (OFF)
//! error = sum over pixels of the integral of (S' - S)^2 / that of S^2
//! ```
//!
//! The integral of a product of two such Gaussians is, but for a factor that cancels, exp(-d^2 / 4 sigma^2) of the
//! difference d of their times: a Gaussian of sigma sqrt(2). Differences beyond six times that count as nothing.

use eecvs_nostd::Event;
use event_metrics::emd_pixel::Matcher;
use event_metrics::frame::pixel_order;

/// Sigma of the volume in us.
pub const SIGMA_US: f64 = 4000.0;
/// T in us, which an event without a partner costs.
const UNMATCHED_US: u64 = eecvs_bench::source::WINDOW_US as u64;

/// Errors of decoded events.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// As printed by `eecvs compare`, in us.
    pub emd_pixel_us: f64,
    /// Normalised error of V4.
    pub volume: f64,
}

/// What decoded events are compared with.
#[derive(Debug)]
pub struct Original {
    /// In the order of pixels.
    events: Vec<Event>,
    gaussian: Gaussian,
    /// Integral of S^2, but for a factor.
    power: f64,
}

impl Original {
    /// Prepares to compare with `events`.
    #[must_use]
    pub fn new(events: &[Event]) -> Self {
        let gaussian = Gaussian::new();
        let power = gaussian.power(impulses(events, 1).collect());
        Self {
            events: in_order(events),
            gaussian,
            power,
        }
    }

    /// Returns the errors of decoded events.
    #[must_use]
    pub fn errors(&self, decoded: &[Event]) -> Errors {
        let mut matcher = Matcher::new(UNMATCHED_US);
        matcher.add_window(&self.events, &in_order(decoded));
        Errors {
            emd_pixel_us: matcher.cost() as f64 / self.events.len().max(1) as f64,
            volume: self.volume(decoded),
        }
    }

    /// Returns [`Errors::volume`] alone.
    #[must_use]
    pub fn volume(&self, decoded: &[Event]) -> f64 {
        let difference = impulses(&self.events, -1).chain(impulses(decoded, 1));
        self.gaussian.power(difference.collect()) / self.power
    }
}

fn in_order(events: &[Event]) -> Vec<Event> {
    let mut events = events.to_vec();
    events.sort_unstable_by_key(pixel_order);
    events
}

/// Pixel, time in us, and weight.
type Impulse = ((u16, u16), u64, i32);

fn impulses(events: &[Event], weight: i32) -> impl Iterator<Item = Impulse> {
    let impulse = move |event: &Event| {
        let sign = event.polarity.sign();
        ((event.y, event.x), event.t_us, weight * sign)
    };
    events.iter().map(impulse)
}

/// exp(-d^2 / 4 sigma^2) of every difference d in us that counts.
#[derive(Debug)]
struct Gaussian(Vec<f64>);

impl Gaussian {
    fn new() -> Self {
        let most_us = 6.0 * core::f64::consts::SQRT_2 * SIGMA_US;
        let value = |us: u32| (-(f64::from(us) / (2.0 * SIGMA_US)).powi(2)).exp();
        Self((0..=most_us as u32).map(value).collect())
    }

    /// Returns the integral of the squared sum, but for a factor, over all pixels.
    fn power(&self, mut impulses: Vec<Impulse>) -> f64 {
        impulses.sort_unstable();
        // Those of one time add up; in a difference most of them cancel where times are exact.
        impulses.dedup_by(|next, kept| {
            let is_same = (next.0, next.1) == (kept.0, kept.1);
            if is_same {
                kept.2 += next.2;
            }
            is_same
        });
        impulses.retain(|(.., weight)| *weight != 0);
        let mut power = 0.0;
        for (at, (pixel, t_us, weight)) in impulses.iter().enumerate() {
            let later = impulses.iter().skip(at + 1);
            let mut sum = f64::from(*weight);
            for (other, later_us, other_weight) in later {
                let apart = usize::try_from(later_us - t_us.min(later_us)).unwrap_or(usize::MAX);
                match self.0.get(apart) {
                    Some(value) if other == pixel => sum += 2.0 * f64::from(*other_weight) * value,
                    _ => break,
                }
            }
            power += f64::from(*weight) * sum;
        }
        power
    }
}
