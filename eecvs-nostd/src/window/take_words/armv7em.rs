//! In assembly, for cores with Arm's DSP instructions.
//!
//! An event needs 14 registers. A compiler has only 13 and uses them less well: this loop takes two thirds of its
//! instructions. `firmware/src/bin/golden.rs` compares the resulting frames on the microcontroller with those of
//! events pushed one by one.

use core::arch::naked_asm;
use core::mem::offset_of;

use super::Intake;
use crate::window::{COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, NEXT_SHIFT, NO_HEAD, SLOTS_MAX, Slot};
use event_types::evt2::{KIND_SHIFT, LOW_BITS, LOW_SHIFT, NO_EVENT, SIDE_BITS, SIDE_MASK, X_SHIFT};

/// The bits of x in a word, and those that are never set in an event.
const X_MASK: u32 = NO_EVENT | (SIDE_MASK << X_SHIFT);

/// The arguments and results of [`take_words`] and [`take_words_in_order`].
#[repr(C)]
struct State {
    // Loaded into r1 to r9.
    word: *const [u8; 4],
    end: *const [u8; 4],
    slot: *mut Slot,
    len: u32,
    heads: *mut Head,
    /// Number of heads, or in the order of arrival the sensor's height.
    limit: u32,
    width: u32,
    stride: u32,
    span_us: u32,
    // Left in memory.
    bitmap: *mut u32,
    time: u32,
    time_last: u32,
    /// Offset of `TIME_HIGH` 0 from the window's start; wraps.
    zero_us: u32,
    span_at: u32,
    before_us: u32,
    before_at: u32,
}

/// Implements [`Intake::take`].
pub fn take(intake: &mut Intake<'_>, words: &[[u8; 4]]) -> usize {
    let heads = intake.heads.len().min(32 * intake.bitmap.len()) as u32;
    // SAFETY: words and slots are as `with_state` says; `intake` has this many heads on loan, and one bit of the bitmap
    // for each.
    with_state(intake, words, heads, |state| unsafe { take_words(state) })
}

/// Implements [`Intake::take_in_order`].
pub fn take_in_order(intake: &mut Intake<'_>, height: u16, words: &[[u8; 4]]) -> usize {
    // SAFETY: words and slots are as `with_state` says; neither heads nor the bitmap are used.
    with_state(intake, words, height.into(), |state| unsafe {
        take_words_in_order(state);
    })
}

/// Has `run` take words: those from `word` to `end` are some of `words`. From `slot` on there are at least as many
/// slots as words, which `intake` has on loan. Returns how many it took.
#[inline(always)]
fn with_state(
    intake: &mut Intake<'_>,
    words: &[[u8; 4]],
    limit: u32,
    run: impl FnOnce(&mut State),
) -> usize {
    let free = intake.slots.get_mut(intake.len as usize..);
    let free = free.unwrap_or_default();
    // Each word takes at most one slot.
    let some = words.get(..free.len()).unwrap_or(words);
    let range = some.as_ptr_range();
    let mut state = State {
        word: range.start,
        end: range.end,
        slot: free.as_mut_ptr(),
        len: intake.len,
        heads: intake.heads.as_mut_ptr(),
        limit,
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
    run(&mut state);
    intake.len = state.len;
    intake.time = state.time;
    intake.span_us = state.span_us;
    intake.span_at = state.span_at;
    intake.before_us = state.before_us;
    intake.before_at = state.before_at;
    // Both addresses lie in one slice, the first not below the second.
    (state.word.addr() - range.start.addr()) / size_of::<[u8; 4]>()
}

const _: () = assert!(size_of::<Head>() == 2 && NO_HEAD == 0xffff && SLOTS_MAX < 0x8000);
const _: () = assert!(NEXT_SHIFT == 16 && COLUMN_SHIFT == X_SHIFT);
const _: () = assert!(offset_of!(State, span_us) == 32);

/// Stores the next word's event. Jumps to 5 if the word is no event or its x is off the sensor, to 7 if no segment
/// holds it.
///
/// | r0 | r1 | r2 | r3 | r4 | r5 | r6 | r7 | r8 | r9 |
/// |---|---|---|---|---|---|---|---|---|---|
/// | `X_MASK` | next word | bytes left | slot | len | heads | limit | width | stride | span_us |
///
/// lr holds the word, r10 its segment, r11 the segment's head, r12 the link. The stack holds `state` and `bitmap`.
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

/// As [`event`], in the order of arrival: neither heads nor stride are used, and r10 holds y. Jumps to 7 if y is off the
/// sensor.
macro_rules! event_in_order {
    () => {
        "
        ldr lr, [r1], #4
        and r12, lr, r0
        cmp r12, r7
        bhs 5f
        ubfx r10, lr, #0, #{side_bits}
        cmp r10, r6
        bhs 7f
        lsr r12, r12, #{place_shift}
        orr r12, r12, lr, lsr #{kind_shift}
        orr r12, r12, r10, lsl #16
        ubfx lr, lr, #{low_shift}, #{low_bits}
        add lr, lr, r9
        strd lr, r12, [r3], #8
        add r4, r4, #1
        "
    };
}

/// The function around `$event`, whose own constants follow.
macro_rules! take_words {
    ($event:ident, $($constant:tt)*) => {
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
            $event!(), $event!(), $event!(), $event!(), $event!(), $event!(), $event!(), $event!(),
            $event!(), $event!(), $event!(), $event!(), $event!(), $event!(), $event!(), $event!(),
            "
            subs r2, r2, #64
            bhs 2b
            b 8f
        3:
            ",
            $event!(),
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
            $($constant)*
        )
    };
}

/// Takes the words from `word` to `end`, up to the first one that [`Intake::take`] does not take, and leaves `word`
/// pointing to it.
///
/// Reads those words. Writes one slot per event, from `slot` on. Reads and writes heads below `limit`, the words of
/// `bitmap` that hold their bits, and `state`. Restores every register that a callee must.
///
/// # Safety
/// All of this memory must be valid for these reads and writes, and nothing else may access it meanwhile.
#[unsafe(naked)]
unsafe extern "C" fn take_words(state: &mut State) {
    take_words!(
        event,
        segment_shift = const X_SHIFT + COLUMN_BITS,
        first = const FIRST,
    );
}

/// As [`take_words`], up to the first word that [`Intake::take_in_order`] does not take; there are no heads and no
/// bitmap.
///
/// # Safety
/// As for [`take_words`].
#[unsafe(naked)]
unsafe extern "C" fn take_words_in_order(state: &mut State) {
    take_words!(event_in_order, place_shift = const X_SHIFT - 1,);
}
