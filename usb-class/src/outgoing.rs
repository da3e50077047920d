//! Splits messages into packets: the queue between the encoder and the bus.
//!
//! A message ends with a packet that is not full, an empty one if need be, so that a host's transfer ends where the
//! message does. The queue holds a fixed number of packets, and so never allocates or grows. While it is full the
//! encoder waits, and the encoder's setup decides what happens to events.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use crate::PACKET_BYTES;

/// Number of packets that the queue holds: 4 KiB, an ordinary frame. A power of two.
pub const QUEUE_PACKETS: usize = 64;
const WORDS: usize = PACKET_BYTES / 4;

/// One packet of the queue.
pub(crate) struct Packet {
    /// Low bits of the packet's session; the queue is emptied long before they repeat.
    session: u16,
    len: u16,
    bytes: [u8; PACKET_BYTES],
}

impl Packet {
    pub(crate) fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// Whether the packet ends a message.
    pub(crate) const fn ends(&self) -> bool {
        (self.len as usize) < PACKET_BYTES
    }

    pub(crate) const fn is_of(&self, session: u32) -> bool {
        self.session == session as u16
    }
}

/// A packet's place in the queue: the low half of `head` is its length, the high half its session. Made of atomics,
/// so that both sides can share the queue; `put` and `taken` order the accesses.
struct Slot {
    head: AtomicU32,
    words: [AtomicU32; WORDS],
}

impl Slot {
    const fn empty() -> Self {
        Self {
            head: AtomicU32::new(0),
            words: [const { AtomicU32::new(0) }; WORDS],
        }
    }

    fn write(&self, session: u32, bytes: &[u8]) {
        let head = session << 16 | bytes.len() as u32;
        self.head.store(head, Ordering::Relaxed);
        let (words, rest) = bytes.as_chunks();
        for (slot, word) in self.words.iter().zip(words) {
            slot.store(u32::from_le_bytes(*word), Ordering::Relaxed);
        }
        if let Some(slot) = self.words.get(words.len()) {
            let mut word = [0; 4];
            for (to, from) in word.iter_mut().zip(rest) {
                *to = *from;
            }
            slot.store(u32::from_le_bytes(word), Ordering::Relaxed);
        }
    }

    fn read(&self) -> Packet {
        let head = self.head.load(Ordering::Relaxed);
        let mut bytes = [0; PACKET_BYTES];
        for (word, slot) in bytes.as_chunks_mut().0.iter_mut().zip(&self.words) {
            *word = slot.load(Ordering::Relaxed).to_le_bytes();
        }
        Packet {
            session: (head >> 16) as u16,
            len: head as u16,
            bytes,
        }
    }
}

/// State that both sides share.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Written by the bus's side.
    listening: AtomicBool,
    session: AtomicU32,
    /// Written by the sender's side.
    messages_dropped: AtomicU32,
    bytes_dropped: AtomicU32,
}

/// Adds to a count that one side writes and the other reads.
fn add(count: &AtomicU32, more: usize) {
    let sum = count.load(Ordering::Relaxed).wrapping_add(more as u32);
    count.store(sum, Ordering::Relaxed);
}

impl Shared {
    pub(crate) fn session(&self) -> u32 {
        self.session.load(Ordering::Acquire)
    }

    pub(crate) fn begin_session(&self) {
        add(&self.session, 1);
    }

    pub(crate) fn listen(&self, listening: bool) {
        self.listening.store(listening, Ordering::Release);
    }

    pub(crate) fn is_listening(&self) -> bool {
        self.listening.load(Ordering::Acquire)
    }

    pub(crate) fn messages_dropped(&self) -> u32 {
        self.messages_dropped.load(Ordering::Relaxed)
    }

    pub(crate) fn bytes_dropped(&self) -> u32 {
        self.bytes_dropped.load(Ordering::Relaxed)
    }
}

/// Queue of packets from the encoder to the bus.
pub struct Outgoing {
    slots: [Slot; QUEUE_PACKETS],
    /// Packets put and taken so far; these wrap.
    put: AtomicU32,
    taken: AtomicU32,
    shared: Shared,
}

impl Outgoing {
    /// Returns an empty queue.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(QUEUE_PACKETS.is_power_of_two()) };
        Self {
            slots: [const { Slot::empty() }; QUEUE_PACKETS],
            put: AtomicU32::new(0),
            taken: AtomicU32::new(0),
            shared: Shared {
                listening: AtomicBool::new(false),
                session: AtomicU32::new(0),
                messages_dropped: AtomicU32::new(0),
                bytes_dropped: AtomicU32::new(0),
            },
        }
    }

    /// Returns the encoder's end and the bus's end, the latter for [`crate::Device::new`].
    pub fn split(&mut self) -> (Sender<'_>, Fetcher<'_>) {
        let queue = &*self;
        (Sender { queue, session: 0 }, Fetcher { queue })
    }

    fn free(&self) -> usize {
        let put = self.put.load(Ordering::Acquire);
        let len = put.wrapping_sub(self.taken.load(Ordering::Acquire)) as usize;
        QUEUE_PACKETS.saturating_sub(len)
    }

    fn slot(&self, count: u32) -> Option<&Slot> {
        self.slots.get(count as usize % QUEUE_PACKETS)
    }
}

impl Default for Outgoing {
    fn default() -> Self {
        Self::new()
    }
}

/// The encoder's end of the queue.
pub struct Sender<'q> {
    queue: &'q Outgoing,
    /// Session that its messages belong to.
    session: u32,
}

impl Sender<'_> {
    /// Makes later messages belong to the host's current session. Between the start of a session and this call
    /// messages are dropped, as they answer a host that is gone.
    pub fn follow(&mut self) {
        self.session = self.queue.shared.session();
    }

    /// Returns whether a host would receive what is sent.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        let shared = &self.queue.shared;
        shared.is_listening() && shared.session() == self.session
    }

    /// Returns whether a message of `bytes` bytes can be queued without waiting.
    #[must_use]
    pub fn has_room(&self, bytes: usize) -> bool {
        bytes / PACKET_BYTES < self.queue.free()
    }

    /// Queues a message. While the queue is full it calls `wait`, until there is room.
    ///
    /// Returns `false`, and counts the rest as dropped, if nobody listens, if the session ends, or if `wait`
    /// returns `false`. An empty message queues nothing.
    pub fn send(&mut self, message: &[u8], mut wait: impl FnMut() -> bool) -> bool {
        let mut rest = message;
        while !message.is_empty() {
            let (bytes, after) = rest.split_at_checked(PACKET_BYTES).unwrap_or((rest, &[]));
            while self.is_heard() && self.queue.free() == 0 {
                if !wait() {
                    return self.drop_message(rest);
                }
            }
            if !self.is_heard() {
                return self.drop_message(rest);
            }
            self.put(bytes);
            if bytes.len() < PACKET_BYTES {
                break;
            }
            rest = after;
        }
        true
    }

    /// Queues a packet; there has to be room for it.
    fn put(&mut self, bytes: &[u8]) {
        let put = self.queue.put.load(Ordering::Relaxed);
        if let Some(slot) = self.queue.slot(put) {
            slot.write(self.session, bytes);
        }
        self.queue.put.store(put.wrapping_add(1), Ordering::Release);
    }

    fn drop_message(&self, rest: &[u8]) -> bool {
        let shared = &self.queue.shared;
        add(&shared.messages_dropped, 1);
        add(&shared.bytes_dropped, rest.len());
        false
    }
}

/// The bus's end of the queue.
pub struct Fetcher<'q> {
    queue: &'q Outgoing,
}

impl<'q> Fetcher<'q> {
    pub(crate) fn shared(&self) -> &'q Shared {
        &self.queue.shared
    }

    /// Returns a copy of the oldest packet.
    pub(crate) fn peek(&self) -> Option<Packet> {
        if self.queue.free() == QUEUE_PACKETS {
            return None;
        }
        let taken = self.queue.taken.load(Ordering::Relaxed);
        self.queue.slot(taken).map(Slot::read)
    }

    /// Removes the packet that [`Fetcher::peek`] returns.
    pub(crate) fn take(&mut self) {
        if self.queue.free() < QUEUE_PACKETS {
            let taken = self.queue.taken.load(Ordering::Relaxed);
            let taken = taken.wrapping_add(1);
            self.queue.taken.store(taken, Ordering::Release);
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    fn lens(fetcher: &mut Fetcher<'_>) -> Vec<usize> {
        let next = || {
            let packet = fetcher.peek()?;
            fetcher.take();
            Some(packet.bytes().len())
        };
        core::iter::from_fn(next).collect()
    }

    #[test]
    fn messages_end_with_a_packet_that_is_not_full() {
        let mut outgoing = Outgoing::new();
        let (mut sender, mut fetcher) = outgoing.split();
        fetcher.shared().listen(true);
        for (bytes, packets) in [
            (0, &[][..]),
            (1, &[1]),
            (63, &[63]),
            (64, &[64, 0]),
            (65, &[64, 1]),
            (128, &[64, 64, 0]),
            (447, &[64, 64, 64, 64, 64, 64, 63]),
        ] {
            assert!(sender.has_room(bytes));
            assert!(sender.send(&[7; 448][..bytes], || false));
            assert_eq!(lens(&mut fetcher), packets, "{bytes}");
        }
        assert!(sender.has_room(QUEUE_PACKETS * PACKET_BYTES - 1));
        assert!(!sender.has_room(QUEUE_PACKETS * PACKET_BYTES));
        assert_eq!(fetcher.shared().bytes_dropped(), 0);
    }

    #[test]
    fn bytes_come_as_they_went() {
        let mut outgoing = Outgoing::new();
        let (mut sender, mut fetcher) = outgoing.split();
        fetcher.shared().listen(true);
        for len in 1..200 {
            let message: Vec<u8> = (0..len).map(|at| at ^ len).collect();
            assert!(sender.send(&message, || false));
            let mut received = Vec::new();
            while let Some(packet) = fetcher.peek() {
                assert!(packet.is_of(0));
                received.extend_from_slice(packet.bytes());
                fetcher.take();
            }
            assert_eq!(received, message);
        }
    }

    #[test]
    fn what_nobody_hears_is_counted() {
        const FULL: usize = QUEUE_PACKETS * PACKET_BYTES;
        let mut outgoing = Outgoing::new();
        let (mut sender, mut fetcher) = outgoing.split();
        assert!(!sender.send(&[1; 10], || true));
        let shared = fetcher.shared();
        shared.listen(true);
        assert!(!sender.send(&[2; FULL + 8], || false));
        assert_eq!(shared.messages_dropped(), 2);
        assert_eq!(shared.bytes_dropped(), 10 + 8);
        assert_eq!(lens(&mut fetcher), [64; QUEUE_PACKETS]);
        // The session ends while the sender waits.
        let sent = sender.send(&[3; FULL + 8], || {
            shared.begin_session();
            true
        });
        assert!(!sent && !sender.is_heard());
        assert_eq!(shared.messages_dropped(), 3);
        assert_eq!(shared.bytes_dropped(), 10 + 8 + 8);
        sender.follow();
        assert!(sender.is_heard());
    }

    #[test]
    fn both_ends_may_run_at_once() {
        let mut outgoing = Outgoing::new();
        let (mut sender, mut fetcher) = outgoing.split();
        fetcher.shared().listen(true);
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for seed in 0..2000_u32 {
                    let message = [seed as u8; 150];
                    let len = seed as usize % 150 + 1;
                    assert!(sender.send(&message[..len], || {
                        std::thread::yield_now();
                        true
                    }));
                }
            });
            for seed in 0..2000_u32 {
                let mut len = 0;
                loop {
                    let Some(packet) = fetcher.peek() else {
                        std::thread::yield_now();
                        continue;
                    };
                    fetcher.take();
                    assert!(packet.bytes().iter().all(|byte| *byte == seed as u8));
                    len += packet.bytes().len();
                    if packet.ends() {
                        break;
                    }
                }
                assert_eq!(len, seed as usize % 150 + 1);
            }
        });
    }
}
