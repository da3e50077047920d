//! The digest of a recording's events, by which a file of truth is known to be about them.

use eecvs_nostd::Event;
use event_files::{EventReader, Skipped};
use event_types::Sensor;
use sha2::{Digest, Sha256};

/// Name of the array of a file of truth that holds the digest.
pub const ARRAY: &str = "events_sha256";
/// Its length.
pub const BYTES: usize = 32;

/// SHA-256 over the events in their order: 13 bytes each, the time since the first event (8 bytes), x and y (2 each), all
/// least significant byte first, and 1 for ON or 0 for OFF. A clock that is ahead by a constant changes nothing.
#[derive(Debug, Clone, Default)]
pub struct EventsDigest {
    sha: Sha256,
    first_us: Option<u64>,
    bytes: Vec<u8>,
}

impl EventsDigest {
    /// Adds the next events.
    pub fn push(&mut self, events: &[Event]) {
        let Some(first) = events.first() else {
            return;
        };
        let first_us = *self.first_us.get_or_insert(first.t_us);
        self.bytes.clear();
        for event in events {
            let since_us = event.t_us.wrapping_sub(first_us);
            self.bytes.extend(since_us.to_le_bytes());
            self.bytes.extend(event.x.to_le_bytes());
            self.bytes.extend(event.y.to_le_bytes());
            self.bytes.push(u8::from(event.polarity.sign() > 0));
        }
        self.sha.update(&self.bytes);
    }

    /// Returns the digest of the events so far.
    #[must_use]
    pub fn finish(&self) -> [u8; BYTES] {
        self.sha.clone().finalize().into()
    }
}

/// A reader whose events are digested.
pub struct Digested {
    reader: Box<dyn EventReader>,
    /// Of the events that have been read.
    pub digest: EventsDigest,
}

impl Digested {
    /// Begins with the reader's next event.
    #[must_use]
    pub fn new(reader: Box<dyn EventReader>) -> Self {
        Self {
            reader,
            digest: EventsDigest::default(),
        }
    }
}

impl EventReader for Digested {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let before = events.len();
        let read = self.reader.read(events);
        self.digest.push(events.get(before..).unwrap_or_default());
        read
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;

    use super::*;

    #[test]
    fn order_and_every_field_count_and_a_constant_of_the_clock_does_not() {
        let of = |rows: &[(u64, u16, u16, bool)], parts: usize| {
            let events: Vec<_> = rows
                .iter()
                .map(|(t_us, x, y, is_on)| Event {
                    t_us: *t_us,
                    x: *x,
                    y: *y,
                    polarity: Polarity::from_bool(*is_on),
                })
                .collect();
            let mut digest = EventsDigest::default();
            for part in events.chunks(parts) {
                digest.push(part);
            }
            digest.finish()
        };
        let whole = of(&[(5, 1, 2, true), (7, 3, 4, false)], 9);
        assert_eq!(whole, of(&[(5, 1, 2, true), (7, 3, 4, false)], 1));
        assert_eq!(whole, of(&[(15, 1, 2, true), (17, 3, 4, false)], 9));
        for other in [
            [(5, 1, 2, true), (8, 3, 4, false)],
            [(5, 1, 2, true), (7, 4, 4, false)],
            [(5, 1, 2, true), (7, 3, 3, false)],
            [(5, 1, 2, true), (7, 3, 4, true)],
            [(7, 3, 4, false), (5, 1, 2, true)],
        ] {
            assert_ne!(whole, of(&other, 9), "{other:?}");
        }
    }
}
