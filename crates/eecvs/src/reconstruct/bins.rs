//! Event times from Haar coefficients: signed counts per bin, and events dealt to the bins one by one.
//!
//! Each event goes to the bin with the largest remaining count of its polarity; of a run of equal counts, which
//! pruning leaves, to its middle. A tree over the bins finds that run, so an event costs log K.

use super::Pixel;
use super::cost;
use super::pursuit::Placed;
use super::refine::Work;
use super::volume::inverse::Inverse;

/// Counts that differ by no more are equal.
const ALIKE: f64 = 1e-9;

/// Assigns a pixel's events to the bins whose signed counts, of which `table` has the weights, they fit best.
#[must_use]
pub fn dealt(table: &Inverse, pixel: &Pixel, work: &mut Work) -> Vec<Placed> {
    let mut values = Vec::new();
    table.values(pixel, &mut values);
    let events = u64::from(pixel.on) + u64::from(pixel.off);
    let grid = values.len();
    work.spend(cost::bins(
        grid as u64,
        pixel.coefficients.len() as u64,
        events,
    ));
    let mut missing = Missing::new(&values);
    let mut dealt = Vec::with_capacity(events as usize);
    let mut held = vec![0_u32; grid];
    let (mut on, mut off) = (pixel.on, pixel.off);
    while on > 0 || off > 0 {
        let (most_on, most_off) = (missing.most(), missing.least());
        let is_on = off == 0 || (on > 0 && missing.at(most_on) >= -missing.at(most_off));
        let (bin, sign) = if is_on {
            (most_on, 1.0)
        } else {
            (most_off, -1.0)
        };
        if is_on {
            on -= 1;
        } else {
            off -= 1;
        }
        missing.take(bin, sign);
        held[bin] += 1;
        dealt.push((bin, sign));
    }
    // Spread the events of one bin evenly over it.
    let mut placed_in = vec![0_u32; grid];
    dealt
        .into_iter()
        .map(|(bin, sign)| {
            let within = (f64::from(placed_in[bin]) + 0.5) / f64::from(held[bin]);
            placed_in[bin] += 1;
            ((bin as f64 + within) / grid as f64, sign)
        })
        .collect()
}

/// The smallest and the largest value of some bins.
#[derive(Debug, Clone, Copy)]
struct Span {
    least: f64,
    most: f64,
}

/// Signed counts that are still missing, per bin.
#[derive(Debug)]
struct Missing {
    /// Number of leaves, a power of two.
    leaves: usize,
    /// A tree: the root at 1, the children of i at 2 i and 2 i + 1, the bins at `leaves`.
    spans: Vec<Span>,
}

impl Missing {
    fn new(values: &[f64]) -> Self {
        let leaves = values.len().next_power_of_two();
        // No bin: neither the smallest nor the largest.
        let none = Span {
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
        };
        let mut spans = vec![none; 2 * leaves];
        for (span, value) in spans[leaves..].iter_mut().zip(values) {
            *span = Span {
                least: *value,
                most: *value,
            };
        }
        let mut tree = Self { leaves, spans };
        (1..leaves).rev().for_each(|node| tree.join(node));
        tree
    }

    /// Computes a node from its children.
    fn join(&mut self, node: usize) {
        let (a, b) = (self.spans[2 * node], self.spans[2 * node + 1]);
        self.spans[node] = Span {
            least: a.least.min(b.least),
            most: a.most.max(b.most),
        };
    }

    fn at(&self, bin: usize) -> f64 {
        self.spans[self.leaves + bin].most
    }

    /// Takes an event of polarity `sign` from a bin.
    fn take(&mut self, bin: usize, sign: f64) {
        let mut node = self.leaves + bin;
        let value = self.at(bin) - sign;
        self.spans[node] = Span {
            least: value,
            most: value,
        };
        while node > 1 {
            node /= 2;
            self.join(node);
        }
    }

    /// Returns the middle of the first run of largest values.
    fn most(&self) -> usize {
        let limit = self.spans[1].most - ALIKE;
        self.middle(|span| span.most >= limit, |span| span.least < limit)
    }

    /// Returns the middle of the first run of smallest values.
    fn least(&self) -> usize {
        let limit = self.spans[1].least + ALIKE;
        self.middle(|span| span.least <= limit, |span| span.most > limit)
    }

    /// Returns the middle of the first run of bins that `is_in` holds for and `is_out` does not; of several bins, both
    /// say whether there is one.
    fn middle(&self, is_in: impl Fn(&Span) -> bool, is_out: impl Fn(&Span) -> bool) -> usize {
        let start = self.first(0, is_in).unwrap_or(0);
        let end = self.first(start, is_out).unwrap_or(self.leaves);
        start + end.saturating_sub(start + 1) / 2
    }

    /// Returns the first bin from `from` on for which `is_wanted` holds.
    fn first(&self, from: usize, is_wanted: impl Fn(&Span) -> bool) -> Option<usize> {
        let mut node = self.leaves + from;
        while !is_wanted(&self.spans[node]) {
            // On to the bins right of these.
            while node % 2 == 1 {
                node /= 2;
            }
            if node == 0 {
                return None;
            }
            node += 1;
        }
        while node < self.leaves {
            node *= 2;
            if !is_wanted(&self.spans[node]) {
                node += 1;
            }
        }
        Some(node - self.leaves)
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Transform;
    use proptest::prelude::*;

    use super::*;

    /// Returns the middle of the first run of bins where `sign` * value is largest, by looking at all of them.
    fn plateau(values: &[f64], sign: f64) -> usize {
        let most = values
            .iter()
            .fold(f64::NEG_INFINITY, |most, value| most.max(sign * value));
        let is_most = |value: &f64| sign * value >= most - ALIKE;
        let start = values.iter().position(is_most).unwrap_or(0);
        let len = values[start..]
            .iter()
            .take_while(|value| is_most(value))
            .count();
        start + len.saturating_sub(1) / 2
    }

    proptest! {
        #[test]
        fn the_tree_finds_what_a_look_at_all_bins_finds(
            log2 in 0..7_u32,
            coarse in proptest::collection::vec(-3..4_i8, 64),
            taken in proptest::collection::vec((any::<usize>(), any::<bool>()), 0..40),
        ) {
            let bins = 1 << log2;
            let mut values: Vec<f64> = coarse[..bins].iter().map(|value| f64::from(*value)).collect();
            let mut missing = Missing::new(&values);
            for (bin, is_on) in taken {
                prop_assert_eq!(missing.most(), plateau(&values, 1.0));
                prop_assert_eq!(missing.least(), plateau(&values, -1.0));
                let (bin, sign) = (bin % bins, if is_on { 1.0 } else { -1.0 });
                values[bin] -= sign;
                missing.take(bin, sign);
                prop_assert_eq!(missing.at(bin), values[bin]);
            }
        }

        #[test]
        fn all_values_are_those_of_each_bin(
            log2 in 0..7_u32,
            coefficients in proptest::collection::btree_map(0..64_u16, -30.0..30.0, 0..20),
        ) {
            let grid = 1_u16 << log2;
            let table = Inverse::new(Transform::Dwt, grid, grid.into());
            let pixel = Pixel {
                x: 0,
                y: 0,
                on: 5,
                off: 3,
                coefficients: coefficients
                    .into_iter()
                    .filter(|(k, _)| *k < grid)
                    .map(|(k, re)| (k, re, 0.0))
                    .collect(),
                times: vec![],
            };
            let mut values = Vec::new();
            table.values(&pixel, &mut values);
            let each: Vec<f64> = (0..grid.into()).map(|bin| table.value(&pixel, bin)).collect();
            prop_assert_eq!(values, each);
        }
    }
}
