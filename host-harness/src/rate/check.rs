//! Checks what a decoder's events must have in common with the original's, before anything is measured.

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Fidelity, Polarity};

/// Position and polarity, then time.
type Key = (u16, u16, Polarity, u64);

/// What a decoder promises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Promise {
    /// The same multiset of events.
    Lossless,
    /// Events at the same positions with the same polarities, each at most this many us from its original time.
    Within(u64),
    /// The same number of events at each position and polarity.
    Counts,
}

impl Promise {
    /// Returns the promise of frames of events.
    #[must_use]
    pub fn of(fidelity: Fidelity) -> Self {
        match (fidelity, fidelity.within_us()) {
            (Fidelity::Lossless, _) => Self::Lossless,
            (_, Some(within_us)) => Self::Within(within_us.into()),
            (_, None) => Self::Counts,
        }
    }
}

/// Returns the name of a setting: `lossless`, `50 us`, `8 bins`, `spread over 50 us`.
#[must_use]
pub fn setting(fidelity: Fidelity) -> String {
    match fidelity {
        Fidelity::Lossless => "lossless".to_owned(),
        Fidelity::ToleranceUs(us) => format!("{us} us"),
        Fidelity::Bins(bins) => format!("{bins} bins"),
        Fidelity::SpreadUs(us) => format!("spread over {us} us"),
    }
}

/// Checks the decoded events against the promise, over the whole recording.
///
/// # Errors
/// Fails if the promise is broken; the message says where and by how much.
pub fn check(promise: Promise, original: &[Event], decoded: &[Event]) -> Result<()> {
    ensure!(
        original.len() == decoded.len(),
        "{} of {} events came back; please report this",
        decoded.len(),
        original.len()
    );
    let (original, decoded) = (keys(original), keys(decoded));
    for (a, b) in original.iter().zip(&decoded) {
        let place = |key: &Key| (key.0, key.1, key.2);
        ensure!(
            place(a) == place(b),
            "at (x, y) = ({}, {}) different events came back; please report this",
            a.1,
            a.0
        );
        let most = match promise {
            Promise::Lossless => 0,
            Promise::Within(tolerance_us) => tolerance_us,
            Promise::Counts => u64::MAX,
        };
        ensure!(
            a.3.abs_diff(b.3) <= most,
            "an event at (x, y) = ({}, {}) came back {} us off, more than the promised {most} us; \
             please report this",
            a.1,
            a.0,
            a.3.abs_diff(b.3)
        );
    }
    Ok(())
}

/// Returns sorted keys: pairing the events of one position and polarity in this order minimises the largest error.
fn keys(events: &[Event]) -> Vec<Key> {
    let key = |event: &Event| (event.y, event.x, event.polarity, event.t_us);
    let mut keys: Vec<Key> = events.iter().map(key).collect();
    keys.sort_unstable();
    keys
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    #[test]
    fn promises_are_held_to_the_microsecond() {
        let original = [
            event(5, 1, 2, true),
            event(9, 1, 2, true),
            event(9, 3, 2, false),
        ];
        let mut decoded = original;
        decoded.reverse();
        check(Promise::Lossless, &original, &decoded).unwrap();
        decoded[1].t_us += 4;
        assert!(check(Promise::Lossless, &original, &decoded).is_err());
        check(Promise::Within(4), &original, &decoded).unwrap();
        assert!(check(Promise::Within(3), &original, &decoded).is_err());
        decoded[1].t_us = u64::MAX;
        check(Promise::Counts, &original, &decoded).unwrap();
        decoded[1].polarity = Polarity::Off;
        assert!(check(Promise::Counts, &original, &decoded).is_err());
        assert!(check(Promise::Counts, &original, &decoded[1..]).is_err());
        // The same positions, but not the same counts.
        let twice = [original[0], original[0], original[2]];
        assert!(check(Promise::Lossless, &original, &twice).is_err());
    }
}
