//! A window's events in order of time.

use eecvs_nostd::{Event, Header, Polarity};

/// Fewer events are sorted by comparing them.
const COUNTED_MIN: usize = 64;
/// Bits of a time that are sorted by in one pass alone, whose counters then stay in the first cache.
const ONE_PASS_BITS: u32 = 12;
/// Bits that are sorted by in one of several passes.
const DIGIT_BITS: u32 = 8;
const PLACES: usize = 1 << DIGIT_BITS;
/// Bits of a key below the time's offset, for row, column and polarity.
const PIXEL_BITS: u32 = 33;
/// Bits of a key's offset.
const OFFSET_BITS: u32 = u64::BITS - PIXEL_BITS;

/// Sorts events of windows by time; those of equal times stay in their order, which is the raster's
/// where they come from frames.
///
/// By counting, in one pass where the window is short, else in a pass for each byte of the offset, the
/// lowest first, with an event in 64 bits in between. Memory for these is kept from window to window.
#[derive(Debug, Default)]
pub struct ByTime {
    keys: Vec<u64>,
    spare: Vec<u64>,
}

/// [`ByTime::sort`] of one window.
#[must_use]
pub fn by_time(header: &Header, events: &[Event]) -> Vec<Event> {
    let mut sorted = events.to_vec();
    ByTime::default().sort(header, &mut sorted);
    sorted
}

impl ByTime {
    /// Sorts a window's events.
    pub fn sort(&mut self, header: &Header, events: &mut [Event]) {
        // Of the largest offset.
        let bits = u32::BITS - header.duration_us.saturating_sub(1).leading_zeros();
        let is_countable = bits <= OFFSET_BITS && u32::try_from(events.len()).is_ok();
        let t0_us = header.t0_us;
        if events.len() < COUNTED_MIN || !is_countable {
            events.sort_by_key(|event| event.t_us);
        } else if bits <= ONE_PASS_BITS && events.len() >> bits.saturating_sub(2) > 0 {
            self.one_pass(t0_us, bits, events);
        } else if bits <= 2 * DIGIT_BITS {
            self.passes::<2>(t0_us, bits, events);
        } else if bits <= 3 * DIGIT_BITS {
            self.passes::<3>(t0_us, bits, events);
        } else {
            self.passes::<4>(t0_us, bits, events);
        }
    }

    /// To keys as they are, and from these to their places.
    fn one_pass(&mut self, t0_us: u64, bits: u32, events: &mut [Event]) {
        let mut places = [0; 1 << ONE_PASS_BITS];
        let places = &mut places[..1 << bits];
        let last = places.len() - 1;
        self.keys.clear();
        self.keys.extend(events.iter().map(|event| {
            let offset_us = event.t_us.wrapping_sub(t0_us);
            places[offset_us as usize & last] += 1;
            key(offset_us, event)
        }));
        begins(places);
        for key in &self.keys {
            let place = &mut places[(key >> PIXEL_BITS) as usize & last];
            events[*place as usize] = event(t0_us, *key);
            *place += 1;
        }
    }

    /// From events to keys, from these to others, and back.
    fn passes<const DIGITS: usize>(&mut self, t0_us: u64, bits: u32, events: &mut [Event]) {
        let digit_bits = bits.div_ceil(DIGITS as u32);
        let digit = |offset_us: u64, digit: usize| {
            let above = offset_us >> (digit as u32 * digit_bits);
            above as usize & ((1 << digit_bits) - 1) & (PLACES - 1)
        };
        let mut places = [[0; PLACES]; DIGITS];
        for event in &*events {
            let offset_us = event.t_us.wrapping_sub(t0_us);
            for (at, places) in places.iter_mut().enumerate() {
                places[digit(offset_us, at)] += 1;
            }
        }
        for places in &mut places {
            begins(places);
        }
        let [first, middle @ .., last] = &mut places[..] else {
            return;
        };
        self.keys.resize(events.len(), 0);
        for event in &*events {
            let offset_us = event.t_us.wrapping_sub(t0_us);
            let place = &mut first[digit(offset_us, 0)];
            self.keys[*place as usize] = key(offset_us, event);
            *place += 1;
        }
        for (places, at) in middle.iter_mut().zip(1..) {
            self.spare.resize(events.len(), 0);
            for key in &self.keys {
                let place = &mut places[digit(key >> PIXEL_BITS, at)];
                self.spare[*place as usize] = *key;
                *place += 1;
            }
            std::mem::swap(&mut self.keys, &mut self.spare);
        }
        for key in &self.keys {
            let place = &mut last[digit(key >> PIXEL_BITS, DIGITS - 1)];
            events[*place as usize] = event(t0_us, *key);
            *place += 1;
        }
    }
}

/// From how many there are of each to where they begin.
fn begins(places: &mut [u32]) {
    let mut before = 0;
    for place in places {
        before += std::mem::replace(place, before);
    }
}

/// An event in 64 bits, with the highest for its time.
fn key(offset_us: u64, event: &Event) -> u64 {
    let pixel = u64::from(event.y) << 17 | u64::from(event.x) << 1;
    offset_us << PIXEL_BITS | pixel | event.polarity as u64
}

fn event(t0_us: u64, key: u64) -> Event {
    Event {
        t_us: t0_us.wrapping_add(key >> PIXEL_BITS),
        x: (key >> 1) as u16,
        y: (key >> 17) as u16,
        polarity: Polarity::from_bool(key & 1 == 1),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::reconstruct::test_header::header;

    proptest! {
        #[test]
        fn it_is_a_stable_sort(
            windows in proptest::collection::vec(
                (
                    prop_oneof![1_u32..300, 1_u32..6000, 1_u32..300_000, 1_u32..],
                    proptest::collection::vec((any::<u32>(), any::<u16>(), 0_u16..4), 0..400),
                ),
                1..4,
            ),
        ) {
            let mut by_time = ByTime::default();
            for (duration_us, items) in windows {
                let header = header(duration_us);
                let event = |(offset, x, y): &(u32, u16, u16)| Event {
                    t_us: header.t0_us + u64::from(offset % duration_us),
                    x: *x,
                    y: u16::MAX - y,
                    polarity: Polarity::from_bool(x & 2 == 0),
                };
                let mut events: Vec<_> = items.iter().map(event).collect();
                let mut expected = events.clone();
                expected.sort_by_key(|event| event.t_us);
                by_time.sort(&header, &mut events);
                prop_assert_eq!(events, expected);
            }
        }
    }
}
