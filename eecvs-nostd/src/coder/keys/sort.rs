//! The encoder's sort stage: a slice's events, in order of time, to words in order of place, those of a place in
//! order of time still.
//!
//! Digits are counted in the order of events, which gives each its rank among those of its digit; sums of counts
//! are then where each digit begins. So no address of a store depends on a load after a store.

use crate::coder::keys::SLICE_EVENTS;
use crate::coder::keys::kernels::{Kernels, ON, PLACE, Pairs, Words};
use crate::coder::quick::Placed;
use event_types::Sensor;
use zerocopy::FromZeros;

/// Most places that are sorted in one pass.
const PLACES: usize = 1 << 17;
/// A pass more costs as much as counts of this many places an event.
const PLACES_PER_EVENT: usize = 12;
/// Digits of either of two passes.
const DIGITS: usize = 1 << 11;

/// Memory of the sort stage.
#[derive(Debug, FromZeros)]
pub struct Sorter {
    /// The sorted words, and then the differences of their keys.
    pub words: Words,
    other: Words,
    ranks: [u16; SLICE_EVENTS],
    counts: [u16; PLACES],
    /// Mantissas of the sorted words.
    pub pairs: Pairs,
}

impl Sorter {
    /// Sorts up to [`SLICE_EVENTS`] events into `self.words`; `unit` is the unit of a time, from the slice's first.
    /// Returns whether all are on the sensor.
    #[inline(always)]
    pub fn sort<K: Kernels>(
        &mut self,
        kernels: K,
        events: &[Placed],
        sensor: Sensor,
        unit: impl Fn(u32) -> u32,
    ) -> bool {
        let events = &events[..events.len().min(SLICE_EVENTS)];
        let n = events.len();
        let places = sensor.pixels();
        let width = u32::from(sensor.width);
        let (last_x, last_y) = (width - 1, u32::from(sensor.height) - 1);
        let mut beyond = 0;
        let word = |[offset_us, place]: Placed| {
            let (x, y) = (place >> 1 & 0x7FFF, place >> 16);
            beyond |= last_x.wrapping_sub(x) | last_y.wrapping_sub(y);
            u64::from(y * width + x) << PLACE
                | u64::from(place & 1) << ON
                | u64::from(unit(offset_us))
        };
        let Self {
            words,
            other,
            ranks,
            counts,
            ..
        } = self;
        if places as usize <= PLACES.min(n * PLACES_PER_EVENT) {
            let buckets = (places as usize).next_multiple_of(16).min(PLACES);
            counts[..buckets].fill(0);
            let digit = |word: u64| (word >> PLACE) as usize;
            read(events, other, ranks, word, counts, digit);
            kernels.sums(&mut counts[..buckets]);
            scatter(&other[..n], ranks, words, counts, digit);
            return beyond >> 31 == 0;
        }
        let low_bits = (u32::BITS - (places - 1).leading_zeros()) / 2;
        let low_mask = (1 << low_bits) - 1;
        let high_shift = PLACE + low_bits;
        let (low, high) = counts.split_at_mut(DIGITS);
        let (Some(low), Some(high)) = (low.first_chunk_mut(), high.first_chunk_mut()) else {
            return false;
        };
        let (low, high): (&mut [u16; DIGITS], &mut [u16; DIGITS]) = (low, high);
        let highs = ((places >> low_bits) as usize + 1).next_multiple_of(16);
        let highs = highs.min(DIGITS);
        let lows = (1_usize << low_bits).next_multiple_of(16);
        low[..lows].fill(0);
        high[..highs].fill(0);
        let low_of = |word: u64| (word >> PLACE) as usize & low_mask;
        let high_of = |word: u64| (word >> high_shift) as usize;
        read(events, words, ranks, word, low, low_of);
        kernels.sums(&mut low[..lows]);
        scatter(&words[..n], ranks, other, low, low_of);
        rank(&other[..n], ranks, high, high_of);
        kernels.sums(&mut high[..highs]);
        scatter(&other[..n], ranks, words, high, high_of);
        beyond >> 31 == 0
    }
}

/// Makes words of events, and ranks them.
#[inline(always)]
fn read<const N: usize>(
    events: &[Placed],
    words: &mut Words,
    ranks: &mut [u16; SLICE_EVENTS],
    mut word: impl FnMut(Placed) -> u64,
    counts: &mut [u16; N],
    digit: impl Fn(u64) -> usize,
) {
    let mut one = |event: &Placed, out: &mut u64, rank: &mut u16| {
        *out = word(*event);
        let count = &mut counts[digit(*out) % N];
        *rank = *count;
        *count = count.wrapping_add(1);
    };
    let (fours, rest) = events.as_chunks::<4>();
    let outs = words
        .as_chunks_mut::<4>()
        .0
        .iter_mut()
        .zip(ranks.as_chunks_mut::<4>().0);
    for (events, (words, ranks)) in fours.iter().zip(outs) {
        for i in 0..4 {
            one(&events[i], &mut words[i], &mut ranks[i]);
        }
    }
    let done = events.len() - rest.len();
    for ((event, word), rank) in rest.iter().zip(&mut words[done..]).zip(&mut ranks[done..]) {
        one(event, word, rank);
    }
}

/// Ranks each word among those of its digit.
#[inline(always)]
pub fn rank<const N: usize>(
    words: &[u64],
    ranks: &mut [u16; SLICE_EVENTS],
    counts: &mut [u16; N],
    digit: impl Fn(u64) -> usize,
) {
    let mut one = |word: u64, rank: &mut u16| {
        let count = &mut counts[digit(word) % N];
        *rank = *count;
        *count = count.wrapping_add(1);
    };
    let (fours, rest) = words.as_chunks::<4>();
    for (words, ranks) in fours.iter().zip(ranks.as_chunks_mut::<4>().0) {
        for i in 0..4 {
            one(words[i], &mut ranks[i]);
        }
    }
    let done = words.len() - rest.len();
    for (word, rank) in rest.iter().zip(&mut ranks[done..]) {
        one(*word, rank);
    }
}

/// Puts each word where its digit begins plus its rank.
#[inline(always)]
pub fn scatter<const N: usize>(
    words: &[u64],
    ranks: &[u16; SLICE_EVENTS],
    out: &mut Words,
    starts: &[u16; N],
    digit: impl Fn(u64) -> usize,
) {
    let mut one = |word: u64, rank: u16| {
        let at = usize::from(starts[digit(word) % N]) + usize::from(rank);
        out[at % SLICE_EVENTS] = word;
    };
    let (fours, rest) = words.as_chunks::<4>();
    for (words, ranks) in fours.iter().zip(ranks.as_chunks::<4>().0) {
        for i in 0..4 {
            one(words[i], ranks[i]);
        }
    }
    let done = words.len() - rest.len();
    for (word, rank) in rest.iter().zip(&ranks[done..]) {
        one(*word, *rank);
    }
}

/// Events that are sorted by insertion.
const RUN: usize = 16;

/// Sorts events by time, in place; those of equal time keep their order. Takes O(n) where they are in order already,
/// O(n log^2 n) at most.
pub fn sort_by_time(events: &mut [Placed]) {
    if events.is_sorted_by_key(|[offset_us, _]| *offset_us) {
        return;
    }
    for run in events.chunks_mut(RUN) {
        for i in 1..run.len() {
            let at = run[..i].partition_point(|[offset_us, _]| *offset_us <= run[i][0]);
            run[at..=i].rotate_right(1);
        }
    }
    let mut size = RUN;
    while size < events.len() {
        for two in events.chunks_mut(2 * size) {
            merge(two, size);
        }
        size *= 2;
    }
}

/// Merges the sorted events before `middle` with the sorted ones from there on.
fn merge(events: &mut [Placed], middle: usize) {
    let (mut events, mut middle) = (events, middle);
    loop {
        let Some((before, after)) = events.split_at_checked(middle) else {
            return;
        };
        let (Some(last), Some(first)) = (before.last(), after.first()) else {
            return;
        };
        if last[0] <= first[0] {
            return;
        }
        // What is in its place already, at either end.
        let start = before.partition_point(|event| event[0] <= first[0]);
        let end = middle + after.partition_point(|event| event[0] < last[0]);
        events = &mut events[start..end];
        middle -= start;
        // The middle of the longer side divides the other one.
        let (before, after) = events.split_at(middle);
        let (cut_before, cut_after) = if before.len() >= after.len() {
            let cut = before.len() / 2;
            (
                cut,
                after.partition_point(|event| event[0] < before[cut][0]),
            )
        } else {
            let cut = after.len().div_ceil(2);
            let time = after[cut - 1][0];
            (before.partition_point(|event| event[0] <= time), cut)
        };
        events[cut_before..middle + cut_after].rotate_left(middle - cut_before);
        let (low, high) = events.split_at_mut(cut_before + cut_after);
        // Recursion takes the shorter part, so that its depth is at most log2 of the number of events.
        if low.len() <= high.len() {
            merge(low, cut_before);
            (events, middle) = (high, middle - cut_before);
        } else {
            merge(high, middle - cut_before);
            (events, middle) = (low, cut_before);
        }
    }
}
