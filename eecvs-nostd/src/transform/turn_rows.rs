//! p exp(-i 2 pi k u) for k = 1..15 from a table with lines between its rows: the DTFT of 16
//! frequencies, which is the default for M = 8.
//!
//! A row holds two lines for each k, from its u to the next row's: value and slope, 16 bits each, of
//! the real and of the imaginary part, so that one `smlad` with the weights (p, p d), d the distance
//! from the row, adds a number. The rows span a quarter of the window: u and 1 - u share one, of which
//! the imaginary parts change the sign, and so do u and 1/2 - u, of which the real parts of odd k and
//! the imaginary parts of even k do. Weights are therefore four of an event, two of even k and two of
//! odd.
//!
//! Error of a number, largest for k = 15: the line's 3.3e-5 where the curve bends (half of its bend, as
//! the line runs in the middle of it); where it is steep instead, 2^-11 rows of the distance's, 1.1e-5;
//! and up to 2^-16 of both ends' rounding, less where that of one makes up for the other's.
//! `atoms_are_within_the_bound` goes through every row and distance and enforces 2^-14.12 of each part,
//! 2^-14.06 of both together, and that no atom reaches 1.

use core::f64::consts::TAU;

use crate::atom::{cos_of_row, round};
use crate::fixed_point::{CHUNK_EVENTS, FRACTION_BITS, Phase, Sum, dot_add, negate_halves};
use crate::transform::Impulse;

/// K.
pub const GRID: usize = 16;
/// Rows from u = 0 to u = 1/4.
const ROWS: usize = 1 << ROWS_LOG2;
const ROWS_LOG2: u32 = 10;
/// Bits of the distance from a row, whose weight is 1 for a whole row.
const DISTANCE_BITS: u32 = FRACTION_BITS - 15;
/// Where the row begins in 29 bits of u / 2, and the distance below it.
const ROW_AT: u32 = 29 - ROWS_LOG2;
/// Where the distance begins.
const DISTANCE_AT: u32 = ROW_AT - DISTANCE_BITS;
/// Weight of the value. Not 2^10, whose multiples are up to 2^-15 away from the largest atom.
const ONE: i32 = 1056;
/// Largest atom: |c_k| < n is what lets the levels of n events do without a bit for n itself.
const ATOM_MAX: i32 = (1 << FRACTION_BITS) - 1;

/// A number's negative in units of [`ONE`] in the upper half, slope per row with 15 fractional bits in
/// the lower.
type Line = u32;
/// Lines of the real and of the imaginary part of every k; those of k = 0, whose sum the caller knows,
/// are 0.
type Row = [[Line; 2]; GRID];

/// The table, each row in two of a host's cache lines.
#[repr(align(128))]
struct Lines([Row; ROWS]);

// A second of the compiler's time.
#[allow(long_running_const_eval)]
static LINES: Lines = table();

/// An event's lines and their weights.
#[derive(Debug, Clone, Copy)]
struct Weighted {
    lines: &'static Row,
    /// p and p d for the real and the imaginary part of even k.
    even: [u32; 2],
    /// The same for odd k.
    odd: [u32; 2],
}

/// Where an event is in the table.
#[derive(Debug, Clone, Copy)]
struct Place {
    row: usize,
    /// ONE and the distance.
    weights: u32,
    /// All ones in the second half of the window, which is turned round.
    late: u32,
    /// All ones in the second quarter of what is left, which is turned round too.
    far: u32,
}

impl Place {
    /// Of an event at the `half` turn u / 2.
    #[inline(always)]
    fn new(half: Phase) -> Self {
        let half = half.to_bits();
        let late = ((half << 1).cast_signed() >> 31).cast_unsigned();
        let half = half ^ late;
        let far = ((half << 2).cast_signed() >> 31).cast_unsigned();
        let half = half ^ far;
        let distance = (half >> DISTANCE_AT) % (1 << DISTANCE_BITS);
        Self {
            row: (half >> ROW_AT) as usize % ROWS,
            weights: ((ONE as u32) << 16) | distance,
            late,
            far,
        }
    }
}

impl Weighted {
    #[cfg_attr(target_feature = "sse2", allow(dead_code))]
    #[inline(always)]
    fn new(half: Phase, is_on: bool) -> Self {
        let Place {
            row,
            weights,
            late,
            far,
        } = Place::new(half);
        // The table's numbers are negative: it is ON that turns them.
        let on = u32::from(is_on).wrapping_neg();
        let of = |negative| negate_halves(weights, negative);
        Self {
            lines: &LINES.0[row],
            even: [of(on), of(on ^ late ^ far)],
            odd: [of(on ^ far), of(on ^ late)],
        }
    }
}

/// sum p exp(-i 2 pi k u) for k in 1..16 over at most [`CHUNK_EVENTS`] impulses, of which `half` gives
/// u / 2; `sums` are pairs of real and imaginary part. The sum of k = 0 stays.
#[inline(always)]
pub fn exponentials(
    impulses: impl Iterator<Item = Impulse>,
    half: impl Fn(Impulse) -> Phase,
    sums: &mut [[Sum; 2]; GRID],
) {
    let impulses = impulses.take(CHUNK_EVENTS);
    #[cfg(eecvs_dsp)]
    dsp::exponentials(impulses, half, sums);
    #[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
    vectors::exponentials(impulses, half, sums);
    #[cfg(not(any(eecvs_dsp, all(target_arch = "x86_64", target_feature = "sse2"))))]
    portable::exponentials(impulses, half, sums);
}

/// A number at a time.
#[cfg_attr(any(eecvs_dsp, target_feature = "sse2"), allow(dead_code))]
mod portable {
    use super::{GRID, Impulse, Phase, Sum, Weighted, dot_add};

    /// As the one beside this module.
    #[inline(always)]
    pub fn exponentials(
        impulses: impl Iterator<Item = Impulse>,
        half: impl Fn(Impulse) -> Phase,
        sums: &mut [[Sum; 2]; GRID],
    ) {
        let [_, sums @ ..] = sums;
        sums.fill([Sum::ZERO; 2]);
        for impulse in impulses {
            let event = Weighted::new(half(impulse), impulse.is_on);
            let [_, lines @ ..] = event.lines;
            for (i, (sum, lines)) in sums.iter_mut().zip(lines).enumerate() {
                // k = i + 1
                let weights = if i % 2 == 0 { event.odd } else { event.even };
                for ((sum, line), weights) in sum.iter_mut().zip(lines).zip(weights) {
                    *sum = Sum::from_bits(dot_add(sum.to_bits(), *line, weights));
                }
            }
        }
    }
}

/// The same bits from the events' weights, which are found once and gone through four times: as many
/// sums as there are registers for, of odd or of even k, whose weights an event has side by side.
#[cfg(eecvs_dsp)]
#[allow(unsafe_code)]
pub(crate) mod dsp {
    use core::arch::naked_asm;
    use core::mem::MaybeUninit;

    use heapless::Vec;

    use super::{
        CHUNK_EVENTS, DISTANCE_AT, DISTANCE_BITS, GRID, Impulse, LINES, ONE, Phase, ROW_AT,
        ROWS_LOG2, Row, Sum,
    };
    use crate::transform::wave::Turn;
    use crate::window::Slot;

    /// Weights of the real and the imaginary part, and the row; after the last event's a row of 0.
    type Weights = [u32; 3];

    /// Events that are weighed at once: a third of a chunk, as the stack has no room for more.
    pub const EVENTS_MAX: usize = CHUNK_EVENTS.div_ceil(3);

    /// What the assembly knows of up to [`EVENTS_MAX`] events, for odd k and for even k.
    #[derive(Debug)]
    #[repr(transparent)]
    pub struct Events(MaybeUninit<[[Weights; EVENTS_MAX + 1]; 2]>);

    /// Where those for even k begin.
    const EVEN_AT: usize = size_of::<[Weights; EVENTS_MAX + 1]>();

    impl Events {
        /// Of none.
        #[inline(always)]
        pub const fn new() -> Self {
            Self(MaybeUninit::uninit())
        }
    }

    /// As the one beside this module. Apart, as its memory is not to be that of all who call it.
    #[inline(never)]
    pub fn exponentials(
        mut impulses: impl Iterator<Item = Impulse>,
        half: impl Fn(Impulse) -> Phase,
        sums: &mut [[Sum; 2]; GRID],
    ) {
        let [_, others @ ..] = sums;
        others.fill([Sum::ZERO; 2]);
        let mut halves = Vec::<u32, EVENTS_MAX>::new();
        let mut events = Events::new();
        let mut more = [[Sum::ZERO; 2]; GRID];
        let mut is_first = true;
        loop {
            halves.clear();
            for impulse in impulses.by_ref().take(EVENTS_MAX) {
                let sign = u32::from(impulse.is_on) << 31;
                if halves.push(half(impulse).to_bits() | sign).is_err() {
                    break;
                }
            }
            if halves.is_empty() {
                return;
            }
            // SAFETY: there are the halves, 1 to `EVENTS_MAX`. The build script sets `eecvs_dsp` only
            // for cores that have the instructions.
            unsafe {
                weigh(halves.as_ptr(), halves.len(), &mut events);
                add(if is_first { sums } else { &mut more }, &events);
            }
            if !is_first {
                for (sum, more) in sums.as_flattened_mut().iter_mut().zip(more.as_flattened()) {
                    *sum = sum.wrapping_add(*more);
                }
            }
            is_first = false;
        }
    }

    /// From r4, with 0 instead of 2^31 at its top or above it, the weights of an event: for odd k in
    /// $re_odd and $im_odd, for even k in r7 and r9, and the row in r10. r8: all ones where it is ON;
    /// lr: the table. $up is 1 where r4 is u, 0 where it is u / 2. Overwrites r5 and r6.
    macro_rules! weigh {
        ($up:literal) => {
            concat!(
                // r5: all ones in the second half of the window.
                "sbfx r5, r4, #30 + ",
                $up,
                ", #1\n",
                "eors r4, r5\n",
                // r6: all ones in the second quarter of what is left.
                "sbfx r6, r4, #29 + ",
                $up,
                ", #1\n",
                "eors r4, r6\n",
                "ubfx r7, r4, #{distance_at} + ",
                $up,
                ", #{distance_bits}\n",
                "orr r7, r7, #{one}\n",
                "ubfx r4, r4, #{row_at} + ",
                $up,
                ", #{rows_log2}\n",
                "add r10, lr, r4, lsl #7\n",
                "eor r7, r7, r8\n",
                "ssub16 r7, r7, r8\n",
                "eor r4, r7, r6\n",
                "ssub16 r4, r4, r6\n",
                "eor r8, r7, r5\n",
                "ssub16 r8, r8, r5\n",
                "eor r9, r8, r6\n",
                "ssub16 r9, r9, r6\n",
            )
        };
    }

    /// The weights of the list of slots that begins at `head`, as [`super::Weighted::new`] has them;
    /// `shift` and `reciprocal` are those of [`crate::phase::PhaseScale::parts`].
    ///
    /// # Safety
    /// Every link is a slot or the end; the list has at most [`EVENTS_MAX`]; the core has the DSP
    /// instructions.
    #[unsafe(naked)]
    pub unsafe extern "C" fn weigh_list(
        parts: &[u32; 2],
        slots: *const Slot,
        head: u32,
        events: &mut Events,
    ) {
        naked_asm!(
            "push {{r4-r11, lr}}",
            "ldrd r0, r12, [r0]",
            "movw lr, #:lower16:{lines}",
            "movt lr, #:upper16:{lines}",
            "add r11, r3, #{even_at}",
            "2:",
            "add r4, r1, r2, lsl #3",
            "ldrd r4, r2, [r4]",
            "lsls r4, r0",
            "umull r6, r4, r4, r12",
            "sbfx r8, r2, #0, #1",
            weigh!("0"),
            "stm r3!, {{r4, r8, r10}}",
            "stm r11!, {{r7, r9, r10}}",
            // The sign tells the end of the list.
            "asrs r2, r2, #16",
            "bpl 2b",
            "movs r4, #0",
            "str r4, [r3, #8]",
            "str r4, [r11, #8]",
            "pop {{r4-r11, pc}}",
            lines = sym LINES,
            even_at = const EVEN_AT,
            distance_at = const DISTANCE_AT,
            distance_bits = const DISTANCE_BITS,
            one = const ONE << 16,
            row_at = const ROW_AT,
            rows_log2 = const ROWS_LOG2,
        )
    }

    /// The same of `len` events, 1 or more, each u / 2 with the polarity above it.
    ///
    /// # Safety
    /// There are as many `halves`, at most [`EVENTS_MAX`]; the core has the DSP instructions.
    #[unsafe(naked)]
    unsafe extern "C" fn weigh(halves: *const u32, len: usize, events: &mut Events) {
        naked_asm!(
            "push {{r4-r11, lr}}",
            "movw lr, #:lower16:{lines}",
            "movt lr, #:upper16:{lines}",
            "add r11, r2, #{even_at}",
            "2:",
            "ldr r4, [r0], #4",
            "asr r8, r4, #31",
            weigh!("0"),
            "stm r2!, {{r4, r8, r10}}",
            "stm r11!, {{r7, r9, r10}}",
            "subs r1, #1",
            "bne 2b",
            "movs r4, #0",
            "str r4, [r2, #8]",
            "str r4, [r11, #8]",
            "pop {{r4-r11, pc}}",
            lines = sym LINES,
            even_at = const EVEN_AT,
            distance_at = const DISTANCE_AT,
            distance_bits = const DISTANCE_BITS,
            one = const ONE << 16,
            row_at = const ROW_AT,
            rows_log2 = const ROWS_LOG2,
        )
    }

    /// Adds the numbers of `$k` to the sums `$re` and `$im`, or begins with them. r1 and r2: weights;
    /// r3: row.
    macro_rules! pair {
        ($k:literal, $op:literal, $re:literal, $im:literal, $re_sum:literal, $im_sum:literal) => {
            concat!(
                "ldrd r12, lr, [r3, #8 * ",
                $k,
                "]\n",
                $op,
                " ",
                $re,
                ", r12, r1",
                $re_sum,
                "\n",
                $op,
                " ",
                $im,
                ", lr, r2",
                $im_sum,
                "\n",
            )
        };
    }

    /// The sums of four k, or of three, from the events at r0 on, to the sums at sp.
    macro_rules! pass {
        ($a:literal, $b:literal, $c:literal $(, $d:literal)?) => {
            concat!(
                "ldm r0!, {{r1, r2, r3}}\n",
                pair!($a, "smuad", "r4", "r5", "", ""),
                pair!($b, "smuad", "r6", "r7", "", ""),
                pair!($c, "smuad", "r8", "r9", "", ""),
                $(pair!($d, "smuad", "r10", "r11", "", ""),)?
                "2:\n",
                pass!(event $a, $b, $c $(, $d)?),
                pass!(event $a, $b, $c $(, $d)?),
                "b 2b\n",
                "3:\n",
                "ldr r0, [sp]\n",
                "strd r4, r5, [r0, #8 * ", $a, "]\n",
                "strd r6, r7, [r0, #8 * ", $b, "]\n",
                "strd r8, r9, [r0, #8 * ", $c, "]\n",
                $("strd r10, r11, [r0, #8 * ", $d, "]\n",)?
            )
        };
        (event $a:literal, $b:literal, $c:literal $(, $d:literal)?) => {
            concat!(
                "ldm r0!, {{r1, r2, r3}}\n",
                "cbz r3, 3f\n",
                pair!($a, "smlad", "r4", "r5", ", r4", ", r5"),
                pair!($b, "smlad", "r6", "r7", ", r6", ", r7"),
                pair!($c, "smlad", "r8", "r9", ", r8", ", r9"),
                $(pair!($d, "smlad", "r10", "r11", ", r10", ", r11"),)?
            )
        };
    }

    /// The sums of k = 1 to 15.
    ///
    /// # Safety
    /// `events` are those of [`weigh`] or [`weigh_list`]; the core has the DSP instructions.
    #[unsafe(naked)]
    pub unsafe extern "C" fn add(sums: *mut [[Sum; 2]; GRID], events: &Events) {
        naked_asm!(
            "push {{r4-r11, lr}}",
            "push {{r0, r1}}",
            "mov r0, r1",
            pass!("1", "3", "5", "7"),
            "ldr r0, [sp, #4]",
            pass!("9", "11", "13", "15"),
            "ldr r0, [sp, #4]",
            "add r0, r0, #{even_at}",
            pass!("2", "4", "6"),
            "ldr r0, [sp, #4]",
            "add r0, r0, #{even_at}",
            pass!("8", "10", "12", "14"),
            "add sp, #8",
            "pop {{r4-r11, pc}}",
            even_at = const EVEN_AT,
        )
    }

    /// sum p exp(-i 2 pi k u) of two events for every k of `set` but 0, ascending and side by side.
    ///
    /// # Safety
    /// `set` has no k above 15, and `sums` has room for as many pairs; the core has the DSP
    /// instructions.
    #[unsafe(naked)]
    pub unsafe extern "C" fn two_exponentials(set: u32, sums: *mut Sum, turns: &[Turn; 2]) {
        /// Where `set` has `$k`. r0: the set from k on; r12: between the weights for odd k and for even
        /// k, r2 and r3: rows.
        macro_rules! one {
            ($k:literal, $load:literal) => {
                concat!(
                    "lsrs r0, r0, #1\n",
                    "bcc 2f\n",
                    $load,
                    " r12, {{r4-r7}}\n",
                    "ldrd r8, r9, [r2, #8 * ",
                    $k,
                    "]\n",
                    "ldrd r10, r11, [r3, #8 * ",
                    $k,
                    "]\n",
                    "smuad r8, r8, r4\n",
                    "smuad r9, r9, r5\n",
                    "smlad r8, r10, r6, r8\n",
                    "smlad r9, r11, r7, r9\n",
                    "strd r8, r9, [r1], #8\n",
                    "2:\n",
                )
            };
        }
        naked_asm!(
            "push {{r4-r11, lr}}",
            // At sp: the weights of both for odd k; 16 for even k.
            "sub sp, #36",
            "movw lr, #:lower16:{lines}",
            "movt lr, #:upper16:{lines}",
            "mov r3, r2",
            "ldrd r8, r4, [r3]",
            "asrs r8, r8, #31",
            weigh!("1"),
            "strd r4, r8, [sp]",
            "strd r7, r9, [sp, #16]",
            "mov r2, r10",
            "ldrd r8, r4, [r3, #8]",
            "asrs r8, r8, #31",
            weigh!("1"),
            "strd r4, r8, [sp, #8]",
            "strd r7, r9, [sp, #24]",
            "mov r3, r10",
            "add r12, sp, #16",
            "lsrs r0, r0, #1",
            one!("1", "ldmdb"),
            one!("2", "ldmia"),
            one!("3", "ldmdb"),
            one!("4", "ldmia"),
            one!("5", "ldmdb"),
            one!("6", "ldmia"),
            one!("7", "ldmdb"),
            one!("8", "ldmia"),
            one!("9", "ldmdb"),
            one!("10", "ldmia"),
            one!("11", "ldmdb"),
            one!("12", "ldmia"),
            one!("13", "ldmdb"),
            one!("14", "ldmia"),
            one!("15", "ldmdb"),
            "add sp, #36",
            "pop {{r4-r11, pc}}",
            lines = sym LINES,
            distance_at = const DISTANCE_AT,
            distance_bits = const DISTANCE_BITS,
            one = const ONE << 16,
            row_at = const ROW_AT,
            rows_log2 = const ROWS_LOG2,
        )
    }

    // What the assembly takes for granted.
    const _: () = assert!(size_of::<Row>() == 1 << 7 && size_of::<Slot>() == 8);
}

/// The same bits, four or eight numbers at a time: `pmaddwd` is `smlad` without its sum, and every
/// x86-64 has it.
#[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
#[allow(unsafe_code)]
pub(crate) mod vectors {
    use core::arch::x86_64::{
        __m128i, __m256i, _mm_add_epi32, _mm_loadu_si128, _mm_madd_epi16, _mm_set1_epi32,
        _mm_setzero_si128, _mm_storeu_si128, _mm_sub_epi16, _mm_xor_si128, _mm256_add_epi32,
        _mm256_broadcastsi128_si256, _mm256_loadu_si256, _mm256_madd_epi16, _mm256_setzero_si256,
    };

    use super::{CHUNK_EVENTS, GRID, Impulse, LINES, Phase, Place, Row, Sum};

    /// What turns the weights of two k, an even and an odd one: number 4 for ON, 2 for the second half
    /// of the window, 1 for the second quarter of what is left.
    static SIGNS: [[u32; 4]; 8] = signs();

    const fn signs() -> [[u32; 4]; 8] {
        let mut signs = [[0; 4]; 8];
        let mut i = 0;
        while i < 8 {
            let (on, late, far) = (i as u32 >> 2, (i as u32 >> 1) & 1, i as u32 & 1);
            let negative = [on, on ^ late ^ far, on ^ far, on ^ late];
            let mut j = 0;
            while j < 4 {
                signs[i][j] = negative[j].wrapping_neg();
                j += 1;
            }
            i += 1;
        }
        signs
    }

    /// Lines of an event, and the weights of two k.
    #[inline(always)]
    fn weigh(half: Phase, is_on: bool) -> (&'static Row, __m128i) {
        let Place {
            row,
            weights,
            late,
            far,
        } = Place::new(half);
        let signs = &SIGNS[((u32::from(is_on) << 2) | (late & 2) | (far & 1)) as usize];
        // SAFETY: the module is there only where the target has SSE2; four numbers are the 16 bytes
        // that are read, at any alignment.
        let weights = unsafe {
            let signs = _mm_loadu_si128(signs.as_ptr().cast());
            let weights = _mm_set1_epi32(weights.cast_signed());
            _mm_sub_epi16(_mm_xor_si128(weights, signs), signs)
        };
        (&LINES.0[row], weights)
    }

    /// As the one beside this module. Apart, so that the loop has the registers for itself.
    #[inline(never)]
    pub fn exponentials(
        impulses: impl Iterator<Item = Impulse>,
        half: impl Fn(Impulse) -> Phase,
        sums: &mut [[Sum; 2]; GRID],
    ) {
        // SAFETY: the module is there only where the target has SSE2.
        let mut all = [unsafe { _mm_setzero_si128() }; GRID / 2];
        for impulse in impulses {
            let (lines, weights) = weigh(half(impulse), impulse.is_on);
            for (sum, lines) in all.iter_mut().zip(lines.as_chunks::<2>().0) {
                // SAFETY: as above; two pairs are the 16 bytes that are read, at any alignment.
                *sum = unsafe {
                    let lines = _mm_loadu_si128(lines.as_ptr().cast());
                    _mm_add_epi32(*sum, _mm_madd_epi16(lines, weights))
                };
            }
        }
        let zeroth = sums[0];
        for (sums, all) in sums.as_chunks_mut::<2>().0.iter_mut().zip(all) {
            let mut numbers = [[0_i32; 2]; 2];
            // SAFETY: as above, and written.
            unsafe { _mm_storeu_si128(numbers.as_mut_ptr().cast(), all) };
            *sums = numbers.map(|pair| pair.map(Sum::from_bits));
        }
        sums[0] = zeroth;
    }

    /// The sums of k = 0..16, four pairs of real and imaginary part in each of `V` vectors; that of
    /// k = 0 is 0.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn first_exponentials<const V: usize>(
        impulses: impl Iterator<Item = Impulse>,
        half: impl Fn(Impulse) -> Phase,
    ) -> [__m256i; V] {
        let mut sums = [_mm256_setzero_si256(); V];
        for impulse in impulses.take(CHUNK_EVENTS) {
            let (lines, weights) = weigh(half(impulse), impulse.is_on);
            let weights = _mm256_broadcastsi128_si256(weights);
            for (sum, lines) in sums.iter_mut().zip(lines.as_chunks::<4>().0) {
                // SAFETY: four pairs are the 32 bytes that are read, at any alignment.
                let lines = unsafe { _mm256_loadu_si256(lines.as_ptr().cast()) };
                *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(lines, weights));
            }
        }
        sums
    }
}

/// The table in constant evaluation: the same bits on every machine.
const fn table() -> Lines {
    let mut lines = [[[0; 2]; GRID]; ROWS];
    // Of a turn and a quarter, for the imaginary parts.
    let mut cosines = [0.0; 5 * ROWS];
    let mut i = 0;
    while i < cosines.len() {
        cosines[i] = cos_of_row(i, ROWS);
        i += 1;
    }
    let mut row = 0;
    while row < ROWS {
        let mut k = 1;
        while k < GRID {
            let (from, to) = (k * row % (4 * ROWS), k * (row + 1) % (4 * ROWS));
            let step = k as f64 * (TAU / (4 * ROWS) as f64);
            lines[row][k] = [
                line(cosines[from], cosines[to], step),
                line(cosines[from + ROWS], cosines[to + ROWS], step),
            ];
            k += 1;
        }
        row += 1;
    }
    Lines(lines)
}

/// The line from a row to the next, `step` radians apart: of the four whose ends are next to those of
/// the chord, moved by half of its distance from the curve, the first one that is close enough to the
/// curve, or the closest.
const fn line(from: f64, to: f64, step: f64) -> Line {
    let scale = (1_u32 << FRACTION_BITS) as f64;
    // A distance stands for the middle of its last bit.
    let half_bit = (to - from) / (2 << DISTANCE_BITS) as f64;
    let (from, to) = ((from + half_bit) * scale, (to + half_bit) * scale);
    let bend = (from + to) / 2.0 * (step * step / 8.0);
    // Below 1, and by a quarter for a neighbour on that side.
    let most = (ATOM_MAX / ONE) as f64 - 0.25;
    let (value, other_value) = nearest(((from + bend / 2.0) / ONE as f64).clamp(-most, most));
    let most = ATOM_MAX as f64;
    let end = (to + bend / 2.0).clamp(-most, most);
    let (mut best, mut least) = (0, scale);
    let mut i = 0;
    while i < 4 && least > ENOUGH {
        let value = if i < 2 { value } else { other_value };
        let start = value * ONE;
        let (slope, other_slope) = nearest((end - start as f64) / (1 << DISTANCE_BITS) as f64);
        let slope = if i % 2 == 0 { slope } else { other_slope };
        let last = start + slope * ((1 << DISTANCE_BITS) - 1);
        let stop = start + (slope << DISTANCE_BITS);
        let error = largest_error(start as f64 - from, stop as f64 - to, bend);
        if error < least && last.abs() <= ATOM_MAX {
            least = error;
            best = ((-value as u32) << 16) | (-slope as u32 & 0xffff);
        }
        i += 1;
    }
    assert!(least < scale);
    best
}

/// A line's error that is left as it is, in units of 2^-25.
const ENOUGH: f64 = 1300.0;

/// The integer next to x, and the one on the other side.
const fn nearest(x: f64) -> (i32, i32) {
    let near = round(x);
    let other = if (near as f64) < x {
        near + 1
    } else {
        near - 1
    };
    (near, other)
}

/// Largest distance of a line from a curve, of whose bend the chord's middle is `bend` short, where
/// the ends of the line are `from` and `to` above those of the curve.
const fn largest_error(from: f64, to: f64, bend: f64) -> f64 {
    let ends = f64::max(from.abs(), to.abs());
    let tilt = to - from;
    // The line is parallel to the curve between the ends, or nowhere.
    if bend.abs() * 4.0 <= tilt.abs() {
        return ends;
    }
    let between = (from + to) / 2.0 - bend - tilt * tilt / (16.0 * bend);
    f64::max(ends, between.abs())
}

#[cfg(test)]
#[allow(unsafe_code)]
mod tests {
    use super::*;

    #[test]
    fn table_is_pinned() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        let mut digest = crc.digest();
        for line in LINES.0.as_flattened().as_flattened() {
            digest.update(&line.to_le_bytes());
        }
        assert_eq!(digest.finalize(), 1_788_085_289, "the table's checksum");
    }

    /// The number for each part of every k at the `half` turn u / 2.
    fn atoms(half: u32, is_on: bool) -> [[i32; 2]; GRID] {
        let impulse = Impulse {
            offset_us: 0,
            is_on,
        };
        let mut sums = [[Sum::ZERO; 2]; GRID];
        let half = |_| Phase::from_bits(half);
        portable::exponentials([impulse].into_iter(), half, &mut sums);
        sums.map(|pair| pair.map(Sum::to_bits))
    }

    /// What ties at u = 0 go to the lower k by.
    #[test]
    fn no_k_is_before_another_at_the_start_of_a_window() {
        let [_, others @ ..] = atoms(0, true);
        assert_eq!(others, [[ATOM_MAX / ONE * ONE, 0]; GRID - 1]);
    }

    #[test]
    fn atoms_are_within_the_bound() {
        let mut worst = [[0.0_f64; 2]; GRID];
        let mut largest = 0;
        let bits = ROWS_LOG2 + DISTANCE_BITS;
        let unit = 1_u32 << (29 - bits);
        // Both ends of every distance in the first quarter.
        for at in 0..1_u32 << bits {
            let places = [at * unit, at * unit + unit - 1];
            let on = atoms(places[0], true);
            for half in places {
                let u = f64::from(half) / f64::from(1_u32 << 31);
                let (sin, cos) = libm::sincos(TAU * u);
                let mut exact = [1.0, 0.0];
                for (found, worst) in on.iter().zip(&mut worst).skip(1) {
                    let [re, im] = exact;
                    exact = [re * cos + im * sin, im * cos - re * sin];
                    let error: [f64; 2] = core::array::from_fn(|i| {
                        f64::from(found[i]) / f64::from(1 << FRACTION_BITS) - exact[i]
                    });
                    worst[0] = worst[0].max(error[0].abs()).max(error[1].abs());
                    worst[1] = worst[1].max(libm::hypot(error[0], error[1]));
                    largest = largest.max(found[0].abs()).max(found[1].abs());
                }
            }
        }
        let worst = worst.map(|worst| worst.map(libm::log2));
        let is_within = |[part, both]: &[f64; 2]| *part <= -14.12 && *both <= -14.06;
        assert!(worst.iter().all(is_within), "{worst:?}");
        assert!(largest < 1 << FRACTION_BITS);
    }

    #[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
    proptest::proptest! {
        #[test]
        fn vectors_give_the_same_bits(
            events in proptest::collection::vec(
                (0..1_u32 << 31, proptest::prelude::any::<bool>()),
                0..=CHUNK_EVENTS,
            ),
        ) {
            let impulses = || {
                let impulse = |(offset_us, is_on): &(u32, bool)| Impulse {
                    offset_us: *offset_us,
                    is_on: *is_on,
                };
                events.iter().map(impulse)
            };
            let half = |impulse: Impulse| Phase::from_bits(impulse.offset_us);
            let mut sums = [[[Sum::NEG_ONE; 2]; GRID]; 2];
            portable::exponentials(impulses(), half, &mut sums[0]);
            vectors::exponentials(impulses(), half, &mut sums[1]);
            proptest::prop_assert_eq!(sums[0], sums[1]);
            if crate::transform::wave::avx2::is_there() {
                // SAFETY: the processor has AVX2; both are 128 bytes.
                let found: [[Sum; 2]; GRID] = unsafe {
                    let found = vectors::first_exponentials::<4>(impulses(), half);
                    core::mem::transmute(found)
                };
                proptest::prop_assert_eq!(&sums[0][1..], &found[1..]);
                proptest::prop_assert_eq!(found[0], [Sum::ZERO; 2]);
            }
        }
    }
}
