//! The closed form of a photoreceptor's output between two samples of its light.

/// The output v2 of a pixel's photoreceptor, and the leak of its reference, as a function of the time since the last
/// sample:
///
/// ```text
/// v2(s) + leak s = at_0 + slope s + a e^(-w1 s) + b e^(-w2 s)
/// ```
#[derive(Debug, Clone, Copy)]
pub(crate) struct Response {
    at_0: f64,
    slope: f64,
    a: f64,
    b: f64,
    w1: f64,
    w2: f64,
}

/// What a pixel is at the beginning of the time between two samples.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    /// Input ln I.
    pub(crate) x: f32,
    /// Output of the first pole.
    pub(crate) v1: f32,
    /// Output of the second pole.
    pub(crate) v2: f32,
}

impl Response {
    /// Solves a photoreceptor's equations for an input that changes by `x_slope` per second and poles `w1` and `w2` in
    /// rad/s that differ; `leak` in 1/s is added to the output's slope.
    pub(crate) fn new(state: State, x_slope: f64, (w1, w2): (f32, f32), leak: f64) -> Self {
        let (w1, w2) = (f64::from(w1), f64::from(w2));
        let lag = x_slope / w1;
        // v1(s) = x + x_slope s - lag + d e^(-w1 s)
        let d = f64::from(state.v1) - (f64::from(state.x) - lag);
        let a = d * w2 / (w2 - w1);
        let at_0 = f64::from(state.x) - lag - x_slope / w2;
        Self {
            at_0,
            slope: x_slope + leak,
            a,
            b: f64::from(state.v2) - at_0 - a,
            w1,
            w2,
        }
    }

    /// Returns the output, and its slope, `s` seconds after the sample.
    pub(crate) fn at(&self, s: f64) -> (f64, f64) {
        let (a, b) = self.decayed(s);
        (
            self.at_0 + self.slope * s + a + b,
            self.slope - self.w1 * a - self.w2 * b,
        )
    }

    /// Returns the two exponentials `s` seconds after the sample.
    fn decayed(&self, s: f64) -> (f64, f64) {
        let [first, second] = exp([-self.w1 * s, -self.w2 * s]);
        (self.a * first, self.b * second)
    }

    /// Returns the faster of the two poles, in rad/s.
    pub(crate) fn fastest(&self) -> f64 {
        self.w1.max(self.w2)
    }

    /// Returns the second derivative of the output `s` seconds after the sample.
    pub(crate) fn bend(&self, s: f64) -> f64 {
        let (a, b) = self.decayed(s);
        self.w1 * self.w1 * a + self.w2 * self.w2 * b
    }
}

/// Returns e^x of two numbers from -600 to 0, within 1e-13 (1 - x/10) of their values; below, e^-600. Both at once fill
/// a vector.
fn exp(x: [f64; 2]) -> [f64; 2] {
    // 1.5 * 2^52: adding it leaves the nearest whole number in the low bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    // Taylor's series to the 11th power: the rest of x is within +-0.35, the next term is below 7e-15.
    const TERMS: [f64; 12] = [
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    let x = x.map(|x| if x < -600.0 { -600.0 } else { x });
    let rounded = x.map(|x| x * core::f64::consts::LOG2_E + ROUND);
    let rest: [f64; 2] =
        core::array::from_fn(|i| x[i] - (rounded[i] - ROUND) * core::f64::consts::LN_2);
    let mut p = [TERMS[0]; 2];
    for term in &TERMS[1..] {
        p = core::array::from_fn(|i| p[i] * rest[i] + term);
    }
    core::array::from_fn(|i| {
        let power = rounded[i].to_bits().wrapping_sub(ROUND.to_bits());
        f64::from_bits(p[i].to_bits().wrapping_add(power << 52))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_within_its_error() {
        for i in 0..40_000 {
            let x = [f64::from(i) * -1e-3, f64::from(i) * -1e-2];
            for (x, seen) in x.into_iter().zip(exp(x)) {
                let error = (seen / libm::exp(x) - 1.0).abs();
                assert!(error < 1e-13 * (1.0 - 0.1 * x), "{x}: {error}");
            }
        }
        assert_eq!(exp([0.0, 0.0]), [1.0, 1.0]);
        assert!(
            exp([-1e9, f64::NEG_INFINITY])
                .iter()
                .all(|e| *e > 0.0 && *e < 1e-200)
        );
    }

    /// Integrates the equations in small steps.
    fn integrate(state: State, x_slope: f64, (w1, w2): (f64, f64), leak: f64, until: f64) -> f64 {
        let steps = 200_000;
        let step = until / f64::from(steps);
        let (x, mut v1, mut v2) = (f64::from(state.x), f64::from(state.v1), f64::from(state.v2));
        for i in 0..steps {
            // The midpoint rule, of second order.
            let s = f64::from(i) * step;
            let (h1, h2) = (
                v1 + 0.5 * step * w1 * (x + x_slope * s - v1),
                v2 + 0.5 * step * w2 * (v1 - v2),
            );
            v1 += step * w1 * (x + x_slope * (s + 0.5 * step) - h1);
            v2 += step * w2 * (h1 - h2);
        }
        v2 + leak * until
    }

    #[test]
    fn closed_form_solves_the_equations() {
        let state = State {
            x: 5.0,
            v1: 4.5,
            v2: 4.75,
        };
        for (w1, w2) in [(100.0, 2_000.0), (5_000.0, 300.0), (980.0, 1_000.0)] {
            for x_slope in [-200.0, 0.0, 30.0] {
                let response = Response::new(state, x_slope, (w1, w2), 0.5);
                for until in [1e-4, 3e-3] {
                    let poles = (f64::from(w1), f64::from(w2));
                    let expected = integrate(state, x_slope, poles, 0.5, until);
                    let (value, slope) = response.at(until);
                    assert!((value - expected).abs() < 1e-7, "{value} {expected}");
                    let step = 1e-7;
                    let (before, after) = (response.at(until - step), response.at(until + step));
                    let rise = (after.0 - before.0) / (2.0 * step);
                    assert!(
                        (slope - rise).abs() < 1e-4 * (1.0 + rise.abs()),
                        "{slope} {rise}"
                    );
                    let bend = (after.1 - before.1) / (2.0 * step);
                    let error = (response.bend(until) - bend).abs();
                    assert!(error < 1e-3 * (1.0 + bend.abs()), "{error}");
                }
            }
        }
    }
}
