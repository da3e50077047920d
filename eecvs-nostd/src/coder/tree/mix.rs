//! Mixing of several predictions of one decision, as log odds in integers.
//!
//! Each counter's probability becomes log odds, less of them the less the counter has learned. Three sets of weights,
//! chosen by different contexts, add up to one; the weighted sum is the prediction. A curve, again chosen by a context,
//! corrects it a little. After the decision the weights move by its error and what each counter said, the two points
//! of the curve nearest to it, and the counters.

use super::counter::{Counter, NEAREST_P16};
use super::range::{BitCoder, EVEN_P16};

/// Unit of log odds: 1/256. They reach from -8 to just below 8.
const ODDS: usize = 4096;
const ODDS_HALF: i32 = 2048;

/// Probability in 1/65536 of log odds of -2048 to 2047.
static SQUASH: [u16; ODDS] = {
    // e^(1/256) and 1 in units of 2^-48.
    const E_UP: u128 = 1_157_433_911_791_679_357 >> 12;
    const ONE: u128 = 1 << 48;
    let mut table = [0_u16; ODDS];
    // e^(i/256)
    let mut power = ONE;
    let mut i = 0;
    while i < ODDS / 2 {
        // p = e^x / (1 + e^x), and 1 - p on the other side.
        let p = (power << 16) / (power + ONE);
        let q = 65536 - p;
        table[ODDS / 2 + i] = if p > 65535 { 65535 } else { p as u16 };
        if i > 0 {
            table[ODDS / 2 - i] = if q == 0 { 1 } else { q as u16 };
        }
        power = (power * E_UP) >> 48;
        i += 1;
    }
    table[0] = table[1];
    table
};

/// Log odds of a probability in 1/4096: the lowest whose probability is not below its middle.
static STRETCH: [i16; 4096] = {
    let mut table = [0_i16; 4096];
    let mut x = 0;
    let mut i = 0;
    while i < table.len() {
        let p = (i as u32 * 16 + 8) as u16;
        while x < ODDS - 1 && SQUASH[x] < p {
            x += 1;
        }
        table[i] = (x as i32 - ODDS_HALF) as i16;
        i += 1;
    }
    table
};

/// How far to trust a counter that has learned from n decisions, in 1/256: n / (n + 1), and a little more from 31 on.
static TRUST: [i16; 128] = {
    let mut table = [0; 128];
    let mut n = 0;
    while n < table.len() {
        let more = if n > 30 { 8 } else { 0 };
        table[n] = (256 * n as u32 / (n as u32 + 1)) as i16 + more;
        n += 1;
    }
    table
};

/// Inputs of a mixer: up to 15 counters and a constant.
const LANES: usize = 16;
/// What the constant input says.
const CONSTANT: i32 = 256;

/// Weights of the inputs, in 1/65536 of the sum of three sets.
pub type Weights = [i32; LANES];
/// Weights before anything is learned.
const WEIGHTS: Weights = [4000; LANES];

/// Points of a curve, 128 log odds apart.
const POINTS: usize = 33;
const POINT_SHIFT: u32 = 7;
/// Corrects a probability, by its value at points of log odds.
pub type Curve = [u16; POINTS];
/// The curve that corrects nothing.
const STRAIGHT: Curve = {
    let mut points = [0; POINTS];
    let mut i = 0;
    while i < POINTS {
        let x = i << POINT_SHIFT;
        points[i] = SQUASH[if x > ODDS - 1 { ODDS - 1 } else { x }];
        i += 1;
    }
    points
};

/// How many of each a [`Mixer`] has.
#[derive(Debug, Clone, Copy)]
pub(super) struct MixerSizes {
    pub(super) counters: usize,
    /// Sets of weights, by three contexts.
    pub(super) weights: [usize; 3],
    pub(super) curves: usize,
}

/// Counters that one mark stands for.
const BLOCK: usize = 256;

/// Mark of a block of counters that hold what was learned before the restart, or anything.
const STALE: u8 = 1;

impl MixerSizes {
    /// Number of blocks of counters.
    pub(super) const fn blocks(&self) -> usize {
        self.counters.div_ceil(BLOCK)
    }
}

/// Everything learned of one kind of decision.
#[derive(Debug)]
pub(super) struct Mixer<'m> {
    counters: &'m mut [Counter],
    /// Which blocks of counters are [`STALE`]: these are set when they are first asked. A key frame of few events
    /// asks few of them, and setting all at its start would take longer than it.
    blocks: &'m mut [u8],
    weights: [&'m mut [Weights]; 3],
    curves: &'m mut [Curve],
    /// Decisions so far: the first ones move the weights further.
    decisions: &'m mut u32,
    /// Limit of the counters.
    limit: u32,
}

/// What is lent to mixers; each takes its part from the start.
#[derive(Debug)]
pub(super) struct MixerMemory<'m> {
    pub(super) counters: &'m mut [Counter],
    pub(super) weights: &'m mut [Weights],
    pub(super) curves: &'m mut [Curve],
    pub(super) words: &'m mut [u32],
    pub(super) blocks: &'m mut [u8],
}

fn take<'m, T>(from: &mut &'m mut [T], count: usize) -> Option<&'m mut [T]> {
    from.split_off_mut(..count)
}

impl<'m> MixerMemory<'m> {
    /// Takes a mixer's part; `None` if too little is left.
    pub(super) fn mixer(&mut self, sizes: &MixerSizes, limit: u32) -> Option<Mixer<'m>> {
        let [first, second, third] = sizes.weights;
        Some(Mixer {
            counters: take(&mut self.counters, sizes.counters)?,
            blocks: take(&mut self.blocks, sizes.blocks())?,
            weights: [
                take(&mut self.weights, first)?,
                take(&mut self.weights, second)?,
                take(&mut self.weights, third)?,
            ],
            curves: take(&mut self.curves, sizes.curves)?,
            decisions: self.words.split_off_first_mut()?,
            limit,
        })
    }
}

impl Mixer<'_> {
    /// Forgets everything.
    pub(super) fn restart(&mut self) {
        self.blocks.fill(STALE);
        for weights in &mut self.weights {
            weights.fill(WEIGHTS);
        }
        self.curves.fill(STRAIGHT);
        *self.decisions = 0;
    }

    /// Codes a decision by the counters `at`, the three sets of weights and the curve whose numbers are given.
    #[inline(always)]
    pub(super) fn code<C: BitCoder, const N: usize>(
        &mut self,
        coder: &mut C,
        at: [u32; N],
        sets: [u32; 3],
        curve: u32,
        bit: bool,
    ) -> bool {
        let [first, second, third] = &mut self.weights;
        let (Some(first), Some(second), Some(third), Some(curve)) = (
            first.get_mut(sets[0] as usize),
            second.get_mut(sets[1] as usize),
            third.get_mut(sets[2] as usize),
            self.curves.get_mut(curve as usize),
        ) else {
            // All contexts lie in the sizes that are asked for.
            return coder.bit(EVEN_P16, bit);
        };
        let block = |at: u32| self.blocks.get(at as usize / BLOCK).copied().unwrap_or(0);
        if at.iter().fold(0, |stale, at| stale | block(*at)) != 0 {
            for at in at {
                set_block(self.counters, self.blocks, at as usize / BLOCK);
            }
        }
        let mut inputs = [0_i32; LANES];
        for (input, at) in inputs.iter_mut().zip(at) {
            let counter = self.counters.get(at as usize).copied();
            let counter = counter.unwrap_or(Counter::EVEN);
            let odds = i32::from(STRETCH[counter.p12() as usize & 4095]);
            *input = (odds * i32::from(TRUST[counter.count() as usize & 127])) >> 8;
        }
        if let Some(input) = inputs.get_mut(N) {
            *input = CONSTANT;
        }
        // The lanes in use, in fours; the others say 0.
        let lanes = const { (N + 4) & !3 };
        let mut sum = 0_i32;
        for k in 0..lanes {
            let weight = first[k].wrapping_add(second[k]).wrapping_add(third[k]);
            sum = sum.wrapping_add(inputs[k].wrapping_mul(weight >> 4));
        }
        let odds = ((sum >> 12).clamp(1 - ODDS_HALF, ODDS_HALF - 1) + ODDS_HALF) as usize;
        let mixed = i32::from(SQUASH[odds & (ODDS - 1)]);

        let (low, part) = ((odds >> POINT_SHIFT) & 31, (odds & 127) as i32);
        let (below, above) = (i32::from(curve[low]), i32::from(curve[low + 1]));
        let corrected = (below * (128 - part) + above * part) >> POINT_SHIFT;
        let nearest = NEAREST_P16 as i32;
        let p16 = ((mixed * 3 + corrected) >> 2).clamp(nearest, 65536 - nearest);
        let bit = coder.bit(p16 as u32, bit);

        let target = if bit { 65535 } else { 0 };
        let point = &mut curve[low + usize::from(part >= 64)];
        *point = (i32::from(*point) + ((target - i32::from(*point)) >> 7)) as u16;
        let error = target - mixed;
        *self.decisions = self.decisions.saturating_add(1);
        let rate = error * 2 + ((error * 4) >> (*self.decisions >> 14).min(31));
        for k in 0..lanes {
            let step = (inputs[k].wrapping_mul(rate).wrapping_add(1 << 17)) >> 18;
            first[k] = first[k].wrapping_add(step);
            second[k] = second[k].wrapping_add(step);
            third[k] = third[k].wrapping_add(step);
        }
        for at in at {
            if let Some(counter) = self.counters.get_mut(at as usize) {
                counter.learn(bit, self.limit);
            }
        }
        bit
    }
}

/// Sets a block of counters that is [`STALE`] to what they are before anything is learned.
#[cold]
#[inline(never)]
fn set_block(counters: &mut [Counter], blocks: &mut [u8], block: usize) {
    let counters = counters.chunks_mut(BLOCK).nth(block);
    if let (Some(counters), Some(mark)) = (counters, blocks.get_mut(block))
        && *mark == STALE
    {
        counters.fill(Counter::EVEN);
        *mark = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables are those of docs/wire-format.md: a checksum notices any change.
    #[test]
    fn tables_are_those_of_the_wire_format() {
        assert_eq!(
            (SQUASH[0], SQUASH[1], SQUASH[2048], SQUASH[4095]),
            (23, 23, 32768, 65513)
        );
        assert_eq!(
            (STRETCH[0], STRETCH[2047], STRETCH[2048], STRETCH[4095]),
            (-2048, 0, 1, 2047)
        );
        let sum = |sum: u32, x: u16| sum.wrapping_mul(31).wrapping_add(u32::from(x));
        let squash = SQUASH.iter().fold(0, |s, x| sum(s, *x));
        let stretch = STRETCH.iter().fold(0, |s, x| sum(s, *x as u16));
        assert_eq!((squash, stretch), (2_268_165_961, 2_438_744_340));
    }

    #[test]
    fn log_odds_ascend_with_probability() {
        assert!(SQUASH.windows(2).all(|two| two[0] <= two[1] && two[0] > 0));
        assert!(STRETCH.windows(2).all(|two| two[0] <= two[1]));
    }
}
