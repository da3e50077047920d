//! Sorts a window's events by time.

use eecvs_nostd::{Event, Header, Polarity};

/// Smallest number of events sorted by counting; fewer are sorted by comparison.
const COUNTED_MIN: usize = 64;
/// Largest number of bits of a time sorted in a single pass, so that the counters fit in the first-level cache.
const ONE_PASS_BITS: u32 = 12;
/// Largest number of bits sorted in each of several passes.
const DIGIT_BITS: u32 = 8;
const PLACES: usize = 1 << DIGIT_BITS;
/// Low bits of a key, below the time offset: row, column and polarity.
const PIXEL_BITS: u32 = 33;
/// Bits of a key for the time offset.
const OFFSET_BITS: u32 = u64::BITS - PIXEL_BITS;

/// Sorts the events of windows by time. The sort is stable: events of equal time stay in their order, which is
/// raster order if they come from frames.
///
/// It is a counting sort: a single pass for short windows, otherwise one pass per digit of the offset, lowest
/// first, on events packed into 64 bits. The buffers are kept from window to window.
#[derive(Debug, Default)]
pub struct ByTime {
    keys: Vec<u64>,
    spare: Vec<u64>,
}

/// Returns a window's events sorted by [`ByTime::sort`].
#[must_use]
pub fn by_time(header: &Header, events: &[Event]) -> Vec<Event> {
    let mut sorted = events.to_vec();
    ByTime::default().sort(header, &mut sorted);
    sorted
}

impl ByTime {
    /// Sorts a window's events by time, in place; `header` gives the start and the duration of the window.
    pub fn sort(&mut self, header: &Header, events: &mut [Event]) {
        // Events in their order of arrival mostly are.
        if events.is_sorted_by_key(|event| event.t_us) {
            return;
        }
        // Bits of the largest offset.
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

    /// Packs events into keys in their order, and puts each key in its place.
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

    /// Packs events into keys in the first pass, sorts keys in the middle passes, and unpacks them in the last.
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

/// Replaces the number of keys of each digit value by the index at which these keys begin.
fn begins(places: &mut [u32]) {
    let mut before = 0;
    for place in places {
        before += std::mem::replace(place, before);
    }
}

/// Packs an event into 64 bits, with the time offset in the highest bits.
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
