//! A sensor on a port of the microcontroller as an [`EventSource`].
//!
//! The interrupt that receives the sensor's EVT 2.0 words puts them into a queue. Words for which the queue has no
//! room are counted.

use heapless::spsc::{Consumer, Producer};

use crate::event_link::Setup;
use crate::ingest::from_link::LinkSource;
use crate::ingest::{EventSource, Input};
use event_types::evt2::is_event;

/// Type of the words that stand for a loss in the queue; no EVT 2.0 word has this type.
const LOSS: u32 = 7;
/// Type of words without events; it replaces [`LOSS`] in received words.
const OTHERS: u32 = 14;
const TYPE_SHIFT: u32 = 28;
const CONTENT: u32 = (1 << TYPE_SHIFT) - 1;

/// The interrupt's end of the queue.
pub struct Port<'q> {
    queue: Producer<'q, u32>,
    /// Number of events lost since the last word that the queue took; `Some(0)` if only words without events were
    /// lost.
    lost: Option<u32>,
}

impl<'q> Port<'q> {
    /// Creates the end around a queue, whose capacity must cover the time that ingest may be held up.
    #[must_use]
    pub const fn new(queue: Producer<'q, u32>) -> Self {
        Self { queue, lost: None }
    }

    /// Takes the words of one transfer. Never waits, because a sensor cannot be paused.
    pub fn take(&mut self, words: &[u32]) {
        for word in words {
            // A loss is reported where it happened, before anything that came later.
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

    /// Counts events that were lost before they arrived here, for example in a transfer that overran.
    pub const fn count_lost(&mut self, events: u32) {
        let before = match self.lost {
            Some(lost) => lost,
            None => 0,
        };
        self.lost = Some(before.saturating_add(events));
    }
}

/// Ingest's end of the queue. It begins with its own setup; a host may send others ([`SensorSource::with_host`]).
pub struct SensorSource<'q> {
    queue: Consumer<'q, u32>,
    setup: Option<Setup>,
    /// Width and height of the sensor.
    size: (u16, u16),
}

impl<'q> SensorSource<'q> {
    /// Creates the end around the queue's consumer, with the setup that it begins with.
    #[must_use]
    pub const fn new(queue: Consumer<'q, u32>, setup: Setup) -> Self {
        Self {
            queue,
            setup: Some(setup),
            size: (setup.width, setup.height),
        }
    }

    /// Returns a source that also takes setups, hot pixels and flushes from a host's link.
    pub const fn with_host<'s, F>(&'s mut self, link: LinkSource<'s, F>) -> ToldSensor<'s, 'q, F> {
        ToldSensor { sensor: self, link }
    }

    /// Adapts a host's setup to the sensor, which cannot be paused and has a fixed size.
    fn told(&mut self, setup: Setup) -> Setup {
        self.setup = None;
        let (width, height) = match self.size == (setup.width, setup.height) {
            true => self.size,
            // Refused later, because no sensor has this size.
            false => (0, 0),
        };
        Setup {
            width,
            height,
            when_full: Setup::DROP,
            ..setup
        }
    }
}

/// A sensor that a host controls: setups, hot pixels and flushes come from the link. Events on the link are ignored
/// and counted.
pub struct ToldSensor<'s, 'q, F> {
    sensor: &'s mut SensorSource<'q>,
    link: LinkSource<'s, F>,
}

impl<F: FnMut() -> Option<u8>> EventSource for ToldSensor<'_, '_, F> {
    #[inline]
    fn next(&mut self) -> Option<Input> {
        loop {
            return match self.link.next() {
                Some(Input::Setup(setup)) => Some(Input::Setup(self.sensor.told(setup))),
                Some(input @ (Input::Hot(_) | Input::HotEnd | Input::Flush)) => Some(input),
                Some(Input::Word(_) | Input::Lost(_)) => {
                    self.link.ignore();
                    continue;
                }
                None => self.sensor.next(),
            };
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
    use crate::event_link::{FIELDS_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet};
    use crate::ingest::from_link::Link;
    use heapless::spsc::Queue;
    use proptest::prelude::*;

    const SETUP: Setup = Setup {
        width: 1,
        height: 1,
        window_us: 1,
        tau_low_pico: 0,
        tau_high_pico: 0,
        transform: 0,
        m: 1,
        grid: 0,
        step_log2: 0,
        mode: 0,
        fidelity: 0,
        key_windows: 1,
        region: [0; 4],
        options: 0,
        bytes_per_second: 0,
        scan_period_q16: 0,
        scan_slope_q16: 0,
        scan_axis: 0,
        time_base_us: 0,
        when_full: Setup::DROP,
    };

    fn packet(kind: Kind, body: &[u8], out: &mut std::vec::Vec<u8>) {
        let mut bytes = [0; PACKET_BYTES_MAX];
        let packet = Packet {
            kind,
            position: 0,
            body,
        };
        let len = packet.write(&mut bytes).unwrap();
        out.extend(&bytes[..len]);
    }

    fn setup(setup: &Setup, out: &mut std::vec::Vec<u8>) {
        let mut body = [0; FIELDS_BYTES_MAX];
        let len = setup.write(&mut body).unwrap();
        packet(Kind::Setup, &body[..len], out);
    }

    #[test]
    fn a_host_sets_up_and_the_sensor_sends() {
        let mut queue = Queue::<u32, 8>::new();
        let (producer, consumer) = queue.split();
        let mut port = Port::new(producer);
        let mut sensor = SensorSource::new(consumer, SETUP);
        port.take(&[5]);
        let asked = Setup {
            window_us: 7,
            when_full: Setup::WAIT,
            ..SETUP
        };
        let mut bytes = std::vec::Vec::new();
        setup(&asked, &mut bytes);
        packet(Kind::Words, &[1, 0, 0, 0x80, 2, 0, 0, 0x80], &mut bytes);
        packet(Kind::Hot, &[0], &mut bytes);
        packet(Kind::Flush, &[], &mut bytes);
        // For a sensor of another size.
        setup(&Setup { width: 2, ..asked }, &mut bytes);
        let (mut bytes, mut link) = (bytes.into_iter(), Link::new());
        let mut source = sensor.with_host(link.source(|| bytes.next()));
        let told = Setup {
            when_full: Setup::DROP,
            ..asked
        };
        let refused = Setup {
            width: 0,
            height: 0,
            ..told
        };
        for input in [
            Input::Setup(told),
            Input::Hot(0),
            Input::HotEnd,
            Input::Flush,
            Input::Setup(refused),
            // The sensor's own setup is no longer sent.
            Input::Word(5),
        ] {
            assert_eq!(source.next(), Some(input));
        }
        assert_eq!(source.next(), None);
        assert_eq!((link.ignored(), link.damaged_bytes()), (2, 0));
    }

    proptest! {
        /// Every word comes out in its place, or else a loss of as many events.
        #[test]
        fn losses_stand_where_they_happened(
            transfers in proptest::collection::vec(
                (proptest::collection::vec((0..16_u32, any::<u32>()), 0..12), 0..12_usize), 0..40,
            ),
        ) {
            let mut queue = Queue::<u32, 8>::new();
            let (producer, consumer) = queue.split();
            let mut port = Port::new(producer);
            let mut source = SensorSource::new(consumer, SETUP);
            prop_assert_eq!(source.next(), Some(Input::Setup(SETUP)));
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
            // What is still in the queue, and the last loss after it.
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
                        // A loss counts events; words without events are lost along with them.
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
