//! In assembly, for the cores with Arm's DSP instructions. An event needs fourteen registers, of which a
//! compiler has thirteen and uses them less well: this takes two thirds of the instructions.
//!
//! Its frames are checked against events taken one by one, on the machine: see
//! `firmware/src/bin/golden.rs`.

use core::arch::naked_asm;
use core::mem::offset_of;

use super::Intake;
use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, NEXT_SHIFT, NO_HEAD, SLOTS_MAX, Slot};
use event_types::evt2::{KIND_SHIFT, LOW_BITS, LOW_SHIFT, NO_EVENT, SIDE_BITS, SIDE_MASK, X_SHIFT};

/// x where it is in a word, and the bits that an event has not.
const X_MASK: u32 = NO_EVENT | (SIDE_MASK << X_SHIFT);

/// What [`take_words`] works on.
#[repr(C)]
struct State {
    // In r1 to r9.
    word: *const [u8; 4],
    end: *const [u8; 4],
    slot: *mut Slot,
    len: u32,
    heads: *mut Head,
    heads_len: u32,
    width: u32,
    stride: u32,
    span_us: u32,
    // In memory.
    bitmap: *mut u32,
    time: u32,
    time_last: u32,
    /// Offset of the `TIME_HIGH` of 0, wrapping.
    zero_us: u32,
    span_at: u32,
    before_us: u32,
    before_at: u32,
}

pub fn take(intake: &mut Intake<'_>, words: &[[u8; 4]]) -> usize {
    let free = intake.slots.get_mut(intake.len as usize..);
    let free = free.unwrap_or_default();
    // A word takes a slot at the most.
    let some = words.get(..free.len()).unwrap_or(words);
    let range = some.as_ptr_range();
    let mut state = State {
        word: range.start,
        end: range.end,
        slot: free.as_mut_ptr(),
        len: intake.len,
        heads: intake.heads.as_mut_ptr(),
        heads_len: intake.heads.len().min(32 * intake.bitmap.len()) as u32,
        width: u32::from(intake.width) << X_SHIFT,
        stride: intake.stride.get(),
        span_us: intake.span_us,
        bitmap: intake.bitmap.as_mut_ptr(),
        time: intake.time,
        time_last: intake.time_last,
        zero_us: intake.span_us.wrapping_sub(intake.time << LOW_BITS),
        span_at: intake.span_at,
        before_us: intake.before_us,
        before_at: intake.before_at,
    };
    // SAFETY: the words from `word` to `end` are those of `some`. From `slot` on there are as
    // many slots as words, all of them lent to `intake`, as are `heads_len` heads and a bit of
    // the bitmap for each.
    unsafe { take_words(&mut state) };
    intake.len = state.len;
    intake.time = state.time;
    intake.span_us = state.span_us;
    intake.span_at = state.span_at;
    intake.before_us = state.before_us;
    intake.before_at = state.before_at;
    // Both are of one slice, the first not below the second.
    (state.word.addr() - range.start.addr()) / size_of::<[u8; 4]>()
}

const _: () = assert!(size_of::<Head>() == 2 && NO_HEAD == 0xffff && SLOTS_MAX < 0x8000);
const _: () = assert!(NEXT_SHIFT == 16 && COLUMN_SHIFT == X_SHIFT);
const _: () = assert!(offset_of!(State, span_us) == 32);

/// An event, or on to 5 with the next word, or on to 7 where that has no segment.
///
/// | r0 | r1 | r2 | r3 | r4 | r5 | r6 | r7 | r8 | r9 |
/// |---|---|---|---|---|---|---|---|---|---|
/// | `X_MASK` | next word | bytes left | slot | len | heads | heads_len | width | stride | span_us |
///
/// lr is the word, r10 its segment, r11 the segment's head, r12 the link. At sp: state, bitmap.
macro_rules! event {
    () => {
        "
        ldr lr, [r1], #4
        and r12, lr, r0
        cmp r12, r7
        bhs 5f
        ubfx r10, lr, #0, #{side_bits}
        lsr r11, r12, #{segment_shift}
        mla r10, r10, r8, r11
        cmp r10, r6
        bhs 7f
        ldrh r11, [r5, r10, lsl #1]
        strh r4, [r5, r10, lsl #1]
        // The column is in the lower half; the sign tells the head of an empty list.
        pkhbt r12, r12, r11, lsl #16
        orrs r12, r12, lr, lsr #{kind_shift}
        ubfx lr, lr, #{low_shift}, #{low_bits}
        add lr, lr, r9
        strd lr, r12, [r3], #8
        add r4, r4, #1
        bpl 4f
        ldr r12, [sp, #4]
        lsr r11, r10, #5
        mov lr, #{first}
        ror lr, lr, r10
        ldr r10, [r12, r11, lsl #2]
        orr r10, r10, lr
        str r10, [r12, r11, lsl #2]
    4:
        "
    };
}

/// Takes the words from `word` to `end`, up to one that [`Intake::take`] does not take, and
/// leaves `word` there.
///
/// Reads those words; writes a slot for an event, from `slot` on; reads and writes heads below
/// `heads_len` and the words of `bitmap` with their bits; reads and writes `state`. Restores
/// every register that a callee must.
///
/// # Safety
/// All of these can be read and written, and no one else does.
#[unsafe(naked)]
unsafe extern "C" fn take_words(state: &mut State) {
    naked_asm!(
        "
        push {{r4-r11, lr}}
        sub sp, #12
        ldr r1, [r0, #{bitmap}]
        strd r0, r1, [sp]
        ldmia r0, {{r1-r9}}
        movw r0, #{x_low}
        movt r0, #{x_high}
        sub r2, r2, r1
        b 6f
    2:
        ",
        event!(), event!(), event!(), event!(), event!(), event!(), event!(), event!(),
        event!(), event!(), event!(), event!(), event!(), event!(), event!(), event!(),
        "
        subs r2, r2, #64
        bhs 2b
        b 8f
    3:
        ",
        event!(),
        "
        subs r2, r2, #4
        bne 3b
        b 9f
    5:  // Perhaps a time. r12: state.
        ldr r12, [sp]
        ldrd r10, r11, [r12, #{time}]
        cmp lr, r10
        blo 7f
        cmp lr, r11
        bhi 7f
        str lr, [r12, #{time}]
        ldrd r10, r11, [r12, #{zero_us}]
        cmp r11, r4
        itt ne
        strdne r9, r11, [r12, #{before_us}]
        strne r4, [r12, #{span_at}]
        add r9, r10, lr, lsl #{low_bits}
        ldr r2, [r12, #{end}]
        sub r2, r2, r1
    6:
        subs r2, r2, #64
        bhs 2b
    8:  // Fewer than sixteen words are left.
        adds r2, r2, #64
        bne 3b
        b 9f
    7:  // Not to be taken.
        sub r1, r1, #4
    9:
        ldr r0, [sp]
        str r1, [r0, #{word}]
        str r4, [r0, #{len}]
        str r9, [r0, #{span_us}]
        add sp, #12
        pop {{r4-r11, pc}}
        ",
        x_low = const X_MASK & 0xffff,
        x_high = const X_MASK >> 16,
        side_bits = const SIDE_BITS,
        segment_shift = const X_SHIFT + COLUMN_BITS,
        first = const FIRST,
        kind_shift = const KIND_SHIFT,
        low_shift = const LOW_SHIFT,
        low_bits = const LOW_BITS,
        word = const offset_of!(State, word),
        end = const offset_of!(State, end),
        len = const offset_of!(State, len),
        span_us = const offset_of!(State, span_us),
        bitmap = const offset_of!(State, bitmap),
        time = const offset_of!(State, time),
        zero_us = const offset_of!(State, zero_us),
        span_at = const offset_of!(State, span_at),
        before_us = const offset_of!(State, before_us),
    );
}
