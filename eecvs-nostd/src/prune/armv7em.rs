//! Selects the largest of up to 32 magnitudes on a core with DSP instructions. It searches eight bits of each, four
//! to a word, for a value that exactly as many reach as are kept; where these bits do not separate them, it
//! searches the eight bits below. Equal magnitudes are left to [`crate::prune`], which gives the same set.
#![allow(unsafe_code)]

use core::arch::naked_asm;

use crate::fixed_point::Sum;
use crate::prune;
use crate::transform::shape::Shape;

/// Largest K that this file handles.
pub const GRID_MAX: usize = 32;

/// Returns whether [`of_two`] and [`largest`] handle this shape: lanes are four to a word.
pub const fn is_for(shape: Shape) -> bool {
    shape.grid.is_multiple_of(4) && shape.grid <= GRID_MAX && shape.r < shape.grid && shape.r > 0
}

/// How a search begins: its first value and the lowest in question, in every byte. A lowest value above 0 asks for
/// a margin, and the highest value is 255 minus it.
#[derive(Debug, Clone, Copy)]
struct Search {
    first: u32,
    lowest: u32,
}

/// Squares of magnitudes have their middle far below their largest, which is 128 to 255.
const SQUARES: Search = Search {
    first: 0x4040_4040,
    lowest: 0,
};
/// Bits below those searched: within a byte all values are equally likely.
const REST: Search = Search {
    first: 0x8080_8080,
    lowest: 0,
};
/// Distances on a circle: all are equally likely.
const DISTANCES: Search = Search {
    first: 0x8080_8080,
    lowest: 0x0808_0808,
};

/// Returns the r largest |c_k| of a pixel's pairs of sums, of up to a chunk of `events`, as a bit each; ties go to
/// the lower k.
///
/// # Safety
/// [`is_for`] has to hold for `shape`, there have to be 2K `sums`, and `keys` has to have room for K.
#[inline(always)]
pub unsafe fn largest(sums: *const Sum, events: u32, shape: Shape, keys: *mut u32) -> u32 {
    // SAFETY: the caller ensures all but the bound of K, which the branch does.
    unsafe {
        if shape.grid <= GRID_MAX / 2 {
            largest_in::<4>(sums, events, shape, keys)
        } else {
            largest_in::<8>(sums, events, shape, keys)
        }
    }
}

/// As [`largest`], with W words of lanes.
///
/// # Safety
/// As for [`largest`]; K is at most 4 W.
#[inline(always)]
unsafe fn largest_in<const W: usize>(
    sums: *const Sum,
    events: u32,
    shape: Shape,
    keys: *mut u32,
) -> u32 {
    let Shape { grid, r, .. } = shape;
    let mut lanes = [0; W];
    // Scaled as by `Coefficient::relative`.
    let shift = events.leading_zeros().wrapping_sub(26) & 31;
    // SAFETY: `squares` reads 2K sums and writes K keys and K / 4 words, 1 to W. This file is compiled only for
    // cores that have the instructions.
    let mut below = unsafe { squares(sums, keys, grid, shift, lanes.as_mut_ptr()) };
    let (mut base, mut search) = (0, SQUARES);
    loop {
        let kept = separate(&mut lanes, r as u32, search);
        if kept != 0 {
            return kept;
        }
        if below == 0 {
            // Equal magnitudes are left.
            // SAFETY: `squares` has written K keys.
            let keys = unsafe { core::slice::from_raw_parts(keys, grid) };
            return prune::largest_bits(keys, r as u32);
        }
        // More than r have this byte or a higher one, fewer a higher one: search the eight bits below it.
        base += (lanes[0] & 0xff) << (below & 31);
        below = below.saturating_sub(8);
        search = REST;
        // SAFETY: as above.
        unsafe { zoom(keys, lanes.as_mut_ptr(), grid, base, below) };
    }
}

/// Returns the `r` bytes of `lanes` that are above all others, as a bit each. If no value separates them, returns
/// 0, and every byte of the first word is then a value that more than r reach.
#[inline(always)]
fn separate<const W: usize>(lanes: &mut [u32; W], r: u32, search: Search) -> u32 {
    let Search { first, lowest } = search;
    // SAFETY: both read W words and write the first. This file is compiled only for cores that have the
    // instructions.
    unsafe {
        if W == 4 {
            separate_16(lanes.as_mut_ptr(), r, first, lowest)
        } else {
            separate_32(lanes.as_mut_ptr(), r, first, lowest)
        }
    }
}

/// Returns the r largest |c_k| of a pixel of two events, as a bit each; 0 if they have to be found in another way.
///
/// With d the distance of k (u - u') from the nearest integer, or from the nearest odd half if both have the same
/// polarity, |c_k|^2 = 2 - 2 cos(2 pi d). That grows with d, so no atom is needed to order the coefficients. A
/// margin makes the set that of the fixed-point sums: bytes are floor(512 d), the value below the first byte that
/// is kept does not occur, and rounding u - u' to 2^-15 and the odd start move d by at most 2^-11, so d of what is
/// kept is 2^-10 above that of the rest. With the threshold between 8 / 512 and 248 / 512, |c|^2 is more than
/// 1.2e-3 above; atoms within 2^-14.08 ([`crate::accumulate::dtft16`]; [`crate::accumulate::any_grid`] has them
/// within 2^-14.6) make at most 2 * 4 * 2 * 2^-14.08 = 9.3e-4.
///
/// To be called from assembly only. r0: 9 words for the bytes; r1: whether polarities differ << 31; r2: K; r3: r;
/// r4: u - u'. Also overwrites r5 to r8, r10 and r11.
///
/// # Safety
/// [`is_for`] has to hold for K and r.
#[unsafe(naked)]
pub unsafe extern "C" fn of_two() {
    // The bytes of four k.
    macro_rules! word {
        () => {
            "ssub16 r1, r12, r5
            sel r1, r1, r5
            and r1, r7, r1, lsr #7
            uadd16 r5, r5, r4
            ssub16 r2, r12, r6
            sel r2, r2, r6
            and r2, r10, r2, lsl #1
            orrs r1, r2
            str r1, [r0], #4
            uadd16 r6, r6, r4"
        };
    }
    naked_asm!(
        // r1: 1, plus half a turn of 16 bits if the polarities are the same: all multiples of the difference are
        // even, and none is -2^15, which has no magnitude.
        "mvns r1, r1",
        "lsrs r1, r1, #31",
        "lsls r1, r1, #15",
        "adds r1, #1",
        "pkhbt r7, r1, r1, lsl #16",
        // r1: the difference in both halves.
        "add r1, r4, #0x10000",
        "lsrs r1, r1, #17",
        "lsls r1, r1, #1",
        "pkhbt r1, r1, r1, lsl #16",
        "uadd16 r4, r1, r1",
        // r5: k = 0 and 2, r6: k = 1 and 3, r4: what brings both to the next four.
        "uadd16 r5, r7, r4",
        "pkhbt r5, r7, r5",
        "uadd16 r6, r5, r1",
        "uadd16 r4, r4, r4",
        "mov r7, #0x00ff00ff",
        "mov r10, #0xff00ff00",
        "mov r11, r0",
        "mov r12, #0",
        "lsls r1, r2, #28",
        "beq 3f",
        // Lanes without a key are below all others.
        "mov r8, r12",
        "strd r8, r12, [r0]",
        "strd r8, r12, [r0, #8]",
        "strd r8, r12, [r0, #16]",
        "strd r8, r12, [r0, #24]",
        "3:",
        "add r8, r0, r2",
        "2:",
        word!(),
        word!(),
        "cmp r0, r8",
        "blo 2b",
        // What is beyond the last four.
        "str r12, [r8]",
        "mov r0, r11",
        "mov r1, r3",
        "mov r2, #{first}",
        "mov r3, #{lowest}",
        "sub r8, r8, r0",
        "cmp r8, #16",
        "bls {separate_16}",
        "b {separate_32}",
        separate_16 = sym separate_16,
        separate_32 = sym separate_32,
        first = const DISTANCES.first,
        lowest = const DISTANCES.lowest,
    )
}

/// Computes re^2 + im^2 of every pair as [`crate::transform::Dtft`] does, and the upper 8 bits of each in a byte.
/// Returns how many bits are below those.
///
/// # Safety
/// `sums` has to have 2 `grid` numbers, `keys` room for `grid`, `lanes` room for a quarter of them, and `grid` has
/// to be a multiple of 4 above 0.
#[unsafe(naked)]
unsafe extern "C" fn squares(
    sums: *const Sum,
    keys: *mut u32,
    grid: usize,
    shift: u32,
    lanes: *mut u32,
) -> u32 {
    // The keys of two k.
    macro_rules! two {
        () => {
            "ldm r0!, {{r4-r7}}
            lsls r4, r3
            lsls r5, r3
            lsls r6, r3
            lsls r7, r3
            smmul r4, r4, r4
            smmla r4, r5, r5, r4
            smmul r5, r6, r6
            smmla r5, r7, r7, r5
            stm r1!, {{r4, r5}}
            orr r12, r12, r4
            orr r12, r12, r5"
        };
    }
    naked_asm!(
        "push {{r4-r9, lr}}",
        "mov r8, r1",
        "mov r9, r2",
        // r12: the bits that any key has.
        "mov r12, #0",
        "2:",
        two!(),
        two!(),
        "subs r2, #4",
        "bne 2b",
        "ldr r1, [sp, #28]",
        "clz r3, r12",
        "rsbs r3, r3, #24",
        "it mi",
        "movmi r3, #0",
        "3:",
        "ldm r8!, {{r4-r7}}",
        "lsrs r4, r3",
        "lsrs r5, r3",
        "lsrs r6, r3",
        "lsrs r7, r3",
        "orr r4, r4, r5, lsl #8",
        "orr r4, r4, r6, lsl #16",
        "orr r4, r4, r7, lsl #24",
        "str r4, [r1], #4",
        "subs r9, #4",
        "bne 3b",
        "mov r0, r3",
        "pop {{r4-r9, pc}}",
    )
}

/// Computes (key - `base`) / 2^`shift` of every key, saturated to a byte.
///
/// # Safety
/// `keys` has to have `grid` numbers, `lanes` room for a quarter of them, and `grid` has to be a multiple of 4
/// above 0.
#[unsafe(naked)]
unsafe extern "C" fn zoom(keys: *const u32, lanes: *mut u32, grid: usize, base: u32, shift: u32) {
    macro_rules! byte {
        ($key:literal) => {
            concat!(
                "subs ", $key, ", ", $key, ", r3\n", "asr ", $key, ", ", $key, ", r12\n", "usat ",
                $key, ", #8, ", $key, "\n",
            )
        };
    }
    naked_asm!(
        "push {{r4-r7, lr}}",
        "ldr r12, [sp, #20]",
        "2:",
        "ldm r0!, {{r4-r7}}",
        byte!("r4"),
        byte!("r5"),
        byte!("r6"),
        byte!("r7"),
        "orr r4, r4, r5, lsl #8",
        "orr r4, r4, r6, lsl #16",
        "orr r4, r4, r7, lsl #24",
        "str r4, [r1], #4",
        "subs r2, #4",
        "bne 2b",
        "pop {{r4-r7, pc}}",
    )
}

/// Computes a 1 in every byte of `$lane` that is not below that of r2, and adds it to r12 or, `first`, sets r12 to
/// it.
macro_rules! reach {
    ($lane:literal, $ones:literal, $zero:literal) => {
        concat!(
            "usub8 lr, ",
            $lane,
            ", r2\n",
            "sel lr, ",
            $ones,
            ", ",
            $zero,
            "\n",
            "add r12, r12, lr\n",
        )
    };
    (first $lane:literal, $ones:literal, $zero:literal) => {
        concat!(
            "usub8 r12, ",
            $lane,
            ", r2\n",
            "sel r12, ",
            $ones,
            ", ",
            $zero,
            "\n",
        )
    };
}

/// Leaves in `$low` the bits of those of the eight lanes in `$low` and `$high` that are not below that of r2. r3
/// and r12: bits of the lanes; `$zero`: 0.
macro_rules! bits {
    ($low:literal, $high:literal, $zero:literal) => {
        concat!(
            "usub8 lr, ",
            $low,
            ", r2\n",
            "sel ",
            $low,
            ", r3, ",
            $zero,
            "\n",
            "usub8 lr, ",
            $high,
            ", r2\n",
            "sel ",
            $high,
            ", r12, ",
            $zero,
            "\n",
            "orr ",
            $low,
            ", ",
            $low,
            ", ",
            $high,
            "\n",
            "usad8 ",
            $low,
            ", ",
            $low,
            ", ",
            $zero,
            "\n",
        )
    };
}

/// [`separate`] for 16 lanes.
///
/// # Safety
/// `lanes` has to have 4 words.
#[unsafe(naked)]
unsafe extern "C" fn separate_16(lanes: *mut u32, r: u32, first: u32, lowest: u32) -> u32 {
    macro_rules! count {
        () => {
            concat!(
                reach!(first "r4", "r10", "r11"),
                reach!("r5", "r10", "r11"),
                reach!("r6", "r10", "r11"),
                reach!("r7", "r10", "r11"),
                "usad8 r12, r12, r11",
            )
        };
    }
    naked_asm!(
        "push {{r4-r11, lr}}",
        "ldm r0, {{r4-r7}}",
        // More than r reach r8, fewer reach r9.
        "mov r8, r3",
        "mvn r9, r3",
        "mov r10, #0x01010101",
        "mov r11, #0",
        "2:",
        count!(),
        "cmp r12, r1",
        "beq 4f",
        "ite hi",
        "movhi r8, r2",
        "movls r9, r2",
        "uhadd8 r2, r8, r9",
        "cmp r2, r8",
        "bne 2b",
        "3:",
        "str r8, [r0]",
        "movs r0, #0",
        "pop {{r4-r11, pc}}",
        "4:",
        "cmp r3, #0",
        "beq 5f",
        // The value below has to separate them as well, or the one above.
        "sub r2, r2, r10",
        count!(),
        "cmp r12, r1",
        "beq 5f",
        "add r2, r2, r10, lsl #1",
        count!(),
        "cmp r12, r1",
        "bne 3b",
        "5:",
        "movw r3, #0x0201",
        "movt r3, #0x0804",
        "lsl r12, r3, #4",
        bits!("r4", "r5", "r11"),
        bits!("r6", "r7", "r11"),
        "orr r0, r4, r6, lsl #8",
        "pop {{r4-r11, pc}}",
    )
}

/// [`separate`] for 32 lanes.
///
/// # Safety
/// `lanes` has to have 8 words.
#[unsafe(naked)]
unsafe extern "C" fn separate_32(lanes: *mut u32, r: u32, first: u32, lowest: u32) -> u32 {
    macro_rules! count {
        () => {
            concat!(
                reach!(first "r4", "r3", "r0"),
                reach!("r5", "r3", "r0"),
                reach!("r6", "r3", "r0"),
                reach!("r7", "r3", "r0"),
                reach!("r8", "r3", "r0"),
                reach!("r9", "r3", "r0"),
                reach!("r10", "r3", "r0"),
                reach!("r11", "r3", "r0"),
                "usad8 r12, r12, r0",
            )
        };
    }
    naked_asm!(
        "push {{r4-r11, lr}}",
        "mvn r12, r3",
        // At sp: the lowest value, `lanes`, what more than r reach, what fewer reach.
        "push {{r3, r12}}",
        "sub sp, #8",
        "strd r3, r0, [sp]",
        "ldm r0, {{r4-r11}}",
        "mov r3, #0x01010101",
        "movs r0, #0",
        "2:",
        count!(),
        "cmp r12, r1",
        "beq 4f",
        "ite hi",
        "strhi r2, [sp, #8]",
        "strls r2, [sp, #12]",
        "ldrd r12, lr, [sp, #8]",
        "uhadd8 r2, r12, lr",
        "cmp r2, r12",
        "bne 2b",
        "3:",
        "ldrd r1, r2, [sp, #4]",
        "str r2, [r1]",
        "6:",
        "add sp, #16",
        "pop {{r4-r11, pc}}",
        "4:",
        "ldr r12, [sp]",
        "cmp r12, #0",
        "beq 5f",
        "sub r2, r2, r3",
        count!(),
        "cmp r12, r1",
        "beq 5f",
        "add r2, r2, r3, lsl #1",
        count!(),
        "cmp r12, r1",
        "bne 3b",
        "5:",
        "movw r3, #0x0201",
        "movt r3, #0x0804",
        "lsl r12, r3, #4",
        bits!("r4", "r5", "r0"),
        bits!("r6", "r7", "r0"),
        bits!("r8", "r9", "r0"),
        bits!("r10", "r11", "r0"),
        "orr r0, r4, r6, lsl #8",
        "orr r0, r0, r8, lsl #16",
        "orr r0, r0, r10, lsl #24",
        "b 6b",
    )
}
