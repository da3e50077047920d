//! p cos(k a) and p exp(-i k a) for k = 1, 2, ... from a table of one wave with lines between its
//! rows: the DTFT, and the DCT of grids that [`super::rows`] and [`super::fine_rows`] have no atoms of.
//!
//! A row holds a line, start and slope, 16 bits each, so that one `smlad` with the weights (`ONE`,
//! d) adds an atom; d is bits 27 to 12 of the phase as they are, signed: the distance from the row,
//! 10 bits, and the row's own lowest six, which the line's start allows for. An atom is then five
//! instructions with its sum, a complex one seven: -sin x is the cosine a quarter of a turn further.
//! Half a turn changes the signs of both numbers of a line and nothing else, so a polarity is half a
//! turn to begin with.
//!
//! Phases are multiples of a wrapping 32-bit fraction of a turn: no error grows with k but that of
//! the fraction itself, k times ([`crate::phase`]).
//!
//! Error of an atom at the most: 2^-16 of the start's rounding, 2^-17 of the slope's over half of a
//! row, 2^-18.7 of the line, and 2^-18.3 of the distance's: 2^-15.1 where all meet.
//! `atoms_are_within_the_bound` goes through every row and distance and enforces 2^-15.1, and that
//! no atom reaches 1.

use core::f64::consts::TAU;

use crate::atom::{cos_of_row, round};
use crate::fixed_point::{CHUNK_EVENTS, FRACTION_BITS, Phase, Sum, dot_add};
use crate::transform::Impulse;

const ROWS_LOG2: u32 = 10;
/// Rows of a turn.
const ROWS: usize = 1 << ROWS_LOG2;
/// Rows of a quarter of a turn.
const QUARTER: usize = ROWS / 4;
/// Bits of the distance from a row, whose weight is 1 for a whole row.
const DISTANCE_BITS: u32 = FRACTION_BITS - 15;
/// Where the row begins in a phase.
const ROW_AT: u32 = 32 - ROWS_LOG2;
/// Where the distance begins.
const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Weight of a line's start: as in [`super::rows`], and so that a start that makes up for six bits
/// of the row still has 16.
const ONE: i32 = 1056;
/// Largest atom: |c_k| < n is what lets the levels of n events do without a bit for n itself.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// Start in units of [`ONE`] in the upper half, slope in the lower.
type Line = u32;

/// Of -cos, since ON is the half turn that begins in one instruction; a quarter of a turn more than
/// one, for the imaginary parts.
static LINES: [Line; ROWS + QUARTER] = lines();

/// Phase of k = 0, and what each further k adds.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(crate) struct Turn {
    start: u32,
    step: u32,
}

impl Turn {
    #[inline(always)]
    fn new(step: Phase, is_on: bool) -> Self {
        Self {
            start: u32::from(is_on) << 31,
            step: step.to_bits(),
        }
    }
}

/// The weights of a line at a phase.
#[inline(always)]
const fn weights(phase: u32) -> u32 {
    ((ONE as u32) << 16) | ((phase >> DISTANCE_AT) & 0xffff)
}

/// The lines of the real and the imaginary part at a phase.
#[inline(always)]
fn pair(phase: u32) -> (Line, Line) {
    let row = (phase >> ROW_AT) as usize;
    (LINES[row], LINES[row + QUARTER])
}

/// sum p cos(k a) for k in 1..`sums.len()`, over at most [`CHUNK_EVENTS`] impulses; a in turns is
/// `step` of an impulse. The sum of k = 0 stays.
#[inline(always)]
pub fn cosines(
    impulses: impl Iterator<Item = Impulse> + Clone,
    step: impl Fn(Impulse) -> Phase + Clone,
    sums: &mut [Sum],
) {
    let turns = impulses
        .take(CHUNK_EVENTS)
        .map(|impulse| Turn::new(step(impulse), impulse.is_on));
    #[cfg(target_arch = "x86_64")]
    if avx2::is_there() {
        return avx2::cosines(&turns, sums);
    }
    #[cfg(eecvs_dsp)]
    dsp::cosines(turns, sums);
    #[cfg(not(eecvs_dsp))]
    portable::cosines(turns, sums);
}

/// sum p exp(-i k a), `sums` being pairs of real and imaginary part; otherwise as [`cosines`].
#[inline(always)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse> + Clone,
    step: impl Fn(Impulse) -> Phase + Clone,
    sums: &mut [[Sum; 2]],
) {
    let turns = impulses
        .take(CHUNK_EVENTS)
        .map(|impulse| Turn::new(step(impulse), impulse.is_on));
    #[cfg(target_arch = "x86_64")]
    if avx2::is_there() {
        return avx2::exponentials(&turns, sums);
    }
    #[cfg(eecvs_dsp)]
    dsp::exponentials(turns, sums);
    #[cfg(not(eecvs_dsp))]
    portable::exponentials(turns, sums);
}

/// An atom at a time.
#[cfg_attr(eecvs_dsp, allow(dead_code))]
mod portable {
    use super::{Sum, Turn, dot_add, pair, weights};

    #[inline(always)]
    pub fn cosines(turns: impl Iterator<Item = Turn>, sums: &mut [Sum]) {
        let sums = sums.get_mut(1..).unwrap_or_default();
        sums.fill(Sum::ZERO);
        for Turn { start, step } in turns {
            let mut phase = start;
            for sum in &mut *sums {
                phase = phase.wrapping_add(step);
                let (line, _) = pair(phase);
                *sum = Sum::from_bits(dot_add(sum.to_bits(), line, weights(phase)));
            }
        }
    }

    #[inline(always)]
    pub fn exponentials(turns: impl Iterator<Item = Turn>, sums: &mut [[Sum; 2]]) {
        let sums = sums.get_mut(1..).unwrap_or_default();
        sums.fill([Sum::ZERO; 2]);
        for Turn { start, step } in turns {
            let mut phase = start;
            for [re, im] in &mut *sums {
                phase = phase.wrapping_add(step);
                let lines = pair(phase);
                *re = Sum::from_bits(dot_add(re.to_bits(), lines.0, weights(phase)));
                *im = Sum::from_bits(dot_add(im.to_bits(), lines.1, weights(phase)));
            }
        }
    }
}

/// The same bits, two events at a time, so that sums are loaded and stored half as often.
///
/// The compiler takes 13 instructions for a number where these are 5 or, of a complex one, 4.
#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
pub(crate) mod dsp {
    use core::arch::naked_asm;

    use heapless::Vec;

    use super::{CHUNK_EVENTS, DISTANCE_AT, LINES, ONE, QUARTER, ROW_AT, Sum, Turn};

    /// As the one beside this module.
    #[inline(always)]
    pub fn cosines(turns: impl Iterator<Item = Turn>, sums: &mut [Sum]) {
        let sums = sums.get_mut(1..).unwrap_or_default();
        let mut all = Vec::new();
        let turns = collect(turns, &mut all);
        if turns.is_empty() {
            return sums.fill(Sum::ZERO);
        }
        // SAFETY: `add_cosines` reads as many turns and writes as many sums as it is told, which are
        // there, and reads lines at rows below `ROWS`. The build script sets `eecvs_dsp` only for
        // cores that have the instructions.
        unsafe { add_cosines(sums.as_mut_ptr(), sums.len(), turns.as_ptr(), turns.len()) }
    }

    /// As the one beside this module.
    #[inline(always)]
    pub fn exponentials(turns: impl Iterator<Item = Turn>, sums: &mut [[Sum; 2]]) {
        let sums = sums.get_mut(1..).unwrap_or_default();
        let mut all = Vec::new();
        let turns = collect(turns, &mut all);
        if turns.is_empty() {
            return sums.fill([Sum::ZERO; 2]);
        }
        // SAFETY: as for `cosines`; imaginary parts are at rows below `ROWS + QUARTER`.
        unsafe { add_exponentials(sums.as_mut_ptr(), sums.len(), turns.as_ptr(), turns.len()) }
    }

    /// Into memory of the caller's, so that none is copied.
    #[inline(always)]
    fn collect(turns: impl Iterator<Item = Turn>, all: &mut Vec<Turn, CHUNK_EVENTS>) -> &[Turn] {
        for turn in turns {
            if all.push(turn).is_err() {
                break;
            }
        }
        all
    }

    /// The weights in r9 and the row in r7, of the next phase of `$phase`.
    macro_rules! advance {
        ($phase:literal, $step:literal) => {
            concat!(
                "add ",
                $phase,
                ", ",
                $phase,
                ", ",
                $step,
                "\n",
                "pkhtb r9, r6, ",
                $phase,
                ", asr #{distance_at}\n",
                "lsr r7, ",
                $phase,
                ", #{row_at}\n",
            )
        };
    }

    /// sum p exp(-i k a) of two events for every k of `set`, ascending and side by side; the bits of
    /// [`super::exponentials`].
    ///
    /// # Safety
    /// `sums` has room for as many pairs; the core has the DSP instructions.
    #[unsafe(naked)]
    pub unsafe extern "C" fn two_exponentials(set: u32, sums: *mut Sum, turns: &[Turn; 2]) {
        naked_asm!(
            "push {{r4-r11, lr}}",
            // The phases of k = -1.
            "ldm r2, {{r2, r3, r12, lr}}",
            "subs r2, r2, r3",
            "sub r12, r12, lr",
            "rbit r0, r0",
            "cmp r0, #0",
            "beq 3f",
            "movw r4, #:lower16:{lines}",
            "movt r4, #:upper16:{lines}",
            "add r5, r4, #{imaginary}",
            "mov r6, #{one}",
            "2:",
            "clz r7, r0",
            "add r7, r7, #1",
            // The last one leaves nothing, and nothing below changes the flags.
            "lsls r0, r0, r7",
            "mla r2, r7, r3, r2",
            "mla r12, r7, lr, r12",
            "lsr r7, r2, #{row_at}",
            "pkhtb r8, r6, r2, asr #{distance_at}",
            "ldr r10, [r4, r7, lsl #2]",
            "ldr r11, [r5, r7, lsl #2]",
            "smuad r10, r10, r8",
            "smuad r11, r11, r8",
            "lsr r7, r12, #{row_at}",
            "pkhtb r9, r6, r12, asr #{distance_at}",
            "ldr r8, [r4, r7, lsl #2]",
            "ldr r7, [r5, r7, lsl #2]",
            "smlad r10, r8, r9, r10",
            "smlad r11, r7, r9, r11",
            "strd r10, r11, [r1], #8",
            "bne 2b",
            "3:",
            "pop {{r4-r11, pc}}",
            lines = sym LINES,
            imaginary = const 4 * QUARTER,
            one = const ONE << 16,
            row_at = const ROW_AT,
            distance_at = const DISTANCE_AT,
        )
    }

    /// Adds the next number of the turn to `$sum`, or begins with it.
    macro_rules! real {
        ($op:literal, $phase:literal, $step:literal, $sum:literal, $plus:literal) => {
            concat!(
                advance!($phase, $step),
                "ldr r7, [r4, r7, lsl #2]\n",
                $op,
                " ",
                $sum,
                ", r7, r9",
                $plus,
                "\n",
            )
        };
    }

    /// Adds the next pair of the turn to r10 and r11, or begins with it.
    macro_rules! complex {
        ($op:literal, $phase:literal, $step:literal, $re:literal, $im:literal) => {
            concat!(
                advance!($phase, $step),
                "ldr r8, [r5, r7, lsl #2]\n",
                "ldr r7, [r4, r7, lsl #2]\n",
                $op,
                " r10, r7, r9",
                $re,
                "\n",
                $op,
                " r11, r8, r9",
                $im,
                "\n",
            )
        };
    }

    /// `$unit` as often as r1 says, of which three are in a row.
    macro_rules! units {
        ($unit:expr) => {
            concat!(
                "subs r1, r1, #3\n",
                "blo 3f\n",
                "2:\n",
                $unit,
                $unit,
                $unit,
                "subs r1, r1, #3\n",
                "bhs 2b\n",
                "3:\n",
                "adds r1, r1, #3\n",
                "beq 5f\n",
                "4:\n",
                $unit,
                "subs r1, r1, #1\n",
                "bne 4b\n",
                "5:\n",
            )
        };
    }

    /// The frame around the loops over coefficients: `$begin_one` and `$begin_two` write sums,
    /// `$two` and `$one` add to them.
    ///
    /// r0: sums, r1: how many, r2 and r3: phase and step of a turn, r12 and lr: of another, r4: lines,
    /// r5: those of the imaginary parts, r6: [`ONE`] in the upper half. At sp: the four arguments.
    macro_rules! turns {
        ($begin_one:expr, $begin_two:expr, $two:expr, $one:expr) => {
            concat!(
                "push {{r0-r11, lr}}\n",
                "movw r4, #:lower16:{lines}\n",
                "movt r4, #:upper16:{lines}\n",
                "add r5, r4, #{imaginary}\n",
                "mov r6, #{one}\n",
                "mov r7, r2\n",
                "subs r3, r3, #2\n",
                "str r3, [sp, #12]\n",
                "blo 8f\n",
                "ldm r7!, {{r2, r3, r12, lr}}\n",
                "str r7, [sp, #8]\n",
                $begin_two,
                "6:\n",
                "ldrd r7, r3, [sp, #8]\n",
                "ldrd r0, r1, [sp]\n",
                "subs r3, r3, #2\n",
                "str r3, [sp, #12]\n",
                "blo 7f\n",
                "ldm r7!, {{r2, r3, r12, lr}}\n",
                "str r7, [sp, #8]\n",
                $two,
                "b 6b\n",
                // One is left, or none.
                "7:\n",
                "adds r3, r3, #2\n",
                "beq 9f\n",
                "ldrd r2, r3, [r7]\n",
                $one,
                "b 9f\n",
                "8:\n",
                "ldrd r2, r3, [r7]\n",
                $begin_one,
                "9:\n",
                "add sp, sp, #16\n",
                "pop {{r4-r11, pc}}\n",
            )
        };
    }

    /// # Safety
    /// `sums` has `len` numbers, `turns` has `count`, 1 or more; the core has the DSP instructions.
    #[unsafe(naked)]
    unsafe extern "C" fn add_cosines(sums: *mut Sum, len: usize, turns: *const Turn, count: usize) {
        naked_asm!(
            turns!(
                units!(concat!(
                    real!("smuad", "r2", "r3", "r10", ""),
                    "str r10, [r0], #4\n",
                )),
                units!(concat!(
                    real!("smuad", "r2", "r3", "r10", ""),
                    real!("smlad", "r12", "lr", "r10", ", r10"),
                    "str r10, [r0], #4\n",
                )),
                units!(concat!(
                    "ldr r10, [r0]\n",
                    real!("smlad", "r2", "r3", "r10", ", r10"),
                    real!("smlad", "r12", "lr", "r10", ", r10"),
                    "str r10, [r0], #4\n",
                )),
                units!(concat!(
                    "ldr r10, [r0]\n",
                    real!("smlad", "r2", "r3", "r10", ", r10"),
                    "str r10, [r0], #4\n",
                ))
            ),
            lines = sym LINES,
            imaginary = const 4 * QUARTER,
            one = const ONE << 16,
            row_at = const ROW_AT,
            distance_at = const DISTANCE_AT,
        )
    }

    /// # Safety
    /// As for [`add_cosines`], with pairs.
    #[unsafe(naked)]
    pub unsafe extern "C" fn add_exponentials(
        sums: *mut [Sum; 2],
        len: usize,
        turns: *const Turn,
        count: usize,
    ) {
        naked_asm!(
            turns!(
                units!(concat!(
                    complex!("smuad", "r2", "r3", "", ""),
                    "strd r10, r11, [r0], #8\n",
                )),
                units!(concat!(
                    complex!("smuad", "r2", "r3", "", ""),
                    complex!("smlad", "r12", "lr", ", r10", ", r11"),
                    "strd r10, r11, [r0], #8\n",
                )),
                units!(concat!(
                    "ldrd r10, r11, [r0]\n",
                    complex!("smlad", "r2", "r3", ", r10", ", r11"),
                    complex!("smlad", "r12", "lr", ", r10", ", r11"),
                    "strd r10, r11, [r0], #8\n",
                )),
                units!(concat!(
                    "ldrd r10, r11, [r0]\n",
                    complex!("smlad", "r2", "r3", ", r10", ", r11"),
                    "strd r10, r11, [r0], #8\n",
                ))
            ),
            lines = sym LINES,
            imaginary = const 4 * QUARTER,
            one = const ONE << 16,
            row_at = const ROW_AT,
            distance_at = const DISTANCE_AT,
        )
    }
}

/// The same bits, eight numbers at a time: `pmaddwd` is `smlad` without its sum. Lines are loaded one
/// by one, which takes half as long as the processor's own gathering.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
pub(crate) mod avx2 {
    use core::arch::x86_64::{
        __m256i, _mm256_add_epi32, _mm256_blend_epi16, _mm256_madd_epi16, _mm256_mullo_epi32,
        _mm256_set1_epi32, _mm256_setr_epi32, _mm256_setr_epi64x, _mm256_setzero_si256,
        _mm256_srli_epi32, _mm256_storeu_si256,
    };

    use super::{
        CHUNK_EVENTS, DISTANCE_AT, Impulse, LINES, Line, ONE, Phase, QUARTER, ROW_AT, ROWS, Sum,
        Turn,
    };

    cpufeatures::new!(detected, "avx2");

    /// Whether this processor has the instructions; looked up once.
    #[inline(always)]
    pub fn is_there() -> bool {
        detected::get()
    }

    /// Coefficients of a pass over the events.
    const BLOCK: usize = 16;

    /// Lines of the imaginary part above those of the real: one load for both.
    static PAIRS: [u64; ROWS] = pairs();

    const fn pairs() -> [u64; ROWS] {
        let mut pairs = [0; ROWS];
        let mut row = 0;
        while row < ROWS {
            pairs[row] = ((LINES[row + QUARTER] as u64) << 32) | LINES[row] as u64;
            row += 1;
        }
        pairs
    }

    #[inline(always)]
    fn row(phase: u32) -> usize {
        (phase >> ROW_AT) as usize
    }

    /// As the one beside this module.
    pub fn cosines(turns: &(impl Iterator<Item = Turn> + Clone), sums: &mut [Sum]) {
        let line = |phase| {
            let line: Line = LINES[row(phase)];
            line.cast_signed()
        };
        // SAFETY: asked for only where `is_there`.
        unsafe {
            add::<{ BLOCK / 8 }, 8>(turns, sums, [0, 1, 2, 3, 4, 5, 6, 7], |phases| {
                let [a, b, c, d, e, f, g, h] = phases.map(line);
                _mm256_setr_epi32(a, b, c, d, e, f, g, h)
            });
        }
    }

    /// As the one beside this module.
    pub fn exponentials(turns: &(impl Iterator<Item = Turn> + Clone), sums: &mut [[Sum; 2]]) {
        let sums = sums.as_flattened_mut();
        // SAFETY: as for `cosines`.
        unsafe {
            add::<{ BLOCK / 4 }, 4>(turns, sums, [0, 0, 1, 1, 2, 2, 3, 3], |phases| {
                let [a, b, c, d] = phases.map(|phase| PAIRS[row(phase)].cast_signed());
                _mm256_setr_epi64x(a, b, c, d)
            });
        }
    }

    /// sum p exp(-i k a) for k in 0..4 V as [`super::exponentials`], four pairs of real and imaginary
    /// part in each vector; those of k = 0 are any.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn first_exponentials<const V: usize>(
        impulses: impl Iterator<Item = Impulse>,
        step: impl Fn(Impulse) -> Phase,
    ) -> [__m256i; V] {
        let mut sums = [_mm256_setzero_si256(); V];
        let ramp = _mm256_setr_epi32(0, 0, 1, 1, 2, 2, 3, 3);
        for impulse in impulses.take(CHUNK_EVENTS) {
            let turn = Turn::new(step(impulse), impulse.is_on);
            add_pairs(turn, ramp, &mut sums);
        }
        sums
    }

    /// Adds the pairs of an event.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn add_pairs<const V: usize>(
        Turn { start, step }: Turn,
        ramp: __m256i,
        sums: &mut [__m256i; V],
    ) {
        let one = _mm256_set1_epi32(ONE << 16);
        let mut at = start;
        let mut phase = _mm256_add_epi32(
            _mm256_set1_epi32(start.cast_signed()),
            _mm256_mullo_epi32(_mm256_set1_epi32(step.cast_signed()), ramp),
        );
        let further = _mm256_set1_epi32(step.wrapping_mul(4).cast_signed());
        for sum in sums {
            let distances = _mm256_srli_epi32::<{ DISTANCE_AT as i32 }>(phase);
            let weights = _mm256_blend_epi16::<0b1010_1010>(distances, one);
            let [a, b, c, d] = core::array::from_fn(|_| {
                let pair = PAIRS[row(at)];
                at = at.wrapping_add(step);
                pair.cast_signed()
            });
            let lines = _mm256_setr_epi64x(a, b, c, d);
            *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
            phase = _mm256_add_epi32(phase, further);
        }
    }

    /// Sums of `V` vectors at a time, in which `K` coefficients are, number i being of coefficient
    /// `ramp[i]`.
    #[target_feature(enable = "avx2")]
    fn add<const V: usize, const K: usize>(
        turns: &(impl Iterator<Item = Turn> + Clone),
        sums: &mut [Sum],
        ramp: [i32; 8],
        lines: impl Fn([u32; K]) -> __m256i,
    ) {
        let zeroth: [Option<Sum>; 2] = [0, 1].map(|i| sums.get(i).copied());
        let [a, b, c, d, e, f, g, h] = ramp;
        let ramp = _mm256_setr_epi32(a, b, c, d, e, f, g, h);
        let one = _mm256_set1_epi32(ONE << 16);
        for (block, sums) in sums.chunks_mut(8 * V).enumerate() {
            let first = (block * BLOCK) as u32;
            let mut all = [_mm256_setzero_si256(); V];
            for Turn { start, step } in turns.clone() {
                let mut at = start.wrapping_add(step.wrapping_mul(first));
                let mut phase = _mm256_add_epi32(
                    _mm256_set1_epi32(at.cast_signed()),
                    _mm256_mullo_epi32(_mm256_set1_epi32(step.cast_signed()), ramp),
                );
                let further = step.wrapping_mul(K as u32).cast_signed();
                let further = _mm256_set1_epi32(further);
                for sum in &mut all {
                    let distances = _mm256_srli_epi32::<{ DISTANCE_AT as i32 }>(phase);
                    let weights = _mm256_blend_epi16::<0b1010_1010>(distances, one);
                    let lines = lines(core::array::from_fn(|_| {
                        let phase = at;
                        at = at.wrapping_add(step);
                        phase
                    }));
                    *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
                    phase = _mm256_add_epi32(phase, further);
                }
            }
            let mut numbers = [[0_i32; 8]; V];
            for (numbers, sum) in numbers.iter_mut().zip(all) {
                // SAFETY: eight numbers are the 32 bytes that are written, at any alignment.
                unsafe { _mm256_storeu_si256(numbers.as_mut_ptr().cast(), sum) };
            }
            for (sum, number) in sums.iter_mut().zip(numbers.as_flattened()) {
                *sum = Sum::from_bits(*number);
            }
        }
        // The sum of k = 0 is not asked for.
        for (sum, zeroth) in sums.iter_mut().zip(zeroth).take(8 / K) {
            *sum = zeroth.unwrap_or_default();
        }
    }
}

/// The table in constant evaluation: the same bits on every machine.
const fn lines() -> [Line; ROWS + QUARTER] {
    let mut lines = [0; ROWS + QUARTER];
    let mut i = 0;
    while i < lines.len() {
        lines[i] = line((i + ROWS / 2) % ROWS);
        i += 1;
    }
    lines
}

/// The line of the cosine from `row` to the next: the chord, moved by half of its distance from the curve.
const fn line(row: usize) -> Line {
    if row >= ROWS / 2 {
        let line = line(row - ROWS / 2);
        let (start, slope) = (line >> 16, line & 0xffff);
        return (start.wrapping_neg() << 16) | (slope.wrapping_neg() & 0xffff);
    }
    let (from, to) = (cos_of_row(row, QUARTER), cos_of_row(row + 1, QUARTER));
    let step = TAU / ROWS as f64;
    let bend = (from + to) / 2.0 * (step * step / 16.0);
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) / (2 << DISTANCE_BITS) as f64;
    let scale = (1_u32 << FRACTION_BITS) as f64;
    let from = (from + bend + half_bit) * scale;
    let to = (to + bend + half_bit) * scale;
    let slope = round((to - from) / (1 << DISTANCE_BITS) as f64);
    // The weight of the slope in the middle of the row.
    let (first, last) = distances(row);
    let middle = slope as f64 * ((first + last) as f64 / 2.0);
    let mut start = round(((from + to) / 2.0 - middle) / ONE as f64);
    // Below 1 at both ends.
    while start * ONE + slope * first > ATOM_MAX || start * ONE + slope * last > ATOM_MAX {
        start -= 1;
    }
    while start * ONE + slope * first < -ATOM_MAX || start * ONE + slope * last < -ATOM_MAX {
        start += 1;
    }
    assert!(start >= -0x8000 && start <= 0x7fff && slope >= -0x8000 && slope <= 0x7fff);
    ((start as u32) << 16) | (slope as u32 & 0xffff)
}

/// First and last weight of a slope in `row`.
const fn distances(row: usize) -> (i32, i32) {
    let first = ((row << DISTANCE_BITS) & 0xffff) as u16 as i16 as i32;
    (first, first + (1 << DISTANCE_BITS) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_is_pinned() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut digest = crc.digest();
        for line in &LINES {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 2_091_740_695, "the table's checksum");
    }

    #[cfg(target_arch = "x86_64")]
    proptest::proptest! {
        #[test]
        fn vectors_give_the_same_bits(
            turns in proptest::collection::vec(
                proptest::prelude::any::<(u32, bool)>(),
                0..=CHUNK_EVENTS,
            ),
            grid in 0..=70_usize,
        ) {
            if !avx2::is_there() {
                return Ok(());
            }
            let turns = turns.iter().map(|(step, is_on)| Turn::new(Phase::from_bits(*step), *is_on));
            let mut sums = [[Sum::NEG_ONE; 70]; 2];
            portable::cosines(turns.clone(), &mut sums[0][..grid]);
            avx2::cosines(&turns, &mut sums[1][..grid]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
            let mut sums = [[[Sum::NEG_ONE; 2]; 70]; 2];
            portable::exponentials(turns.clone(), &mut sums[0][..grid]);
            avx2::exponentials(&turns, &mut sums[1][..grid]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
        }
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let (mut worst, mut largest) = (0.0_f64, 0);
        // Both ends of every distance.
        for at in 0..1_u32 << (32 - DISTANCE_AT) {
            let phase = at << DISTANCE_AT;
            let on = pair(phase ^ (1 << 31));
            let found = [on.0, on.1].map(|line| dot_add(0, line, weights(phase)));
            let off = pair(phase);
            assert_eq!(dot_add(0, off.0, weights(phase)), -found[0]);
            assert_eq!(dot_add(0, off.1, weights(phase)), -found[1]);
            for phase in [phase, phase | ((1 << DISTANCE_AT) - 1)] {
                let turns = f64::from(phase) / 4_294_967_296.0;
                let (sin, cos) = libm::sincos(turns * TAU);
                for (found, exact) in found.into_iter().zip([cos, -sin]) {
                    largest = largest.max(found.abs());
                    let found = f64::from(found) / f64::from(1 << FRACTION_BITS);
                    worst = worst.max((found - exact).abs());
                }
            }
        }
        assert!(worst <= libm::exp2(-15.1), "2^{}", libm::log2(worst));
        assert!(largest < 1 << FRACTION_BITS);
    }
}
