//! A sensor on a port of the microcontroller as an [`EventSource`].
//!
//! The port's transfer (DMA) fills one block of memory after the other with the sensor's EVT 2.0 words. Its interrupt
//! hands each filled block over and gets the next one to fill ([`Port::exchange`]); ingest reads the words where they are
//! ([`SensorSource`]) and gives the block back. Nothing is copied, and neither side waits for the other: while every
//! other block waits to be read, the port drops what the last one holds and fills it again. It counts the dropped events
//! and keeps their last time, so that the events behind them have one.

use heapless::spsc::{Consumer, Producer};

use crate::event_link::Setup;
use crate::ingest::from_link::LinkSource;
use crate::ingest::{EventSource, Input};
use event_types::evt2::{is_event, is_time};

/// Memory of one transfer: EVT 2.0 words, little-endian.
pub type Block<'m> = &'m mut [[u8; 4]];

/// A block with what the transfer wrote into it.
#[derive(Debug)]
pub struct Filled<'m> {
    block: Block<'m>,
    /// Number of words written.
    words: usize,
    /// What is missing before them.
    missing: Missing,
}

/// What is missing between two blocks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Missing {
    /// Number of events that never arrived, perhaps with times; `None` if all arrived.
    lost: Option<u32>,
    /// Number of events that arrived and were dropped.
    dropped: u32,
    /// The last time among the dropped words.
    time: Option<u32>,
}

/// The interrupt's end.
pub struct Port<'q, 'm> {
    filled: Producer<'q, Filled<'m>>,
    free: Consumer<'q, Block<'m>>,
    missing: Missing,
}

impl<'q, 'm> Port<'q, 'm> {
    /// Creates the end around two queues: of filled blocks and of free ones. Each should have room for all blocks but
    /// the one that the transfer fills.
    #[must_use]
    pub const fn new(filled: Producer<'q, Filled<'m>>, free: Consumer<'q, Block<'m>>) -> Self {
        Self {
            filled,
            free,
            missing: Missing {
                lost: None,
                dropped: 0,
                time: None,
            },
        }
    }

    /// Takes a block into whose first `words` words the transfer has written, and returns the next one to fill: the same
    /// one if there is no other, after its words were dropped. Never waits, because a sensor cannot be paused.
    ///
    /// A block of 0 words hands over nothing but what [`Self::is_missing`] knows.
    pub fn exchange(&mut self, block: Block<'m>, words: usize) -> Block<'m> {
        if self.filled.ready()
            && let Some(next) = self.free.dequeue()
        {
            let missing = core::mem::take(&mut self.missing);
            let filled = Filled {
                block,
                words,
                missing,
            };
            return match self.filled.enqueue(filled) {
                Ok(()) => next,
                // Not reached, as there was room and nobody else puts anything into the queue.
                Err(filled) => self.drop(filled.block, filled.words),
            };
        }
        self.drop(block, words)
    }

    /// Counts events that never arrived here: at most as many as a block has words for each that was overwritten before
    /// [`Self::exchange`] had it.
    pub const fn count_lost(&mut self, events: u32) {
        let before = match self.missing.lost {
            Some(lost) => lost,
            None => 0,
        };
        self.missing.lost = Some(before.saturating_add(events));
        // There may have been another time since.
        self.missing.time = None;
    }

    /// Returns whether events are missing of which no block has told yet: a sensor that falls silent then should
    /// [`Self::exchange`] a block of 0 words, so that the next frame has their number.
    #[must_use]
    pub const fn is_missing(&self) -> bool {
        self.missing.lost.is_some() || self.missing.dropped > 0
    }

    /// Counts the words of a block, which the transfer then fills again.
    fn drop(&mut self, block: Block<'m>, words: usize) -> Block<'m> {
        let written = block.get(..words).unwrap_or(block);
        // An interrupt does this for every word of a sensor that is too quick: no branch, and 0 for no time.
        let (mut events, mut time) = (0, 0);
        for word in written {
            let word = u32::from_le_bytes(*word);
            events += u32::from(is_event(word));
            time = if is_time(word) { word } else { time };
        }
        if time != 0 {
            self.missing.time = Some(time);
        }
        self.missing.dropped = self.missing.dropped.saturating_add(events);
        block
    }
}

/// Ingest's end. It begins with its own setup; a host may send others ([`SensorSource::with_host`]).
pub struct SensorSource<'q, 'm> {
    filled: Consumer<'q, Filled<'m>>,
    free: Producer<'q, Block<'m>>,
    /// The block that is read.
    open: Option<Filled<'m>>,
    /// Number of its words that were read.
    read: usize,
    setup: Option<Setup>,
    /// Whether the end of the stream is to be reported once every block was read.
    is_flushed: bool,
    /// Width and height of the sensor.
    size: (u16, u16),
}

impl<'q, 'm> SensorSource<'q, 'm> {
    /// Creates the end around the queues' other ends, with the setup that it begins with.
    #[must_use]
    pub const fn new(
        filled: Consumer<'q, Filled<'m>>,
        free: Producer<'q, Block<'m>>,
        setup: Setup,
    ) -> Self {
        Self {
            filled,
            free,
            open: None,
            read: 0,
            setup: Some(setup),
            is_flushed: false,
            size: (setup.width, setup.height),
        }
    }

    /// Returns a source that also takes setups, hot pixels and flushes from a host's link.
    pub const fn with_host<'s, F>(
        &'s mut self,
        link: LinkSource<'s, F>,
    ) -> ToldSensor<'s, 'q, 'm, F> {
        ToldSensor { sensor: self, link }
    }

    /// Reports the end of the stream after the blocks that are there, for a sensor that is switched off.
    pub const fn flush(&mut self) {
        self.is_flushed = true;
    }

    /// Returns whether a block's words are at hand, after the one before was given back.
    fn open(&mut self) -> bool {
        if let Some(open) = &self.open {
            let is_left = open.missing != Missing::default() || self.read < open.words;
            if is_left {
                return true;
            }
        }
        if let Some(Filled { block, .. }) = self.open.take() {
            // There is room for every block.
            let _ = self.free.enqueue(block);
        }
        self.read = 0;
        self.open = self.filled.dequeue();
        self.open.is_some()
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

impl Missing {
    /// Returns what is to be reported first.
    fn next(&mut self) -> Option<Input> {
        if let Some(lost) = self.lost.take() {
            return Some(Input::Lost(lost));
        }
        if self.dropped > 0 {
            return Some(Input::Dropped(core::mem::take(&mut self.dropped)));
        }
        self.time.take().map(Input::Word)
    }
}

/// A sensor that a host controls: setups, hot pixels and flushes come from the link. Events on the link are ignored
/// and counted.
pub struct ToldSensor<'s, 'q, 'm, F> {
    sensor: &'s mut SensorSource<'q, 'm>,
    link: LinkSource<'s, F>,
}

impl<F: FnMut() -> Option<u8>> EventSource for ToldSensor<'_, '_, '_, F> {
    fn words(&self) -> &[[u8; 4]] {
        self.sensor.words()
    }

    fn skip(&mut self, words: usize, events: u32) {
        self.sensor.skip(words, events);
    }

    #[inline]
    fn next(&mut self) -> Option<Input> {
        loop {
            return match self.link.next() {
                Some(Input::Setup(setup)) => Some(Input::Setup(self.sensor.told(setup))),
                Some(input @ (Input::Hot(_) | Input::HotEnd | Input::Flush)) => Some(input),
                Some(Input::Word(_) | Input::Lost(_) | Input::Dropped(_)) => {
                    self.link.ignore();
                    continue;
                }
                None => self.sensor.next(),
            };
        }
    }
}

impl EventSource for SensorSource<'_, '_> {
    fn words(&self) -> &[[u8; 4]] {
        match &self.open {
            Some(open) if open.missing == Missing::default() => {
                let written = open.block.get(..open.words).unwrap_or(open.block);
                written.get(self.read..).unwrap_or_default()
            }
            _ => &[],
        }
    }

    fn skip(&mut self, words: usize, _: u32) {
        self.read += words;
    }

    #[inline]
    fn next(&mut self) -> Option<Input> {
        if let Some(setup) = self.setup.take() {
            return Some(Input::Setup(setup));
        }
        while self.open() {
            let missing = self.open.as_mut().and_then(|open| open.missing.next());
            if missing.is_some() {
                return missing;
            }
            if let Some(word) = self.words().first() {
                let word = u32::from_le_bytes(*word);
                self.read += 1;
                return Some(Input::Word(word));
            }
            // A block that had less than was said.
            self.read = usize::MAX;
        }
        core::mem::take(&mut self.is_flushed).then_some(Input::Flush)
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

    /// Blocks, queues with room for all of them, and the two ends; the first block is the one to fill.
    fn ends<const BLOCKS: usize, const WORDS: usize>(
        run: impl for<'q, 'm> FnOnce(Port<'q, 'm>, SensorSource<'q, 'm>, Block<'m>),
    ) {
        let mut blocks = [[[0; 4]; WORDS]; BLOCKS];
        let mut blocks = blocks.iter_mut().map(|block| &mut block[..]);
        let first = blocks.next().unwrap();
        let (mut filled, mut free) = (Queue::<_, 8>::new(), Queue::<_, 8>::new());
        let (put_filled, take_filled) = filled.split();
        let (mut put_free, take_free) = free.split();
        for block in blocks {
            put_free.enqueue(block).unwrap();
        }
        let port = Port::new(put_filled, take_free);
        run(port, SensorSource::new(take_filled, put_free, SETUP), first);
    }

    /// Fills a block as a transfer does; returns the next one, and whether the words were handed over.
    fn transfer<'m>(port: &mut Port<'_, 'm>, block: Block<'m>, words: &[u32]) -> (Block<'m>, bool) {
        for (to, word) in block.iter_mut().zip(words) {
            *to = word.to_le_bytes();
        }
        let before = block.as_ptr();
        let next = port.exchange(block, words.len());
        let is_handed_over = next.as_ptr() != before;
        (next, is_handed_over)
    }

    #[test]
    fn a_host_sets_up_and_the_sensor_sends() {
        ends::<2, 4>(|mut port, mut sensor, block| {
            transfer(&mut port, block, &[5]);
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
        });
    }

    #[test]
    fn events_that_never_arrived_take_the_time_with_them() {
        const TIME: u32 = 8 << 28;
        ends::<2, 4>(|mut port, mut source, block| {
            assert_eq!(source.next(), Some(Input::Setup(SETUP)));
            let (block, _) = transfer(&mut port, block, &[TIME | 1, 5]);
            // The other block is not read yet.
            let (block, is_handed_over) = transfer(&mut port, block, &[TIME | 2, 6, 7, 14 << 28]);
            assert!(!is_handed_over && port.is_missing());
            port.count_lost(3);
            port.count_lost(1);
            for word in [TIME | 1, 5] {
                assert_eq!(source.next(), Some(Input::Word(word)));
            }
            assert_eq!(source.next(), None);
            // Nothing but what is missing, and then the end.
            port.exchange(block, 0);
            source.flush();
            assert!(!port.is_missing());
            for input in [Input::Lost(4), Input::Dropped(2), Input::Flush] {
                assert_eq!(source.next(), Some(input));
            }
            assert_eq!(source.next(), None);
        });
    }

    #[test]
    fn more_words_than_a_block_has_are_those_that_it_has() {
        ends::<3, 2>(|mut port, mut source, block| {
            assert_eq!(source.next(), Some(Input::Setup(SETUP)));
            let block = port.exchange(block, usize::MAX);
            port.exchange(block, 1);
            for _ in 0..3 {
                assert_eq!(source.next(), Some(Input::Word(0)));
            }
            assert_eq!(source.next(), None);
        });
    }

    proptest! {
        /// Every word comes out in its place, or the number of events that were dropped there and their last time.
        #[test]
        fn losses_stand_where_they_happened(
            transfers in proptest::collection::vec(
                (proptest::collection::vec((0..16_u32, any::<u32>()), 0..12), 0..30_usize), 0..40,
            ),
            takes_at_once: bool,
        ) {
            let mut inputs = std::vec::Vec::new();
            let mut expected = std::vec::Vec::new();
            ends::<4, 12>(|mut port, mut source, mut block| {
                assert_eq!(source.next(), Some(Input::Setup(SETUP)));
                let mut take = |source: &mut SensorSource<'_, '_>| {
                    let words = source.words().iter().take(usize::from(takes_at_once) * 5);
                    let words: std::vec::Vec<_> =
                        words.map(|word| Input::Word(u32::from_le_bytes(*word))).collect();
                    source.skip(words.len(), 0);
                    inputs.extend(words);
                    let input = source.next();
                    inputs.extend(input);
                    input.is_some()
                };
                let (mut dropped, mut time) = (0, None);
                let transfers = transfers.iter().map(|(words, takes)| (&words[..], *takes));
                for (words, takes) in transfers.chain([(&[][..], usize::MAX), (&[][..], usize::MAX)]) {
                    let words: std::vec::Vec<u32> =
                        words.iter().map(|(kind, word)| (kind << 28) | (word >> 4)).collect();
                    let (next, is_handed_over) = transfer(&mut port, block, &words);
                    block = next;
                    if is_handed_over {
                        if dropped > 0 {
                            expected.push(Input::Dropped(core::mem::take(&mut dropped)));
                        }
                        expected.extend(time.take().map(Input::Word));
                        expected.extend(words.into_iter().map(Input::Word));
                    } else {
                        dropped += words.iter().filter(|word| is_event(**word)).count() as u32;
                        time = words.into_iter().rfind(|word| is_time(*word)).or(time);
                    }
                    let mut takes = takes;
                    while takes > 0 && take(&mut source) {
                        takes -= 1;
                    }
                }
            });
            prop_assert_eq!(inputs, expected);
        }
    }
}
