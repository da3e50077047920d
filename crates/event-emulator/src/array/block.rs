//! Many pixels at once, from one sample of their light to the next.

use super::Physics;
use crate::math;
use crate::photoreceptor::{Photoreceptor, State};
use crate::wide::wide;

/// Pixels that are computed together.
pub(super) const BLOCK: usize = 64;

/// The time between two samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) from_ns: u64,
    pub(super) to_ns: u64,
    pub(super) seconds: f32,
    /// e^(-w2 seconds) of the second pole.
    decay: f32,
}

impl Span {
    pub(super) fn new(from_ns: u64, to_ns: u64, photoreceptor: &Photoreceptor) -> Self {
        let seconds = ((to_ns - from_ns) as f64 * 1e-9) as f32;
        Self {
            from_ns,
            to_ns,
            seconds,
            decay: math::exp(-photoreceptor.second_pole * seconds),
        }
    }
}

/// What the pixels of a block were at the beginning of the span, and what holds during the span.
#[derive(Debug)]
pub(super) struct Before {
    x: [f32; BLOCK],
    v1: [f32; BLOCK],
    v2: [f32; BLOCK],
    reference: [f32; BLOCK],
    hazard: [f32; BLOCK],
    /// First poles in rad/s.
    pole: [f32; BLOCK],
    /// Leakage in natural log units per second.
    leak: [f32; BLOCK],
    /// Whether the hazards are those of before: there was too much light for noise.
    is_silent: bool,
}

impl Default for Before {
    fn default() -> Self {
        let none = [0.0; BLOCK];
        Self {
            x: none,
            v1: none,
            v2: none,
            reference: none,
            hazard: none,
            pole: none,
            leak: none,
            is_silent: true,
        }
    }
}

/// What one pixel was at the beginning of the span, and what holds during the span.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) state: State,
    /// Input at the end.
    pub(super) next: f32,
    pub(super) reference: f32,
    pub(super) hazard: f32,
    /// First pole in rad/s.
    pub(super) pole: f32,
    /// Leakage in natural log units per second.
    pub(super) leak: f32,
}

impl Before {
    /// Keeps the hazards before they change, if nothing has changed them yet.
    pub(super) fn keep_hazards(&mut self, hazard: &[f32]) {
        if self.is_silent {
            self.hazard[..hazard.len()].copy_from_slice(hazard);
            self.is_silent = false;
        }
    }

    /// Returns one pixel, whose input and hazard at the end of the span are `next` and `hazard`.
    pub(super) fn lane(&self, lane: usize, next: f32, hazard: f32) -> Start {
        Start {
            state: State {
                x: self.x[lane],
                v1: self.v1[lane],
                v2: self.v2[lane],
            },
            next,
            reference: self.reference[lane],
            hazard: if self.is_silent {
                hazard
            } else {
                self.hazard[lane]
            },
            pole: self.pole[lane],
            leak: self.leak[lane],
        }
    }
}

/// The pixels of a block: slices of equal length, at most [`BLOCK`].
pub(super) struct Lanes<'a> {
    /// Input and current at the end.
    pub(super) next: &'a [f32],
    pub(super) next_current: &'a [f32],
    pub(super) current: &'a mut [f32],
    pub(super) x: &'a mut [f32],
    pub(super) v1: &'a mut [f32],
    pub(super) v2: &'a mut [f32],
    pub(super) reference: &'a mut [f32],
    pub(super) on: &'a [f32],
    pub(super) off: &'a [f32],
    pub(super) hazard: &'a mut [f32],
    pub(super) leak: &'a [f32],
}

impl Lanes<'_> {
    /// Takes the pixels to the end of the span, and returns those that may have to fire in it, a bit each.
    pub(super) fn advance(mut self, span: &Span, physics: &Physics, before: &mut Before) -> u64 {
        advance_wide(&mut self, span, physics, before)
    }
}

fn advance_wide(lanes: &mut Lanes<'_>, span: &Span, physics: &Physics, before: &mut Before) -> u64 {
    wide!(advance, lanes: &mut Lanes<'_>, span: &Span, physics: &Physics, before: &mut Before; u64)
}

#[inline(always)]
fn advance(lanes: &mut Lanes<'_>, span: &Span, physics: &Physics, before: &mut Before) -> u64 {
    // Equal lengths that the compiler can see.
    let count = lanes.next.len().min(BLOCK);
    let (next, x) = (&lanes.next[..count], &mut lanes.x[..count]);
    let (next_current, current) = (&lanes.next_current[..count], &mut lanes.current[..count]);
    let (v1, v2) = (&mut lanes.v1[..count], &mut lanes.v2[..count]);
    let (reference, hazard) = (&mut lanes.reference[..count], &mut lanes.hazard[..count]);
    let (on, off, leak) = (
        &lanes.on[..count],
        &lanes.off[..count],
        &lanes.leak[..count],
    );
    let (poles, leaks) = (&mut before.pole[..count], &mut before.leak[..count]);
    let (before_x, before_v1) = (&mut before.x[..count], &mut before.v1[..count]);
    let (before_v2, before_reference) = (&mut before.v2[..count], &mut before.reference[..count]);

    // Bits of positive numbers have the numbers' order.
    let mut lowest = u32::MAX;
    for i in 0..count {
        let mean = 0.5 * (current[i] + next_current[i]);
        current[i] = next_current[i];
        poles[i] = physics.photoreceptor.first_pole(mean);
        leaks[i] = leak[i] + physics.leak_per_lux * mean;
        lowest = lowest.min(poles[i].to_bits());
    }

    let seconds = span.seconds;
    let per_span = 1.0 / seconds;
    let second_pole = physics.photoreceptor.second_pole;
    let per_second_pole = 1.0 / second_pole;
    let decay = span.decay;
    // All bits of a pixel that may have to fire.
    let mut due = [0_u32; BLOCK];
    for i in 0..count {
        let (x0, x1, u, v) = (x[i], next[i], v1[i], v2[i]);
        let (pole, leak) = (poles[i], leaks[i]);
        let slope = (x1 - x0) * per_span;
        // 1/w1 and w2/(w2 - w1), with one division.
        let apart = second_pole - pole;
        let quotient = 1.0 / (pole * apart);
        let lag = slope * (apart * quotient);
        let d = u - (x0 - lag);
        let a = d * (second_pole * pole * quotient);
        let behind = lag + slope * per_second_pole;
        let b = v - (x0 - behind) - a;
        let first_decay = math::exp(-pole * seconds);
        let u1 = x1 - lag + d * first_decay;
        let v1_ = x1 - behind + a * first_decay + b * decay;
        let reference0 = reference[i];
        let reference1 = reference0 - leak * seconds;
        let (begin, end) = (v - reference0, v1_ - reference1);
        let rise0 = second_pole * (u - v) + leak;
        let rise1 = second_pole * (u1 - v1_) + leak;
        // Where the output turns within the span, its tangents bound how far it goes.
        let (steep0, steep1) = (absolute(rise0), absolute(rise1));
        let less = if steep0 < steep1 { steep0 } else { steep1 };
        let bulge = if rise0 * rise1 < 0.0 {
            less * seconds
        } else {
            0.0
        };
        let highest = if begin > end { begin } else { end } + bulge;
        let lowest = if begin < end { begin } else { end } - bulge;
        (before_x[i], before_v1[i]) = (x0, u);
        (before_v2[i], before_reference[i]) = (v, reference0);
        (x[i], v1[i], v2[i]) = (x1, u1, v1_);
        reference[i] = reference1;
        let is_due = (highest >= on[i]) | (lowest <= -off[i]) | (on[i] == f32::INFINITY);
        due[i] = u32::from(is_due).wrapping_neg();
    }
    let mut noisy = [0_u32; BLOCK];
    before.is_silent = physics.noise.is_silent(f32::from_bits(lowest));
    if !before.is_silent {
        let before_hazard = &mut before.hazard[..count];
        for i in 0..count {
            before_hazard[i] = hazard[i];
            hazard[i] -= physics.noise.rate(poles[i]) * seconds;
            noisy[i] = u32::from(hazard[i] <= 0.0).wrapping_neg();
        }
    }
    for (due, noisy) in due.iter_mut().zip(&noisy) {
        *due |= noisy;
    }
    let (low, high) = due.split_at(BLOCK / 2);
    u64::from(bits(low)) | u64::from(bits(high)) << 32
}

/// Returns a bit for each of 32 values whose bits are all set or all clear.
#[inline(always)]
fn bits(due: &[u32]) -> u32 {
    const PLACES: [u32; 32] = {
        let mut places = [0; 32];
        let mut i = 0;
        while i < 32 {
            places[i] = 1 << i;
            i += 1;
        }
        places
    };
    let places = due.iter().zip(&PLACES);
    places.fold(0, |bits, (due, place)| bits | due & place)
}

#[inline(always)]
fn absolute(value: f32) -> f32 {
    f32::from_bits(value.to_bits() & 0x7fff_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::Draws;
    use crate::parameters::PixelParameters;

    /// Arrays of pixels: next, next_current, x, current, v1, v2, reference, on, off, hazard, leak.
    fn pixels(count: usize, seed: u64) -> [Vec<f32>; 11] {
        let mut draws = Draws::new(seed, 9, 0);
        let mut pixel = || {
            let x = 2.0 + 6.0 * draws.unit();
            let mut near = |spread: f64| (x + spread * (draws.unit() - 0.5)) as f32;
            let (next, v1, v2, reference) = (near(0.2), near(0.5), near(0.5), near(0.8));
            let in_reset = draws.unit() < 0.1;
            let on = if in_reset { f32::INFINITY } else { 0.25 };
            [
                next,
                math::exp(next),
                x as f32,
                math::exp(x as f32),
                v1,
                v2,
                reference,
                on,
                0.27,
                draws.exponential() as f32 * 1e-3,
                0.03,
            ]
        };
        let mut arrays: [Vec<f32>; 11] = Default::default();
        for _ in 0..count {
            for (array, value) in arrays.iter_mut().zip(pixel()) {
                array.push(value);
            }
        }
        arrays
    }

    fn lanes(arrays: &mut [Vec<f32>; 11]) -> Lanes<'_> {
        let [
            next,
            next_current,
            x,
            current,
            v1,
            v2,
            reference,
            on,
            off,
            hazard,
            leak,
        ] = arrays;
        Lanes {
            next,
            next_current,
            current,
            x,
            v1,
            v2,
            reference,
            on,
            off,
            hazard,
            leak,
        }
    }

    #[test]
    fn wide_vectors_give_the_same_bits() {
        let physics = Physics::new(&PixelParameters::default(), 1, 64);
        for (count, seed) in [(64, 1), (64, 2), (26, 3), (1, 4)] {
            for to_ns in [20_000, 700_000, 9_000_000] {
                let span = Span::new(0, to_ns, &physics.photoreceptor);
                let mut narrow = pixels(count, seed);
                let mut wide = narrow.clone();
                let mut before = [Before::default(), Before::default()];
                let due = advance(&mut lanes(&mut narrow), &span, &physics, &mut before[0]);
                let seen = advance_wide(&mut lanes(&mut wide), &span, &physics, &mut before[1]);
                assert_eq!(due, seen);
                assert!(count < 64 || due != 0);
                assert_eq!(due.checked_shr(count as u32).unwrap_or(0), 0);
                let bits = |arrays: &[Vec<f32>; 11]| -> Vec<u32> {
                    arrays.iter().flatten().map(|v| v.to_bits()).collect()
                };
                assert_eq!(bits(&narrow), bits(&wide));
            }
        }
    }

    /// What is computed for many pixels at once is the closed form of each.
    #[test]
    fn pixels_end_where_their_closed_form_does() {
        let physics = Physics::new(&PixelParameters::default(), 1, 64);
        let span = Span::new(0, 700_000, &physics.photoreceptor);
        let mut arrays = pixels(64, 5);
        let mut before = Before::default();
        advance(&mut lanes(&mut arrays), &span, &physics, &mut before);
        for (lane, (next, end)) in arrays[0].iter().zip(&arrays[5]).enumerate() {
            let start = before.lane(lane, *next, 1.0);
            let slope = f64::from(start.next - start.state.x) / 7e-4;
            let poles = (start.pole, physics.photoreceptor.second_pole);
            let response = crate::photoreceptor::Response::new(start.state, slope, poles, 0.0);
            let (expected, _) = response.at(7e-4);
            assert!((f64::from(*end) - expected).abs() < 3e-5, "{lane}");
        }
    }
}
