//! A sensor on a port of the microcontroller as an [`EventSource`]: the interrupt that gets its
//! EVT 2.0 words puts them into a queue, and what the queue has no room for is counted.

use heapless::spsc::{Consumer, Producer};

use crate::event_link::Setup;
use crate::evt2::is_event;
use crate::ingest::{EventSource, Input};

/// Type of the words that stand for a loss in the queue: EVT 2.0 has none of this type.
const LOSS: u32 = 7;
/// Type of words without events.
const OTHERS: u32 = 14;
const TYPE_SHIFT: u32 = 28;
const CONTENT: u32 = (1 << TYPE_SHIFT) - 1;

/// The interrupt's end.
pub struct Port<'q> {
    queue: Producer<'q, u32>,
    /// Events lost since the last word that the queue took; also none, where words without events
    /// were lost.
    lost: Option<u32>,
}

impl<'q> Port<'q> {
    /// Around a queue; its capacity covers the time that ingest may be held up.
    #[must_use]
    pub const fn new(queue: Producer<'q, u32>) -> Self {
        Self { queue, lost: None }
    }

    /// Takes the words of one transfer. Never waits: a sensor cannot be held.
    pub fn take(&mut self, words: &[u32]) {
        for word in words {
            // A loss is told where it happened, before anything that came after it.
            if let Some(lost) = self.lost {
                let told = lost.min(CONTENT);
                if self.queue.enqueue((LOSS << TYPE_SHIFT) | told).is_ok() {
                    self.lost = Some(lost - told).filter(|lost| *lost > 0);
                }
            }
            let word = if word >> TYPE_SHIFT == LOSS {
                (OTHERS << TYPE_SHIFT) | (word & CONTENT)
            } else {
                *word
            };
            if self.lost.is_some() || self.queue.enqueue(word).is_err() {
                self.count_lost(u32::from(is_event(word)));
            }
        }
    }

    /// Counts events that were lost before they came here, as by a transfer that overran.
    pub const fn count_lost(&mut self, events: u32) {
        let before = match self.lost {
            Some(lost) => lost,
            None => 0,
        };
        self.lost = Some(before.saturating_add(events));
    }
}

/// Ingest's end. It begins with a setup, as there is no host to send one.
pub struct SensorSource<'q> {
    queue: Consumer<'q, u32>,
    setup: Option<Setup>,
}

impl<'q> SensorSource<'q> {
    /// Around the queue's other end.
    #[must_use]
    pub const fn new(queue: Consumer<'q, u32>, setup: Setup) -> Self {
        Self {
            queue,
            setup: Some(setup),
        }
    }
}

impl EventSource for SensorSource<'_> {
    #[inline]
    fn next(&mut self) -> Option<Input> {
        if let Some(setup) = self.setup.take() {
            return Some(Input::Setup(setup));
        }
        let word = self.queue.dequeue()?;
        Some(if word >> TYPE_SHIFT == LOSS {
            Input::Lost(word & CONTENT)
        } else {
            Input::Word(word)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::spsc::Queue;
    use proptest::prelude::*;

    proptest! {
        /// Every word comes out in its place, or a loss of as many events stands there.
        #[test]
        fn losses_stand_where_they_happened(
            transfers in proptest::collection::vec(
                (proptest::collection::vec((0..16_u32, any::<u32>()), 0..12), 0..12_usize), 0..40,
            ),
        ) {
            let mut queue = Queue::<u32, 8>::new();
            let (producer, consumer) = queue.split();
            let setup = Setup {
                width: 1, height: 1, window_us: 1, tau_low_pico: 0, tau_high_pico: 0, transform: 0,
                m: 1, grid: 0, step_log2: 0, mode: 0, fidelity: 0, key_windows: 1, region: [0; 4],
                isolated: 0, bytes_per_second: 0, scan_period_q16: 0, scan_slope_q16: 0,
                scan_axis: 0, time_base_us: 0, when_full: Setup::DROP,
            };
            let mut port = Port::new(producer);
            let mut source = SensorSource::new(consumer, setup);
            prop_assert_eq!(source.next(), Some(Input::Setup(setup)));
            let mut sent = std::vec::Vec::new();
            let mut inputs = std::vec::Vec::new();
            for (words, takes) in &transfers {
                let words: std::vec::Vec<u32> =
                    words.iter().map(|(kind, word)| (kind << 28) | (word & CONTENT)).collect();
                port.take(&words);
                sent.extend(words);
                for _ in 0..*takes {
                    inputs.extend(source.next());
                }
            }
            // What is still in the queue, and the last loss behind it.
            while let Some(input) = source.next() {
                inputs.push(input);
            }
            sent.push(15 << 28);
            port.take(&[15 << 28]);
            while let Some(input) = source.next() {
                inputs.push(input);
            }
            let mut sent = sent.into_iter();
            let mut words = 0;
            let mut is_after_loss = false;
            for input in inputs {
                match input {
                    Input::Word(word) => {
                        words += 1;
                        let is_it = |sent: u32| {
                            sent == word || (sent >> 28 == LOSS && word == (OTHERS << 28) | (sent & CONTENT))
                        };
                        let mut found = sent.next();
                        // A loss counts events; words without events are lost with them.
                        while is_after_loss && found.is_some_and(|sent| !is_it(sent) && !is_event(sent)) {
                            found = sent.next();
                        }
                        prop_assert!(found.is_some_and(is_it), "{:x?} {:x}", found, word);
                        is_after_loss = false;
                    }
                    Input::Lost(events) => {
                        let mut left = events;
                        while left > 0 {
                            let word = sent.next().expect("as many as were sent");
                            left -= u32::from(is_event(word));
                        }
                        is_after_loss = true;
                    }
                    _ => prop_assert!(false),
                }
            }
            prop_assert!(words > 0);
            prop_assert!(!sent.any(is_event));
        }
    }
}
