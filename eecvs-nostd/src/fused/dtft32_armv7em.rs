//! Encodes a DTFT pixel of several events on up to 32 frequencies: the stages of [`crate::fused`], with the kept
//! sums side by side from the start and the output's state in registers.
//!
//! The stages in Rust serve other processors and other grids. All give the same bits.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::mem::{MaybeUninit, offset_of};

use crate::accumulate::any_grid;
use crate::accumulate::any_grid::Turn;
use crate::accumulate::dtft16;
use crate::fixed_point::{CHUNK_EVENTS, Coefficient, FRACTION_BITS, Sum};
use crate::group::Impulses;
use crate::pack::bits_lsb_first::{BitWriter, Position};
use crate::pack::packer::code_tables_armv7em;
use crate::pack::packer::code_tables_armv7em::Counts;
use crate::pack::packer::{Packer, put_levels};
use crate::prune;
use crate::stage::{Stage, Trace};
use crate::transform::Transform;
use crate::transform::phase::PhaseScale;
use crate::transform::shape::{Packing, Shape, width_of};
use crate::window::{NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot};

/// Returns whether [`Waves`] handles this frame.
pub fn is_for(packing: &Packing) -> bool {
    packing.transform == Transform::Dtft
        && packing.quantiser.step_log2() <= 0
        && prune::armv7em::is_for(packing.shape())
}

/// Largest number of words that a pixel takes without its levels: counts and gap, 3 * 31 bits and 4; the set, a bit
/// and 32; the levels' width, up to 32; and one word for bits that were pending.
const PLACE_WORDS_MAX: usize = 4 + 1 + 1 + 1;

/// The parameters that the pixels of a frame share, and memory lent for a pixel's sums.
#[derive(Debug)]
pub struct Waves<'e> {
    shape: Shape,
    /// Room for 2K sums.
    sums: &'e mut [Sum],
    /// Room for 2K numbers.
    numbers: &'e mut [u32],
    pub common: Common,
}

/// The part of the parameters that [`put`] reads.
#[derive(Debug)]
#[repr(C)]
pub struct Common {
    r: u32,
    sums: *mut Sum,
    /// Shift from sums to levels.
    shift: u32,
    /// Bits of a level of one event.
    one_bits: u32,
    /// Zeros before 2 2^g + 1, for a gap code of order g.
    gap_zeros: u32,
    counts: &'static Counts,
    grid: u32,
    /// The set k = 0..r, as one bit per k.
    low: u32,
    /// Shift and factor from an offset to u / 2: [`PhaseScale::parts`].
    scale: [u32; 2],
}

// The assembly relies on these.
const _: () = assert!(SLOTS_MAX < 0x8000 && NO_SLOT >= 0x8000 && NEXT_SHIFT == 16);
const _: () = assert!(size_of::<Slot>() == 8 && size_of::<Turn>() == 8);
const _: () = assert!(offset_of!(Common, sums) == 4 && offset_of!(Common, shift) == 8);
const _: () = assert!(offset_of!(Common, gap_zeros) == 16 && offset_of!(Common, grid) == 24);
const _: () = assert!(offset_of!(Common, scale) == 32);
// The number of ON events leaves the three bits below n's free.
const _: () = assert!(CHUNK_EVENTS < 1 << 13 && size_of::<[u32; 2]>() == 8);

/// Returns the largest number of words that a pixel takes, with levels of up to 32 bits.
pub const fn words_max(shape: Shape) -> usize {
    PLACE_WORDS_MAX + 2 * shape.r
}

impl<'e> Waves<'e> {
    /// Creates an instance, or returns `None` if either memory has room for fewer than 2K numbers.
    pub fn new(
        shape: Shape,
        scale: PhaseScale,
        (sums, numbers): (&'e mut [Sum], &'e mut [u32]),
        packer: &Packer,
    ) -> Option<Self> {
        let sums = sums.get_mut(..2 * shape.grid)?;
        let numbers = numbers.get_mut(..2 * shape.grid)?;
        let (shift, one_bits) = packer.level_parts();
        let (order, _) = packer.gap_parts();
        let (phase_shift, reciprocal) = scale.parts();
        let common = Common {
            r: shape.r as u32,
            sums: sums.as_mut_ptr(),
            shift,
            one_bits,
            gap_zeros: 30_u32.wrapping_sub(order),
            counts: code_tables_armv7em::counts(),
            grid: shape.grid as u32,
            low: !(u32::MAX << (shape.r as u32 & 31)),
            scale: [phase_shift, reciprocal],
        };
        Some(Self {
            shape,
            sums,
            numbers,
            common,
        })
    }

    /// Encodes a pixel of 2 events up to a chunk. `gap` is twice the sum of its gap and 2^g, plus 1; `tally` has
    /// its events in the upper half and its ON events in the lower. The output must have room for it.
    #[inline(always)]
    pub fn encode<T: Trace>(
        &mut self,
        (gap, tally): (u32, u32),
        impulses: &Impulses<'_>,
        packer: &Packer,
        writer: &mut BitWriter<'_>,
        trace: &mut T,
    ) {
        let kept = self.choose(tally, impulses, trace);
        trace.enter(Stage::Pack);
        // SAFETY: the pointer is that of the reference. `put_apart` reads a pair for every k of the set except 0,
        // all of which have just been written, and writes the position and fewer words from there on than there is
        // room for. This file is built only for cores that have the instructions.
        let is_put = unsafe {
            let writer: *mut BitWriter<'_> = writer;
            let (position, words, _) = BitWriter::raw_parts(writer);
            put_apart(&self.common, gap, (tally, kept), position, words)
        };
        if !is_put {
            self.put_long((gap >> 1, tally), kept, packer, writer);
        }
    }

    /// Returns the kept k, and leaves their sums, except for k = 0, side by side at `common.sums`.
    #[inline(always)]
    pub fn choose<T: Trace>(&mut self, tally: u32, impulses: &Impulses<'_>, trace: &mut T) -> u32 {
        let events = tally >> 16;
        self.common.sums = self.sums.as_mut_ptr();
        let (slots, head) = impulses.parts();
        if events == 2 {
            trace.enter(Stage::Accumulate);
            // SAFETY: the list is the group's and holds events of this window. There are 2K sums. This file is
            // built only for cores that have the instructions.
            let kept = unsafe { two(&self.common, slots.as_ptr(), head) };
            if kept != 0 {
                return kept;
            }
        }
        self.choose_largest((tally, head), slots, trace)
    }

    /// Does the same from all sums.
    #[inline(always)]
    pub fn choose_largest<T: Trace>(
        &mut self,
        (tally, head): (u32, u32),
        slots: &[Slot],
        trace: &mut T,
    ) -> u32 {
        let (events, on) = (tally >> 16, tally & 0xffff);
        trace.enter(Stage::Accumulate);
        let pairs: *mut [Sum; 2] = self.sums.as_mut_ptr().cast();
        if self.shape.grid == dtft16::GRID {
            // SAFETY: the list is the group's, holds events of this window, and is not empty. There are as many
            // pairs of sums, and nothing else accesses them while this runs.
            unsafe {
                dtft16::armv7em::add(slots.as_ptr(), head, &self.common.scale, &mut *pairs.cast())
            };
        } else {
            let mut memory = [const { MaybeUninit::uninit() }; CHUNK_EVENTS];
            // SAFETY: as above; `turns_of` writes one turn per event. There are K pairs of sums.
            unsafe {
                turns_of(&self.common, slots.as_ptr(), head, memory.as_mut_ptr());
                let (first, k) = (memory.as_ptr().cast(), self.shape.grid - 1);
                any_grid::armv7em::add_exponentials(
                    pairs.wrapping_add(1),
                    k,
                    first,
                    events as usize,
                );
            }
        }
        trace.enter(Stage::Prune);
        let zeroth = (2 * on).wrapping_sub(events).cast_signed();
        // SAFETY: the sums and numbers exist, and `new` is called only for shapes that this function handles.
        let kept = unsafe {
            let sums = self.sums.as_mut_ptr();
            *sums.cast() = [Sum::from_integer(zeroth), Sum::ZERO];
            prune::armv7em::largest(sums, events, self.shape, self.numbers.as_mut_ptr())
        };
        trace.enter(Stage::Quantise);
        // SAFETY: the set has no index of K or above, and there are 2K sums.
        unsafe { gather(self.sums.as_mut_ptr(), kept & !1) };
        self.common.sums = self.sums.as_mut_ptr();
        kept
    }

    /// Packs a pixel that [`put`] does not handle: with wide levels, without levels, or with a long place.
    #[cold]
    #[inline(never)]
    pub fn put_long(
        &mut self,
        (shifted, tally): (u32, u32),
        kept: u32,
        packer: &Packer,
        writer: &mut BitWriter<'_>,
    ) {
        let (events, on) = (tally >> 16, tally & 0xffff);
        let Common {
            shift,
            one_bits,
            grid,
            r,
            low,
            ..
        } = self.common;
        packer.place_after(shifted, (on, events - on), writer);
        if kept == low {
            writer.put_clean(1, 1);
        } else {
            writer.put_clean(0, 1);
            writer.put_clean(kept, grid);
        }
        let len = 2 * (r - (kept & 1)) as usize;
        let mut spread = 0;
        for (level, sum) in self.numbers.iter_mut().zip(&*self.sums).take(len) {
            let value = sum.to_bits() >> (shift & 31);
            *level = value.cast_unsigned();
            spread |= (value ^ (value >> 31)).cast_unsigned();
        }
        if let Some(levels) = self.numbers.get(..len)
            && len > 0
        {
            // Not clamped as in `Packing::level_bits_max`: the step is at most 1, and the events are few.
            let most = width_of(events - 1) + one_bits;
            put_levels(most, levels, spread, writer);
        }
    }
}

/// Width of the widest levels of which two fit a word.
const PAIR_BITS_MAX: u32 = 16;
/// Width of the widest levels of which four fit a word.
const FOUR_BITS_MAX: u32 = 8;

/// Returns the kept k of a pixel of two events, whose list begins at `head`, or 0 if the choice requires all sums.
/// Leaves the sums of the kept k, except for k = 0, side by side. The Z flag is set if the result is 0.
///
/// # Safety
/// Every link must be an existing slot or the list's end, and `common` must have 2K sums.
#[unsafe(naked)]
pub unsafe extern "C" fn two(common: &Common, slots: *const Slot, head: u32) -> u32 {
    naked_asm!(
        "push {{r4-r11, lr}}",
        // The stack holds 36 bytes of lanes, and at 40 two turns.
        "sub sp, #60",
        "mov r9, r0",
        "ldrd r6, r7, [r0, #32]",
        "add r2, r1, r2, lsl #3",
        "ldrd r0, r5, [r2]",
        "lsls r0, r6",
        "umull r12, r3, r0, r7",
        "lsls r3, r3, #1",
        "lsls r2, r5, #31",
        "strd r2, r3, [sp, #40]",
        "lsrs r5, r5, #16",
        "add r1, r1, r5, lsl #3",
        "ldrd r0, r1, [r1]",
        "lsls r0, r6",
        "umull r12, r5, r0, r7",
        "lsls r5, r5, #1",
        "lsls r4, r1, #31",
        "strd r4, r5, [sp, #48]",
        "eor r1, r2, r4",
        "subs r4, r3, r5",
        "mov r0, sp",
        "ldr r2, [r9, #24]",
        "ldr r3, [r9]",
        "bl {of_two}",
        "movs r5, r0",
        "beq 2f",
        "bic r0, r0, #1",
        "ldr r1, [r9, #4]",
        "add r2, sp, #40",
        "ldr r3, [r9, #24]",
        "cmp r3, #{rows_grid}",
        "bne 3f",
        "bl {two_of_rows}",
        "movs r0, r5",
        // The Z flag shows whether the result is 0.
        "2:",
        "add sp, #60",
        "pop {{r4-r11, pc}}",
        "3:",
        "bl {two_exponentials}",
        "movs r0, r5",
        "b 2b",
        of_two = sym prune::armv7em::of_two,
        two_of_rows = sym dtft16::armv7em::two_exponentials,
        two_exponentials = sym any_grid::armv7em::two_exponentials,
        rows_grid = const dtft16::GRID,
    )
}

/// Writes the turns of the list of slots that begins at `head`.
///
/// # Safety
/// Every link must be an existing slot or the list's end; `turns` must have room for one turn per event.
#[unsafe(naked)]
unsafe extern "C" fn turns_of(
    common: &Common,
    slots: *const Slot,
    head: u32,
    turns: *mut MaybeUninit<Turn>,
) {
    naked_asm!(
        "push {{r4-r6, lr}}",
        "ldrd r0, r12, [r0, #32]",
        "2:",
        "add r2, r1, r2, lsl #3",
        "ldrd r4, r2, [r2]",
        "lsls r4, r0",
        "umull r6, r5, r4, r12",
        "lsls r4, r2, #31",
        "lsls r5, r5, #1",
        "stm r3!, {{r4, r5}}",
        // A negative link ends the list.
        "asrs r2, r2, #16",
        "bpl 2b",
        "pop {{r4-r6, pc}}",
    )
}

/// Moves the pairs of `set` to the front, ascending.
///
/// # Safety
/// `sums` must have a pair for every k up to the highest of the set.
#[unsafe(naked)]
unsafe extern "C" fn gather(sums: *mut Sum, set: u32) {
    naked_asm!(
        "push {{r4, lr}}",
        "mov r12, r0",
        "rbit r1, r1",
        "cbz r1, 3f",
        "2:",
        "clz r2, r1",
        "add r0, r0, r2, lsl #3",
        "lsls r1, r2",
        "ldrd r3, r4, [r0], #8",
        "strd r3, r4, [r12], #8",
        "lsls r1, r1, #1",
        "bne 2b",
        "3:",
        "pop {{r4, pc}}",
    )
}

/// Appends `$value`, which must have no bits beyond its `$bits`; overwrites `$tmp`, which may be `$bits`.
///
/// r9: bits of the next word; r8: 0; r10: the bit where the value goes; r12: where the word goes; r11: another
/// register.
macro_rules! put {
    ($value:literal, $bits:literal, $tmp:literal) => {
        concat!(
            // r8 holds what the word has no room for.
            "umlal r9, r8, ",
            $value,
            ", r10\n",
            "lsls r11, r10, ",
            $bits,
            "\n",
            "bne 2f\n",
            "str r9, [r12], #4\n",
            "mov r9, r8\n",
            "mov r8, #0\n",
            "rsb ",
            $tmp,
            ", ",
            $bits,
            ", #0\n",
            "ror r11, r10, ",
            $tmp,
            "\n",
            "2:\n",
            "mov r10, r11\n",
        )
    };
}

/// Converts four sums from r2 on to levels side by side in r0. r7: shift; r5: 2^bits; r3: the highest bit of each
/// level.
macro_rules! four {
    () => {
        "ldm r2!, {{r0, r1, r11, lr}}
        asrs r0, r7
        asrs r1, r7
        asr r11, r11, r7
        asr lr, lr, r7
        mla r11, lr, r5, r11
        mla r1, r11, r5, r1
        mla r0, r1, r5, r0
        adds r0, r0, r3
        eors r0, r3"
    };
}

/// Packs a pixel of 2 events up to a chunk. Its pairs of sums for `kept`, except for k = 0, stand side by side;
/// `gap` and `tally` are as in [`Waves::encode`]. If levels have more than 16 bits, if there are none, or if the
/// place has more than 31 bits, changes nothing, returns 0 and sets the Z flag.
///
/// The output's state is in registers: r9 holds the bits of the next word, r10 the bit after them, r12 where the
/// word goes, and r8 is 0. Overwrites r0 to r7 and r11.
///
/// # Safety
/// For assembly alone. The words from r12 on and the pairs must exist.
#[unsafe(naked)]
pub unsafe extern "C" fn put(common: &Common, gap: u32, tally: u32, kept: u32) -> u32 {
    naked_asm!(
        "push {{r0, r12, lr}}",
        // r4: number of pairs; r7: leading zeros of n - 1.
        "ldrd r4, r12, [r0]",
        "and r5, r3, #1",
        "subs r4, r4, r5",
        "beq 9f",
        "lsrs r7, r2, #16",
        "subs r7, #1",
        "clz r7, r7",
        // r5: mask of the bits that differ from the sign bit. The loop stops once it has the highest bit that |c| <
        // n allows.
        "rsb r8, r7, #{fraction_bits} + 31",
        "movs r5, #0",
        "mov r6, r4",
        "3:",
        "ldrd r11, lr, [r12], #8",
        "eor r11, r11, r11, asr #31",
        "orr r5, r5, r11",
        "eor lr, lr, lr, asr #31",
        "orr r5, r5, lr",
        "lsrs r11, r5, r8",
        "bne 4f",
        "subs r6, #1",
        "bne 3b",
        "4:",
        // r8: bits of a level; lr: zeros before them.
        "ldrd r8, r11, [r0, #8]",
        "lsrs r5, r8",
        "clz r5, r5",
        "rsb r8, r5, #33",
        "cmp r8, #{pair_bits_max}",
        "bhi 9f",
        "sub r11, r11, r7",
        "sub r11, r11, r8",
        "add lr, r11, #32",
        // r1: the gap's code, with a 1 above it; r5: its bits.
        "ldrd r5, r11, [r0, #16]",
        "clz r6, r1",
        "subs r5, r5, r6",
        "lsls r1, r5",
        "subs r5, r5, r6",
        "adds r5, #31",
        // n and the ON events after it, less the 1s above both.
        "add r6, r11, r2, lsr #13",
        "ldrd r6, r11, [r6]",
        "smlabt r2, r2, r6, r11",
        "lsls r2, r5",
        "adds r1, r1, r2",
        "uxtah r5, r5, r6",
        "adds r5, r5, r7",
        "subs r5, #32",
        "cmp r5, #31",
        "bhi 9f",
        // The set, for which one bit is enough if it holds the lowest k.
        "ldrd r7, r6, [r0, #24]",
        "movs r2, #1",
        "cmp r3, r6",
        "bne 5f",
        "lsl r6, r2, r5",
        "orrs r1, r6",
        "movs r3, #0",
        "movs r7, #0",
        "5:",
        "adds r5, #1",
        "mov r6, r8",
        "mov r8, #0",
        "ldr r12, [sp, #4]",
        put!("r1", "r5", "r5"),
        put!("r3", "r7", "r7"),
        "lsl r1, r2, lr",
        "add lr, lr, #1",
        put!("r1", "lr", "lr"),
        // r2: sums; r4: pairs; r7: shift; r6: bits of a level; r5: 2^bits; r3: the highest bit of each of two
        // levels, later of four.
        "lsl r5, r2, r6",
        "ldrd r2, r7, [r0, #4]",
        "lsrs r1, r5, #1",
        "mla r3, r1, r5, r1",
        "cmp r6, #{four_bits_max}",
        "bhi 7f",
        "subs r4, #2",
        "blo 6f",
        "mla r3, r3, r5, r1",
        "mla r3, r3, r5, r1",
        "lsls r6, r6, #2",
        "cmp r6, #32",
        "beq 11f",
        "12:",
        "3:",
        four!(),
        put!("r0", "r6", "r1"),
        "subs r4, #2",
        "bhs 3b",
        "b 4f",
        // Levels of one byte, which lie in the upper halves of the sums: whole words. r6 and r7: shifts to the
        // upper and the lower byte of a half.
        "11:",
        "cmp r7, #16",
        "blo 12b",
        "mov r3, #0x00ff00ff",
        "rsb r6, r7, #24",
        "subs r7, #16",
        "10:",
        "ldm r2!, {{r0, r1, r11, lr}}",
        "pkhtb r0, r11, r0, asr #16",
        "pkhtb r1, lr, r1, asr #16",
        "lsrs r0, r7",
        "ands r0, r3",
        "lsls r1, r6",
        "bic r1, r1, r3",
        "orrs r0, r1",
        "umlal r9, r8, r0, r10",
        "str r9, [r12], #4",
        "mov r9, r8",
        "mov r8, #0",
        "subs r4, #2",
        "bhs 10b",
        "adds r7, #16",
        "movs r6, #32",
        "4:",
        "lsrs r6, r6, #2",
        "lsrs r1, r5, #1",
        "mla r3, r1, r5, r1",
        "6:",
        "adds r4, #2",
        "beq 8f",
        // In pairs.
        "7:",
        "lsls r6, r6, #1",
        "5:",
        "ldrd r0, r1, [r2], #8",
        "asrs r0, r7",
        "asrs r1, r7",
        "mla r0, r1, r5, r0",
        "adds r0, r0, r3",
        "eors r0, r3",
        put!("r0", "r6", "r1"),
        "subs r4, #1",
        "bne 5b",
        "8:",
        "movs r0, #1",
        "add sp, #8",
        "pop {{pc}}",
        "9:",
        "mov r8, #0",
        "movs r0, #0",
        "add sp, #4",
        "pop {{r12, pc}}",
        fraction_bits = const FRACTION_BITS,
        pair_bits_max = const PAIR_BITS_MAX,
        four_bits_max = const FOUR_BITS_MAX,
    )
}

/// Calls [`put`] with the output's state in memory.
///
/// # Safety
/// The words from the position on and the pairs must exist.
unsafe fn put_apart(
    common: &Common,
    gap: u32,
    (tally, kept): (u32, u32),
    position: *mut Position,
    words: *mut [u8; 4],
) -> bool {
    let fields = Fields {
        gap,
        tally,
        kept,
        words,
    };
    // SAFETY: by the caller's guarantee.
    unsafe { put_fields(common, &fields, &mut *position) != 0 }
}

/// The arguments that [`put_fields`] passes on.
#[repr(C)]
struct Fields {
    gap: u32,
    tally: u32,
    kept: u32,
    words: *mut [u8; 4],
}

/// Loads the output's state from memory, calls [`put`] and stores the state.
///
/// # Safety
/// As for [`put_apart`].
#[unsafe(naked)]
unsafe extern "C" fn put_fields(common: &Common, fields: &Fields, position: &mut Position) -> u32 {
    naked_asm!(
        "push {{r2, r4-r11, lr}}",
        "ldm r1, {{r1, r3, r4, r5}}",
        "push {{r4, r5}}",
        "ldm r2, {{r6, r9, r10}}",
        "add r12, r5, r6, lsl #2",
        "rsb r10, r10, #32",
        "movs r6, #1",
        "lsl r10, r6, r10",
        "mov r8, #0",
        "mov r2, r3",
        "mov r3, r4",
        "bl {put}",
        "ldrd r5, r1, [sp, #4]",
        "sub r2, r12, r5",
        "lsrs r2, r2, #2",
        "rbit r3, r10",
        "clz r3, r3",
        "rsb r3, r3, #32",
        "str r2, [r1]",
        "strd r9, r3, [r1, #4]",
        "add sp, #12",
        "pop {{r4-r11, pc}}",
        put = sym put,
    )
}
