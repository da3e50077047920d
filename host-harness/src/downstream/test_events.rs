//! Events as a decoder might return them.

use eecvs_nostd::Event;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Random numbers with a fixed seed.
pub(super) struct Random(Xoshiro256PlusPlus);

impl Random {
    pub(super) fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// Returns a number from 0 to `end` - 1.
    pub(super) fn below(&mut self, end: u64) -> u64 {
        self.0.next_u64() % end
    }

    /// Returns a number from 0 to below 1.
    pub(super) fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Returns the same events in another order.
pub(super) fn shuffled(events: &[Event]) -> Vec<Event> {
    let mut random = Random::new(1);
    let mut events = events.to_vec();
    for last in (1..events.len()).rev() {
        events.swap(last, random.below(last as u64 + 1) as usize);
    }
    events
}

/// Returns the same events, each earlier or later by up to `jitter_us`.
pub(super) fn jittered(events: &[Event], jitter_us: u64) -> Vec<Event> {
    let mut random = Random::new(2);
    events
        .iter()
        .map(|event| Event {
            t_us: (event.t_us + random.below(2 * jitter_us + 1)).saturating_sub(jitter_us),
            ..*event
        })
        .collect()
}
