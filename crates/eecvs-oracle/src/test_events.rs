//! Events and impulses for the oracle's own tests.

use event_types::{Event, Polarity};
use proptest::prelude::*;

use super::transform::Impulse;

/// Returns an ON event of pixel (0, 0).
pub fn at(t_us: u64) -> Event {
    Event {
        t_us,
        x: 0,
        y: 0,
        polarity: Polarity::On,
    }
}

/// Generates a duration and up to 39 impulses within it.
pub fn impulses() -> impl Strategy<Value = (u32, Vec<Impulse>)> {
    (1u32..100_000).prop_flat_map(|duration_us| {
        let impulse = (0..duration_us, prop::bool::ANY).prop_map(|(offset_us, on)| Impulse {
            offset_us,
            p: if on { 1.0 } else { -1.0 },
        });
        (Just(duration_us), prop::collection::vec(impulse, 0..40))
    })
}
