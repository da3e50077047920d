//! Walk over pixels for the fast coder of [`crate::coder::window_events`], with its state in registers: it sorts
//! segments into columns and writes the codes of [`crate::coder::fast`].
//!
//! The compiler's walk takes nearly twice the instructions, as it has fewer registers than the walk has state, and
//! counts events and checks for room more often than needed. The assembly leaves pixels that it would have to look
//! at twice, unchanged, to the loop in Rust: pixels with events out of order, pixels with a code of over 32 bits,
//! and pixels for which the output has no room.
#![allow(unsafe_code)]

use core::arch::naked_asm;
use core::marker::PhantomData;
use core::mem::offset_of;

use crate::coder::bits_msb_first::BigWriter;
use crate::coder::fast::{END, FLIP, Fast, Gaps, ROOM_WORDS, TERM_PIXELS, TERM_SHIFT};
use crate::group::source::{Source, next_segments};
use crate::group::{Entry, Group};
use crate::window::{
    COLUMN_BITS, COLUMN_SHIFT, FIRST, Head, NEXT_SHIFT, NO_SLOT, SLOTS_MAX, Slot, Window,
};

/// State of the assembly. The first part is copied to its stack, and back.
#[repr(C)]
struct Walk<'w, 'b> {
    /// 31 less each of the four orders, in bytes.
    orders: u32,
    /// [`Gaps::base`] plus 1, above a cell and a polarity.
    base: u32,
    /// Twice a gap of 1, above a cell and a polarity.
    gap_one: u32,
    entries: *mut Entry,
    /// Place of the segment's first column.
    place: u32,
    /// Distance from the place after the last pixel's to `place`.
    since: u32,
    /// The longest gap that fits a code of 32 bits together with the first event.
    gap_max: u32,
    /// Those of 32 segments that are still to be visited.
    segments: u32,
    /// The first of these 32 segments.
    first_segment: u32,
    /// Where slots hold their next slot.
    nexts: *mut u8,
    /// A copy of `entries`, where the assembly loads it with `nexts`.
    entries_again: *mut Entry,
    term_start: u32,
    term_max: u32,
    /// Value of `bits` for order 0.
    bits_zero: u32,
    /// Pixels of terms that have ended.
    pixels: u32,
    /// End of the words in which a pixel may begin.
    limit: *mut [u8; 4],
    heads: *mut Head,
    /// Bits of a cell and a polarity.
    event_bits: u32,
    // From here on, not copied.
    /// The segment's columns not visited yet, the first one highest.
    columns: u32,
    /// Where slots hold their links.
    links: *mut u8,
    /// [`Gaps::bits`], for the leading zeros of the whole code including the event.
    bits: u32,
    /// Pending bits of the next word, and how many bits it has room for.
    pending: u32,
    free: u32,
    /// From the top: pixels of the term (5 bits); the end of a list (bit 15); number of events that are not their
    /// pixel's first.
    counts: u32,
    /// Where the next word is written.
    out: *mut [u8; 4],
    /// Place after the last pixel's; set at the end.
    next: u32,
    source: Source<'w>,
    /// Ties the pointers to the lifetime of what they point to.
    borrowed: PhantomData<&'b mut ()>,
}

/// The end of a list, in [`Walk::counts`].
const EMPTY: u32 = 1 << 15;
/// Shift of the number of pixels, in [`Walk::counts`].
const PIXEL_SHIFT: u32 = 27;
/// Offsets of a slot's link, and of the next slot within it.
const LINK_AT: usize = 4;
const NEXT_AT: usize = 6;
/// 31 in each of four bytes.
const ORDERS: u32 = 0x1f1f_1f1f;

/// Encodes pixels up to the window's last, or up to one that [`Fast::write`] has to encode, which is then the
/// group's next. Returns the number of events encoded.
///
/// Times are coded as the window has them: in cells of a microsecond.
pub fn walk(
    (group, window): (&mut Group, &mut Window<'_>),
    coder: &mut Fast,
    writer: &mut BigWriter<'_>,
) -> u32 {
    // At most 31 where the walk goes on: with more, no gap has a code that is short enough.
    let event_bits = (coder.cell_bits() + 1) & 31;
    let gap_max = coder.gaps.gap_max();
    if gap_max < SEGMENT || !writer.has_words(ROOM_WORDS) {
        return 0;
    }
    let row = coder.row();
    let gaps = coder.gaps;
    let columns = group.columns.reverse_bits();
    let place = if columns == 0 {
        gaps.next
    } else {
        u32::from(group.segment_y) * row + u32::from(group.segment_x)
    };
    let (slots, heads, _) = window.parts();
    let slots_at: *mut u8 = slots.as_mut_ptr().cast();
    let words = writer.words.as_mut_ptr();
    let entries = group.entries.as_mut_ptr();
    let term = TERM_PIXELS - gaps.term_left;
    let mut walk = Walk {
        orders: ORDERS.wrapping_sub(u32::from_le_bytes(coder.orders)),
        base: (gaps.base + 1) << event_bits,
        gap_one: 2 << event_bits,
        entries,
        place,
        since: place.wrapping_sub(gaps.next),
        gap_max,
        segments: group.segments,
        first_segment: group.first_segment,
        nexts: slots_at.wrapping_add(NEXT_AT),
        entries_again: entries,
        term_start: gaps.term_start,
        term_max: gaps.term_max,
        bits_zero: coder.cell_bits() + 63 - 2 * event_bits,
        pixels: 0,
        limit: words.wrapping_add(writer.words.len().saturating_sub(ROOM_WORDS)),
        heads: heads.as_mut_ptr(),
        event_bits,
        columns,
        links: slots_at.wrapping_add(LINK_AT),
        bits: gaps.bits.wrapping_sub(2 * event_bits),
        pending: writer.state.pending,
        free: writer.state.free,
        counts: (term << PIXEL_SHIFT) | EMPTY,
        out: words.wrapping_add(writer.state.words),
        next: 0,
        source: Source { group, window },
        borrowed: PhantomData,
    };
    // SAFETY: the pointers come from exclusive references that outlive the call. `walk_columns` reads and writes
    // heads of segments that are in the window's bitmap, and slots at heads, links and entries: heads and links
    // were made by `Window` of slots that it has filled, and entries by this or by `Group` of those. It reads and
    // writes entries of columns below 32, and it writes words before `limit` and one at it, which exist. This file
    // is compiled only for cores that have the instructions.
    unsafe { walk_columns(&mut walk) };
    // SAFETY: the references from which the pointers were made are not used before this.
    let group = unsafe { &mut *walk.source.group };
    group.segments = walk.segments;
    group.first_segment = walk.first_segment;
    group.columns = walk.columns.reverse_bits();
    if walk.columns != 0 {
        // Never 0; `checked_div` leaves no panic in the code.
        let y = walk.place.checked_div(row).unwrap_or(0);
        (group.segment_x, group.segment_y) = ((walk.place - y * row) as u16, y as u16);
    }
    writer.state.pending = walk.pending;
    writer.state.free = walk.free;
    // Both point into one slice, the first not below the second.
    writer.state.words = (walk.out.addr() - words.addr()) / size_of::<[u8; 4]>();
    coder.orders = ORDERS.wrapping_sub(walk.orders).to_le_bytes();
    let term_now = walk.counts >> PIXEL_SHIFT;
    coder.gaps = Gaps {
        next: walk.next,
        term_start: walk.term_start,
        term_left: TERM_PIXELS - term_now,
        base: (walk.base >> event_bits) - 1,
        bits: walk.bits.wrapping_add(2 * event_bits),
        ..gaps
    };
    let pixels = (walk.pixels + term_now).wrapping_sub(term);
    pixels + (walk.counts & (EMPTY - 1))
}

/// Columns per segment.
const SEGMENT: u32 = 1 << COLUMN_BITS;

// Assumptions of the assembly.
const _: () = assert!(SLOTS_MAX < EMPTY as usize && NO_SLOT >= EMPTY);
const _: () = assert!(size_of::<Slot>() == 8 && NEXT_SHIFT == 16);
const _: () = assert!(size_of::<Entry>() == 8 && offset_of!(Entry, head) == 0);
const _: () =
    assert!(TERM_PIXELS << PIXEL_SHIFT == 0 && END == 2 && FLIP == 3 && EMPTY < 1 << PIXEL_SHIFT);
const _: () = assert!(offset_of!(Walk<'_, '_>, heads) == 64);
const _: () = assert!(offset_of!(Walk<'_, '_>, columns) == 72);
const _: () = assert!(offset_of!(Walk<'_, '_>, out) == 96);

/// Writes a code that completes a word, after its bits were taken off r10. Overwrites the second register.
macro_rules! word {
    ($code:literal, $other:literal) => {
        concat!(
            "rsb ",
            $other,
            ", r10, #0\n",
            "lsr ",
            $other,
            ", ",
            $code,
            ", ",
            $other,
            "\n",
            "orr r9, r9, ",
            $other,
            "\n",
            "rev r9, r9\n",
            "str r9, [r12], #4\n",
            "add r10, r10, #32\n",
            "lsl r9, ",
            $code,
            ", r10"
        )
    };
}

/// Raises the distance in r2, by the order of `$polarities`; `$highest` is a register with only its highest bit
/// set. Leaves the number's leading zeros in `$other`, and in r1 31 less the order, less twice these zeros: the
/// bits of the code, less 32.
macro_rules! raise {
    ($polarities:literal, $other:literal, $highest:literal) => {
        concat!(
            "ldrb r1, [sp, ",
            $polarities,
            "]\n",
            "lsr ",
            $other,
            ", ",
            $highest,
            ", r1\n",
            "add r2, r2, ",
            $other,
            "\n",
            "clz ",
            $other,
            ", r2\n",
            "sub r1, r1, ",
            $other,
            ", lsl #1"
        )
    };
}

/// Stores the order that follows from the leading zeros that [`raise`] leaves in `$other`.
macro_rules! learn {
    ($polarities:literal, $other:literal) => {
        concat!(
            "add ",
            $other,
            ", ",
            $other,
            ", #1\n",
            "usat ",
            $other,
            ", #5, ",
            $other,
            "\n",
            "strb ",
            $other,
            ", [sp, ",
            $polarities,
            "]"
        )
    };
}

/// Branches to `$to` if there is no room for another pixel. Overwrites the register.
macro_rules! room {
    ($other:literal, $to:literal) => {
        concat!(
            "ldr ",
            $other,
            ", [sp, #92]\ncmp r12, ",
            $other,
            "\nbhs ",
            $to
        )
    };
}

/// Loop over events of the same polarity as the one before, both being `$polarities`. Branches to `$flip` at one of
/// the other polarity.
macro_rules! further {
    ($loop:literal, $polarities:literal, $flips:literal, $flip:literal, $then:literal, $word:literal) => {
        concat!(
            $loop,
            ":\n",
            "add r7, r6, r0, lsl #3\n",
            "ldrd r0, r7, [r7, #-4]\n",
            "subs r2, r0, r4\n",
            "blo 50f\n",
            "mov r4, r0\n",
            "asrs r7, r7, #1\n",
            $flips,
            " ",
            $flip,
            "f\n",
            raise!($polarities, "r0", "lr"),
            "\n",
            learn!($polarities, "r0"),
            "\n",
            "add r11, r11, #1\n",
            "sub r10, r10, r1\n",
            $then,
            ":\n",
            "asrs r0, r7, #15\n",
            "bmi 26f\n",
            "subs r10, r10, #33\n",
            "ble ",
            $word,
            "f\n",
            "lsl r1, r2, r10\n",
            "orr r9, r9, r1\n",
            "b ",
            $loop,
            "b\n",
            $word,
            ":\n",
            "cmn r1, #4\n",
            "bgt 50f\n",
            word!("r2", "r1"),
            "\n",
            room!("r1", "50f"),
            "\n",
            "b ",
            $loop,
            "b"
        )
    };
}

/// Puts the code for the other polarity in front of an event, and goes on in the loop of that polarity.
macro_rules! flip {
    ($flip:literal, $polarities:literal, $then:literal) => {
        concat!(
            $flip,
            ":\n",
            raise!($polarities, "r0", "lr"),
            "\n",
            learn!($polarities, "r0"),
            "\n",
            "add r11, r11, #1\n",
            "sub r10, r10, r1\n",
            "cmn r1, #4\n",
            "bgt 50f\n",
            "adds r1, #32\n",
            "movs r0, #{flip}\n",
            "lsls r0, r1\n",
            "orrs r2, r0\n",
            // Checked already: lets the check at `$then` pass.
            "mvn r1, #15\n",
            "subs r10, r10, #1\n",
            "b ",
            $then
        )
    };
}

/// Goes on with the next pixel.
macro_rules! next {
    () => {
        "adds r11, r11, #{pixel}
        bcs 30f
        lsls r4, r4, #1
        bne 1b
        b 6b"
    };
}

/// Encodes pixels as described at [`walk`].
///
/// # Safety
/// The pointers in `walk` have to be valid as stated where [`walk`] calls this.
#[unsafe(naked)]
unsafe extern "C" fn walk_columns(walk: &mut Walk<'_, '_>) {
    naked_asm!(
        // | r4 | r5 | r6 | r7 | r8 | r9 | r10 | r11 | r12 | lr |
        // |---|---|---|---|---|---|---|---|---|---|
        // | columns from r7's on, the first one highest | base | links | next entry | bits | pending |
        // free | counts | out | gap_one |
        //
        // At sp: 0 orders; 4 to 24 orders, r0 and r9 to r12 as they were before a pixel of several events; 28 its
        // r4 and r7; 36 `walk` from `base` to `event_bits`; 104 the address of `walk`.
        "push {{r4-r11, lr}}",
        "sub sp, #108",
        "str r0, [sp, #104]",
        "ldr r1, [r0], #4",
        "str r1, [sp]",
        "add lr, sp, #36",
        "ldm r0!, {{r1-r8}}",
        "stm lr!, {{r1-r8}}",
        "ldm r0!, {{r1-r9}}",
        "stm lr!, {{r1-r9}}",
        "ldm r0, {{r4, r6, r8, r9, r10, r11, r12}}",
        "ldr r7, [sp, #44]",
        "ldrd r5, lr, [sp, #36]",
        "cmp r4, #0",
        "bne 13f",
        "b 6f",
        // The next pixel of a segment. r0: gap, and at the end the code.
        "1:",
        "clz r0, r4",
        "lsls r4, r0",
        "add r7, r7, r0, lsl #3",
        "4:",
        "ldr r1, [r7], #8",
        "mla r0, r0, lr, r5",
        "add r1, r6, r1, lsl #3",
        // r2: cell; r3: link.
        "ldrd r2, r3, [r1, #-4]",
        // The carry is the polarity; the sign marks the end of the list.
        "asrs r3, r3, #1",
        "bpl 20f",
        "adc r2, r2, r2",
        "orrs r0, r2",
        "clz r1, r0",
        // Empty the entry.
        "str r11, [r7, #-8]",
        "add r10, r10, r1, lsl #1",
        "subs r10, r10, r8",
        "ble 2f",
        "lsl r1, r0, r10",
        "orr r9, r9, r1",
        "adds r11, r11, #{pixel}",
        "bcs 30f",
        "lsls r4, r4, #1",
        "bne 1b",
        // The next segment. r7: the place after the last pixel's.
        "6:",
        "ldrd r0, r1, [sp, #44]",
        "subs r7, r7, r0",
        "add r7, r1, r7, lsr #3",
        "ldrd r1, r2, [sp, #60]",
        "15:",
        "mov lr, #{first}",
        "clz r3, r1",
        "adds r2, r2, r3",
        "lsrs r3, lr, r3",
        "beq 14f",
        "eors r1, r3",
        "str r1, [sp, #60]",
        "ldr r0, [sp, #96]",
        "ldrh r3, [r0, r2, lsl #1]",
        "strh r11, [r0, r2, lsl #1]",
        "lsls r2, r2, #{column_bits}",
        "subs r0, r2, r7",
        "strd r2, r0, [sp, #48]",
        "ldrd r5, r7, [sp, #68]",
        "movs r4, #0",
        // Split its list, newest first, into the columns' lists, oldest first. r3: slot; r1: its link.
        "3:",
        "ldr r1, [r6, r3, lsl #3]",
        "ubfx r0, r1, #{column_at}, #{column_bits}",
        "ldr r2, [r7, r0, lsl #3]",
        "str r3, [r7, r0, lsl #3]",
        "lsr r0, lr, r0",
        "orrs r4, r0",
        "strh r2, [r5, r3, lsl #3]",
        "asrs r3, r1, #16",
        "bpl 3b",
        "ldrd r5, lr, [sp, #36]",
        // The first pixel of a segment.
        "13:",
        "ldrd r1, r2, [sp, #52]",
        "clz r0, r4",
        "lsls r4, r0",
        "add r7, r7, r0, lsl #3",
        "adds r0, r0, r1",
        "cmp r0, r2",
        "bls 4b",
        // A long gap. All of its code but the zeros in front has to fit a word. r2: raised gap.
        "ldr r1, [sp, #100]",
        "lsr r2, r5, r1",
        "add r2, r0, r2, lsr #1",
        "mov r3, #{first}",
        "lsrs r3, r1",
        "cmp r2, r3, lsr #1",
        "bhs 51f",
        "mla r2, r0, lr, r5",
        "clz r1, r2",
        // r1: zeros. If they complete no word, the code is like any other.
        "subs r1, r8, r1",
        "subs r1, #32",
        "cmp r1, r10",
        "blt 4b",
        "ldr r1, [r7]",
        "ldr r1, [r6, r1, lsl #3]",
        "cmp r1, #0",
        "bpl 51f",
        // The word of these zeros may be the last that there is room for.
        "ldr r1, [sp, #92]",
        "add r2, r12, #4",
        "cmp r2, r1",
        "bhs 51f",
        "rev r9, r9",
        "str r9, [r12], #4",
        "movs r9, #0",
        "add r10, r10, #32",
        "b 4b",
        // A single event's code completes a word: the bits that the word has no room for begin the next.
        "2:",
        word!("r0", "r1"),
        room!("r0", "12f"),
        next!(),
        // Two events. r3: from the top, next slot and 15 bits.
        "20:",
        "asr r1, r3, #15",
        "adc r3, r2, r2",
        "add r1, r6, r1, lsl #3",
        // r1: the second event's cell; lr: its link; r2: distance.
        "ldrd r1, lr, [r1, #-4]",
        "subs r2, r1, r2",
        "blo 55f",
        "asrs lr, lr, #1",
        "bpl 60f",
        "orr r0, r0, r3",
        "adc r0, r0, r0",
        "and lr, r0, #3",
        "mov r3, #{first}",
        raise!("lr", "r3", "r3"),
        "cmn r1, #2",
        "bgt 56f",
        learn!("lr", "r3"),
        // The pixel has more than a single event.
        "ldr lr, [sp, #40]",
        "sub r0, r0, lr",
        "clz r3, r0",
        "add r10, r10, r3, lsl #1",
        "sub r10, r10, r8",
        "adds r10, r10, #1",
        "ble 61f",
        "lsl r3, r0, r10",
        "orr r9, r9, r3",
        "62:",
        "lsls r2, r2, #2",
        "adds r2, #{end}",
        "sub r10, r10, r1",
        "subs r10, r10, #34",
        "ble 63f",
        "lsl r1, r2, r10",
        "orr r9, r9, r1",
        "add r11, r11, #1",
        "str r11, [r7, #-8]",
        next!(),
        "63:",
        word!("r2", "r1"),
        "add r11, r11, #1",
        "str r11, [r7, #-8]",
        room!("r0", "12f"),
        next!(),
        // Room for another pixel is checked once: there always is room for two more words.
        "61:",
        word!("r0", "r3"),
        "lsls r2, r2, #2",
        "adds r2, #{end}",
        "sub r10, r10, r1",
        "subs r10, r10, #34",
        "ble 63b",
        "lsl r1, r2, r10",
        "orr r9, r9, r1",
        "add r11, r11, #1",
        "str r11, [r7, #-8]",
        room!("r0", "12f"),
        next!(),
        // Three or more events. r4: cell of the last one; r7: its link.
        "60:",
        "adc r3, r3, r3",
        "strd r4, r7, [sp, #28]",
        "ldr r4, [sp]",
        "strd r4, r0, [sp, #4]",
        "strd r9, r10, [sp, #12]",
        "strd r11, r12, [sp, #20]",
        "mov r4, r1",
        "mov r7, lr",
        "ldr lr, [sp, #40]",
        "subs r1, r3, lr",
        "add r0, r1, r0, lsl #1",
        "clz r1, r0",
        "add r10, r10, r1, lsl #1",
        "sub r10, r10, r8",
        "adds r10, r10, #1",
        "ble 21f",
        "lsl r1, r0, r10",
        "orr r9, r9, r1",
        "22:",
        "and r3, r3, #3",
        "mov lr, #{first}",
        raise!("r3", "r0", "lr"),
        learn!("r3", "r0"),
        "add r11, r11, #1",
        "sub r10, r10, r1",
        "asr r0, r7, #15",
        "subs r10, r10, #32",
        "ble 23f",
        "lsl r1, r2, r10",
        "orr r9, r9, r1",
        "25:",
        "lsls r3, r3, #31",
        "bmi 34f",
        // Further events, after one that is OFF and after one that is ON. r0: slot.
        further!("24", "#0", "bcs", "27", "28", "29"),
        further!("34", "#3", "bcc", "37", "38", "39"),
        flip!("27", "#1", "38b"),
        flip!("37", "#2", "28b"),
        "23:",
        "cmn r1, #4",
        "bgt 50f",
        word!("r2", "r1"),
        room!("r1", "50f"),
        "b 25b",
        // The last event of the pixel.
        "26:",
        "lsls r2, r2, #2",
        "adds r2, #{end}",
        "subs r10, r10, #35",
        "ble 67f",
        "lsl r1, r2, r10",
        "orr r9, r9, r1",
        "ldrd r4, r7, [sp, #28]",
        "ldr lr, [sp, #40]",
        "str r11, [r7, #-8]",
        next!(),
        "67:",
        "cmn r1, #4",
        "bgt 50f",
        word!("r2", "r1"),
        room!("r1", "50f"),
        "ldrd r4, r7, [sp, #28]",
        "ldr lr, [sp, #40]",
        "str r11, [r7, #-8]",
        next!(),
        "21:",
        word!("r0", "r1"),
        room!("r1", "50f"),
        "b 22b",
        // A term ends: choose the gaps' order anew. r0: places spanned; r7: next entry.
        "30:",
        "ldrd r0, r1, [sp, #44]",
        "subs r0, r7, r0",
        "add r0, r1, r0, lsr #3",
        "ldrd r1, r2, [sp, #76]",
        "str r0, [sp, #76]",
        "subs r0, r0, r1",
        "cmp r0, r2",
        "it hi",
        "movhi r0, r2",
        "clz r0, r0",
        "rsb r0, r0, #{order_max}",
        "usat r0, #5, r0",
        "ldrd r1, r2, [sp, #84]",
        "adds r2, #{term}",
        "str r2, [sp, #88]",
        "subs r1, r1, r0",
        "cmp r1, r8",
        "beq 32f",
        "mov r8, r1",
        "ldr r3, [sp, #100]",
        "movs r5, #2",
        "lsls r5, r0",
        // r1: fewest leading zeros of a place; r2: longest gap.
        "sub r1, r8, #30",
        "add r1, r3, r1, asr #1",
        "usat r1, #5, r1",
        "mov r2, #{first}",
        "lsrs r2, r1",
        "sub r2, r2, r5, lsr #1",
        "subs r2, #1",
        "str r2, [sp, #56]",
        "adds r5, #1",
        "lsls r5, r3",
        "str r5, [sp, #36]",
        "cmp r2, #{segment}",
        "blt 33f",
        "32:",
        room!("r0", "33f"),
        "lsls r4, r4, #1",
        "bne 1b",
        "b 6b",
        // No room for another pixel.
        "12:",
        "adds r11, r11, #{pixel}",
        "bcs 30b",
        "33:",
        "lsls r4, r4, #1",
        "movs r0, #0",
        "b 51f",
        // The next 32 segments.
        "14:",
        "str r12, [sp, #4]",
        "ldr r0, [sp, #104]",
        "adds r0, #{source}",
        "add r1, sp, #64",
        "bl {next_segments}",
        "ldr r12, [sp, #4]",
        "ldr r2, [sp, #64]",
        "movs r1, r0",
        "bne 15b",
        "str r1, [sp, #60]",
        "movs r4, #0",
        "b 52f",
        // Restore the state before the pixel.
        "50:",
        "ldrd r4, r0, [sp, #4]",
        "str r4, [sp]",
        "ldrd r9, r10, [sp, #12]",
        "ldrd r11, r12, [sp, #20]",
        "ldrd r4, r7, [sp, #28]",
        "b 55f",
        // As 55, after r0 has been doubled.
        "56:",
        "lsrs r0, r0, #1",
        // Nothing of the pixel has been written.
        "55:",
        "subs r7, #8",
        "ldr r1, [sp, #100]",
        "subs r0, r0, r5",
        "lsrs r0, r1",
        "lsrs r0, r0, #1",
        // r0: gap before the pixel of the entry r7.
        "51:",
        "ldrd r1, r2, [sp, #44]",
        "subs r7, r7, r1",
        "lsrs r7, r7, #3",
        "lsrs r4, r7",
        "add r7, r7, r2",
        "subs r7, r7, r0",
        // r7: the place after the last pixel's.
        "52:",
        "ldr r0, [sp, #104]",
        "add r1, r0, #{columns}",
        "stm r1, {{r4, r6, r8, r9, r10, r11, r12}}",
        "str r7, [r0, #{next}]",
        "ldr r1, [sp]",
        "str r1, [r0], #4",
        "add lr, sp, #36",
        "ldm lr!, {{r1-r8}}",
        "stm r0!, {{r1-r8}}",
        "ldm lr!, {{r1-r8}}",
        "stm r0!, {{r1-r8}}",
        "add sp, #108",
        "pop {{r4-r11, pc}}",
        next_segments = sym next_segments,
        source = const offset_of!(Walk<'_, '_>, source),
        first = const FIRST,
        pixel = const 1 << PIXEL_SHIFT,
        end = const END,
        flip = const FLIP,
        term = const TERM_PIXELS,
        order_max = const 31 - TERM_SHIFT,
        segment = const SEGMENT,
        column_at = const COLUMN_SHIFT,
        column_bits = const COLUMN_BITS,
        columns = const offset_of!(Walk<'_, '_>, columns),
        next = const offset_of!(Walk<'_, '_>, next),
    )
}
