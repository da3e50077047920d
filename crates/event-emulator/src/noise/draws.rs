//! Random numbers that belong to a pixel: the same whatever other pixels draw, and in whichever order.

/// A pixel's, or a tile's, own sequence of random numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Draws {
    key: u64,
    count: u32,
}

impl Draws {
    /// Returns the sequence of something with number `index` of kind `kind`.
    pub(crate) fn new(seed: u64, kind: u64, index: u64) -> Self {
        let key = mix(seed ^ kind.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        Self {
            key: mix(key.wrapping_add(index.wrapping_mul(0xd1b5_4a32_d192_ed03))),
            count: 0,
        }
    }

    /// Returns 64 random bits: SplitMix64, started at the key.
    fn bits(&mut self) -> u64 {
        self.count = self.count.wrapping_add(1);
        let step = u64::from(self.count).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mix(self.key.wrapping_add(step))
    }

    /// Returns a uniform value in (0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        ((self.bits() >> 11) as f64 + 0.5) * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Returns a normal value of mean 0 and variance 1, within +-3.5: the sum of four uniform values.
    pub(crate) fn normal(&mut self) -> f64 {
        let bits = self.bits();
        let sum: u64 = (0..4).map(|i| (bits >> (16 * i)) & 0xffff).sum();
        // The sum's mean is 2 (1 - 2^-16) and its variance 4/12 (1 - 2^-32), in units of 2^16.
        ((sum as f64 + 2.0) * (1.0 / 65_536.0) - 2.0) * 1.732_050_807_568_877_2
    }

    /// Returns an exponentially distributed value of mean 1.
    pub(crate) fn exponential(&mut self) -> f64 {
        -libm::log(self.unit())
    }
}

/// Spreads a number's bits: SplitMix64's last step.
fn mix(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_their_means_and_variances_within_and_across_sequences() {
        let mut one = Draws::new(7, 1, 0);
        let within: Vec<[f64; 3]> = (0..100_000)
            .map(|_| [one.unit(), one.normal(), one.exponential()])
            .collect();
        let across: Vec<[f64; 3]> = (0..100_000)
            .map(|index| {
                let mut draws = Draws::new(7, 1, index);
                [draws.unit(), draws.normal(), draws.exponential()]
            })
            .collect();
        for values in [within, across] {
            for (i, (mean, variance)) in [(0.5, 1.0 / 12.0), (0.0, 1.0), (1.0, 1.0)]
                .into_iter()
                .enumerate()
            {
                let sum: f64 = values.iter().map(|v| v[i]).sum();
                let seen = sum / 1e5;
                assert!((seen - mean).abs() < 0.015, "{i}: {seen}");
                let squares: f64 = values.iter().map(|v| (v[i] - seen).powi(2)).sum();
                let seen = squares / 1e5;
                assert!((seen / variance - 1.0).abs() < 0.03, "{i}: {seen}");
            }
        }
    }

    #[test]
    fn neighbours_and_kinds_are_not_correlated() {
        let products = |a: fn(u64) -> Draws, b: fn(u64) -> Draws| -> f64 {
            let sum: f64 = (0..100_000).map(|i| a(i).normal() * b(i).normal()).sum();
            sum / 1e5
        };
        let own = |i| Draws::new(1, 1, i);
        for other in [
            |i| Draws::new(1, 1, i + 1),
            |i| Draws::new(1, 2, i),
            |i| Draws::new(2, 1, i),
        ] {
            let seen = products(own, other);
            assert!(seen.abs() < 0.015, "{seen}");
        }
    }
}
