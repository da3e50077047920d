//! Sums Haar differences of few events on a small grid, with D_k as a byte and four of them in a word.
//!
//! A pixel of up to [`CHUNK_EVENTS`] events has |D_k| <= 64, so all its differences fit K / 4 words, with D_k in
//! byte k. An event adds the table's row of its bin, or subtracts it, as integers. The sum of +-256^lane over the
//! lanes has the lanes' signed sums as its digits, whatever was borrowed on the way; adding half of a lane's range
//! to each lane separates them again. There are no butterflies and no list of coefficients: which lanes are 0,
//! which are kept and what their levels are is computed for at least four lanes at a time.

#[cfg_attr(target_feature = "sse2", allow(dead_code))]
mod portable;

#[cfg_attr(eecvs_dsp, allow(dead_code))]
mod compare_portable;

#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
mod compare_armv7em;

#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[allow(unsafe_code)]
mod sse2;

#[cfg(eecvs_dsp)]
use compare_armv7em as compare;
#[cfg(not(eecvs_dsp))]
use compare_portable as compare;

use crate::fixed_point::CHUNK_EVENTS;
use crate::group::impulse::Impulse;
use crate::machine::HAS_DSP;
use crate::transform::haar_scale::scale_of;
use crate::transform::phase::PhaseScale;

/// Largest K in this module.
pub const GRID: usize = 32;
/// log2 of [`GRID`].
pub const GRID_LOG2: u32 = GRID.ilog2();
/// Number of words in a row.
const WORDS: usize = GRID / 4;
/// What an event in a bin adds to the lanes: +-256^(k % 4) in word k / 4, summed over k. The first lanes of a finer
/// grid are those of a coarser one, so these rows serve every K.
pub type Row = [u32; WORDS];
/// One row per bin.
pub type Rows = [Row; GRID];

const _: () = assert!(CHUNK_EVENTS <= 64);

static ROWS: Rows = rows();

const fn rows() -> Rows {
    let mut rows: Rows = [[0; WORDS]; GRID];
    let mut bin = 0;
    while bin < GRID {
        // c_0, and then one lane per scale, from the finest to the coarsest.
        rows[bin][0] = 1;
        let mut node = GRID + bin;
        while node > 1 {
            let k = node / 2;
            let one = 1_u32 << (8 * (k % 4));
            let word = rows[bin][k / 4];
            rows[bin][k / 4] = if node % 2 == 1 {
                word.wrapping_sub(one)
            } else {
                word.wrapping_add(one)
            };
            node = k;
        }
        bin += 1;
    }
    rows
}

/// Returns the table, for the assembly.
#[allow(dead_code, reason = "assembly alone asks")]
pub(crate) const fn table() -> &'static Rows {
    &ROWS
}

/// 1 in every lane.
const ONES: u32 = 0x0101_0101;
/// The sign bit of every lane. It also keeps a borrow within its own lane.
const SIGNS: u32 = 0x8080_8080;
/// The lanes of odd scales as one bit per k. Their magnitudes are B sqrt 2 with an integer B.
const ODD: u32 = odd_lanes();

const fn odd_lanes() -> u32 {
    let mut lanes = 0;
    let mut k = 0;
    while k < GRID {
        lanes |= (scale_of(k) % 2) << k;
        k += 1;
    }
    lanes
}

/// Returns, for each kind of word in a row, the least |D| per lane for which the magnitude |D| 2^(j/2) is at least
/// `a`, 1 to 255. Clamped to 127 if lanes are compared as signed numbers, as no lane exceeds 64.
#[inline(always)]
const fn thresholds(a: u32) -> [u32; 4] {
    // ceil(a / 2^(j/2)): sqrt 2 is irrational, and for the other scales ceil(ceil(a / 2) / 2) = ceil(a / 4).
    let scale0 = a;
    let scale1 = ((a as u64 * 0xb504_f333) >> 32) as u32 + 1;
    let scale2 = a.div_ceil(2);
    let scale3 = scale1.div_ceil(2);
    let scale4 = scale2.div_ceil(2);
    [
        (cut(scale0) + (cut(scale1) << 16)) * 0x101,
        cut(scale2) * ONES,
        scale3 * ONES,
        scale4 * ONES,
    ]
}

#[inline(always)]
const fn cut(threshold: u32) -> u32 {
    if HAS_DSP || threshold < 127 {
        threshold
    } else {
        127
    }
}

/// Index of a word's entry in [`thresholds`].
const THRESHOLD_OF_WORD: [usize; WORDS] = [0, 1, 2, 2, 3, 3, 3, 3];

#[cfg(not(all(target_arch = "x86_64", target_feature = "sse2")))]
pub use portable::{Flags, Lanes};
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
pub use sse2::{Flags, Lanes};

/// Returns D_k of at most [`CHUNK_EVENTS`] impulses for K = 2^`bins_log2` up to 4 W. c_0 = D_0 is on - off.
#[inline(always)]
pub fn sum<const W: usize>(
    impulses: impl Iterator<Item = Impulse>,
    scale: PhaseScale,
    bins_log2: u32,
) -> Lanes<W> {
    let mut sums = Lanes::zero();
    for impulse in impulses.take(CHUNK_EVENTS) {
        let bin =
            scale.bin(impulse.offset_us, bins_log2) << (GRID_LOG2.wrapping_sub(bins_log2) & 31);
        let negative = u32::from(impulse.is_on).wrapping_sub(1);
        // Always a row: the offset is below T.
        sums.add(&ROWS[bin as usize % GRID], negative);
    }
    narrow(sums.bytes(), bins_log2)
}

/// Clears the lanes that a smaller K does not have.
#[inline(always)]
fn narrow<const W: usize>(sums: Lanes<W>, bins_log2: u32) -> Lanes<W> {
    if 1 << bins_log2 < 4 * W {
        sums.keep(!(u32::MAX << (1 << bins_log2)))
    } else {
        sums
    }
}

/// Returns the set of the `r` largest |D_k| 2^(j/2), one bit per k, ties to the lower k. `r` is at least 1 and less
/// than the number of differences that are not 0. `events` only sets where the search begins.
///
/// Bisects for an integer that exactly r magnitudes reach. This compares D_k^2 2^j without a key per lane, because
/// |D_k| 2^(j/2) >= a requires the same |D_k| in all lanes of a scale.
#[inline(never)]
pub fn largest<const W: usize>(sums: Lanes<W>, events: u32, r: u32) -> u32 {
    let magnitudes = sums.magnitudes();
    // More than r magnitudes reach `low`, and fewer than r reach `high`; or one reaches 256 and r is 1.
    let (mut low, mut high) = (1, 256);
    let mut reach_low = sums.nonzero();
    let mut reach_high = None;
    let mut left = r;
    // |c_k| of events at arbitrary times is about the square root of their number.
    let mut a = 2 + events / 16;
    while high - low > 1 {
        let reached = magnitudes.reach(a);
        let count = reached.count();
        if count == r {
            return reached.bits();
        }
        if count > r {
            (low, reach_low) = (a, reached);
        } else {
            (high, reach_high, left) = (a, Some(reached), r - count);
        }
        // Upwards by doubling, because most magnitudes are far below 256.
        a = (2 * low).min((low + high) / 2);
    }
    let above = reach_high.map_or(0, Flags::bits);
    // Of the magnitudes in between, those of odd scales are all B sqrt 2 with the same B, and above those of even
    // scales, which equal `low`.
    let band = reach_low.bits() & !above;
    let mut kept = above;
    for ties in [band & ODD, band & !ODD] {
        let mut ties = ties;
        while ties != 0 && left != 0 {
            let lowest = ties & ties.wrapping_neg();
            kept |= lowest;
            ties ^= lowest;
            left -= 1;
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::dwt::magnitude;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Computes D_k by the definition, h(2^j u - m) at the middle of the bin.
    fn expected(impulses: &[Impulse], duration_us: u32, grid: usize) -> Vec<i32> {
        let bin =
            |impulse: &Impulse| u64::from(impulse.offset_us) * grid as u64 / u64::from(duration_us);
        let atom = |k: usize, impulse: &Impulse| {
            if k == 0 {
                return 1;
            }
            let scale = scale_of(k);
            let at = ((bin(impulse) as f64 + 0.5) / grid as f64) * libm::exp2(f64::from(scale));
            let at = at - (k - (1 << scale)) as f64;
            i32::from((0.0..0.5).contains(&at)) - i32::from((0.5..1.0).contains(&at))
        };
        let sign = |impulse: &Impulse| if impulse.is_on { 1 } else { -1 };
        let sum = |k| impulses.iter().map(|i| sign(i) * atom(k, i)).sum();
        (0..grid).map(sum).collect()
    }

    fn lanes_of<const W: usize>(bytes: &[i32]) -> (portable::Lanes<W>, Lanes<W>) {
        // As sums of rows, which can add up to any lanes.
        let mut row = [0_u32; WORDS];
        for (k, byte) in bytes.iter().enumerate() {
            let place = &mut row[k / 4];
            *place = place.wrapping_add((*byte as u32) << (8 * (k % 4)));
        }
        let (mut portable, mut lanes) = (portable::Lanes::zero(), Lanes::zero());
        portable.add(&row, 0);
        lanes.add(&row, 0);
        (portable.bytes(), lanes.bytes())
    }

    fn values<const W: usize>(bytes: [[u8; 4]; W]) -> Vec<i32> {
        let bytes = bytes.as_flattened().iter();
        bytes.map(|byte| i32::from(byte.cast_signed())).collect()
    }

    /// Checks every operation of both kinds of lanes against one lane at a time.
    fn check<const W: usize>(bytes: &[i32], r: u32) {
        let (portable, lanes) = lanes_of::<W>(bytes);
        let mut all = std::vec![0; 4 * W];
        all[..bytes.len()].copy_from_slice(bytes);
        assert_eq!(values(portable.into_bytes()), all);
        assert_eq!(values(lanes.into_bytes()), all);

        let mask = |is_in: &dyn Fn(usize, i32) -> bool| {
            let bits = all.iter().enumerate();
            bits.fold(0_u32, |bits, (k, d)| bits | (u32::from(is_in(k, *d)) << k))
        };
        let nonzero = mask(&|_, d| d != 0);
        let (p, l) = (portable.nonzero(), lanes.nonzero());
        assert_eq!((p.bits(), l.bits()), (nonzero, nonzero));
        assert_eq!(
            (p.count(), l.count()),
            (nonzero.count_ones(), nonzero.count_ones())
        );
        for a in 1..=255 {
            let square = |x: i32| i64::from(x) * i64::from(x);
            let reach = mask(&|k, d| square(d) << scale_of(k) >= square(a));
            let p = portable.magnitudes().reach(a as u32);
            let l = lanes.magnitudes().reach(a as u32);
            assert_eq!((p.bits(), l.bits()), (reach, reach), "{a}");
            assert_eq!(
                (p.count(), l.count()),
                (reach.count_ones(), reach.count_ones())
            );
        }
        let kept = 0x9a3c_56d1_u32.rotate_left(r);
        let cut: Vec<i32> = (0..4 * W)
            .map(|k| all[k] * (kept >> k & 1) as i32)
            .collect();
        assert_eq!(values(portable.keep(kept).into_bytes()), cut);
        assert_eq!(values(lanes.keep(kept).into_bytes()), cut);

        let down: Vec<i32> = all.iter().map(|d| d - i32::from(*d > 0)).collect();
        let spread = down.iter().skip(1).fold(0, |all, l| all | (l ^ (l >> 31)));
        let (p, l) = (portable.levels(), lanes.levels());
        assert_eq!(
            (values(p.into_bytes()), p.spread()),
            (down.clone(), spread as u32)
        );
        assert_eq!((values(l.into_bytes()), l.spread()), (down, spread as u32));

        if nonzero.count_ones() > r {
            let mut order: Vec<usize> = (0..4 * W).collect();
            order.sort_by_key(|k| std::cmp::Reverse(magnitude(all[*k], *k)));
            let expected = order[..r as usize]
                .iter()
                .fold(0, |kept, k| kept | (1 << k));
            for events in [2, 9, 64] {
                assert_eq!(largest(lanes, events, r), expected, "{all:?} {r}");
            }
        }
    }

    /// Any number of events in any one bin, of either polarity, on every K.
    #[test]
    fn events_of_one_bin_are_those_of_the_definition() {
        for bins_log2 in 0..=GRID_LOG2 {
            let grid = 1 << bins_log2;
            let scale = PhaseScale::new(grid as u32);
            for (bin, is_on) in (0..grid as u32).flat_map(|bin| [(bin, false), (bin, true)]) {
                let impulse = Impulse {
                    offset_us: bin,
                    is_on,
                };
                let one = expected(&[impulse], grid as u32, grid);
                for events in 1..=CHUNK_EVENTS {
                    let impulses = std::iter::repeat_n(impulse, events);
                    let found = if grid <= 16 {
                        values(sum::<4>(impulses, scale, bins_log2).into_bytes())
                    } else {
                        values(sum::<8>(impulses, scale, bins_log2).into_bytes())
                    };
                    let expected = one.iter().map(|d| d * events as i32);
                    assert!(found[..grid].iter().copied().eq(expected));
                    assert!(found[grid..].iter().all(|d| *d == 0));
                }
            }
        }
    }

    /// Every |D| of every scale against every threshold, and all pairs of them in order.
    #[test]
    fn every_magnitude_is_told_apart() {
        for d in -64..=64 {
            check::<8>(&[d; 32], 16);
            check::<4>(&[d; 16], 3);
        }
        // One lane of each scale.
        const LANES: [usize; 5] = [1, 3, 6, 9, 20];
        for (a, b) in (1..=64).flat_map(|a| (0..=64).map(move |b| (a, b))) {
            for (j, k) in LANES.iter().flat_map(|j| LANES.map(|k| (*j, k))) {
                let mut all = [0; GRID];
                (all[j], all[k]) = (a, -b);
                if j != k && b > 0 {
                    let first = (magnitude(a, j), std::cmp::Reverse(j));
                    let second = (magnitude(b, k), std::cmp::Reverse(k));
                    let expected = 1 << if first > second { j } else { k };
                    let (_, lanes) = lanes_of::<8>(&all);
                    assert_eq!(largest(lanes, 2, 1), expected, "{a} {j} {b} {k}");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn lanes_of_any_differences(
            bytes in prop::collection::vec(-64..=64_i32, 32), shift in 0..7, r in 1..=32_u32,
        ) {
            // Small differences tie more often.
            let bytes: Vec<i32> = bytes.iter().map(|d| d >> shift).collect();
            check::<8>(&bytes, r);
            check::<4>(&bytes[..16], r);
        }

        #[test]
        fn sums_are_those_of_the_definition(
            events in prop::collection::vec((any::<u32>(), any::<bool>()), 1..=CHUNK_EVENTS),
            shift in 0..32_u32, duration_us: u32, bins_log2 in 0..=GRID_LOG2,
        ) {
            let duration_us = (duration_us >> shift).max(1);
            let scale = PhaseScale::new(duration_us);
            let impulses: Vec<Impulse> = events
                .iter()
                .map(|(seed, is_on)| Impulse { offset_us: seed % duration_us, is_on: *is_on })
                .collect();
            let grid = 1 << bins_log2;
            let mut exact = expected(&impulses, duration_us, grid);
            exact.resize(GRID, 0);
            let wide = sum::<8>(impulses.iter().copied(), scale, bins_log2);
            prop_assert_eq!(&values(wide.into_bytes()), &exact);
            if bins_log2 < GRID_LOG2 {
                let found = sum::<4>(impulses.iter().copied(), scale, bins_log2);
                prop_assert_eq!(&values(found.into_bytes())[..], &exact[..16]);
            }
        }
    }
}
