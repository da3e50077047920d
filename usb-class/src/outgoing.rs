//! Messages to packets: the queue between the encoder and the bus.
//!
//! A message ends with a packet that is not full, an empty one where its last packet would be: so a host's
//! transfer ends where the message does. The queue holds packets, and so never allocates or grows; where
//! it is full the encoder waits, and it is the encoder's rule that says what then becomes of events.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use heapless::spsc::{Consumer, Producer, Queue};

use crate::PACKET_BYTES;

/// One packet in the queue.
#[derive(Debug)]
pub(crate) struct Packet {
    /// Session that it is of, its low bits: the queue is emptied long before they repeat.
    session: u8,
    len: u8,
    bytes: [u8; PACKET_BYTES],
}

impl Packet {
    /// `bytes` are at most [`PACKET_BYTES`].
    fn new(session: u32, bytes: &[u8]) -> Self {
        let mut packet = Self {
            session: session as u8,
            len: 0,
            bytes: [0; PACKET_BYTES],
        };
        for (to, from) in packet.bytes.iter_mut().zip(bytes) {
            *to = *from;
            packet.len += 1;
        }
        packet
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }

    /// Whether a message ends with it.
    pub(crate) const fn ends(&self) -> bool {
        (self.len as usize) < PACKET_BYTES
    }

    pub(crate) const fn is_of(&self, session: u32) -> bool {
        self.session == session as u8
    }
}

/// What both sides know.
#[derive(Debug)]
pub(crate) struct Shared {
    /// Written by the bus's side.
    listening: AtomicBool,
    session: AtomicU32,
    /// Written by the sender's side.
    messages_dropped: AtomicU32,
    bytes_dropped: AtomicU32,
}

/// Of a number that one side writes and the other reads.
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

/// The queue; it holds `N - 1` packets.
#[derive(Debug)]
pub struct Outgoing<const N: usize> {
    queue: Queue<Packet, N>,
    shared: Shared,
}

impl<const N: usize> Outgoing<N> {
    /// An empty queue.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            queue: Queue::new(),
            shared: Shared {
                listening: AtomicBool::new(false),
                session: AtomicU32::new(0),
                messages_dropped: AtomicU32::new(0),
                bytes_dropped: AtomicU32::new(0),
            },
        }
    }

    /// The encoder's end and the bus's, for [`crate::Device::new`].
    pub fn split(&mut self) -> (Sender<'_>, Fetcher<'_>) {
        let (producer, consumer) = self.queue.split();
        let shared = &self.shared;
        let sender = Sender {
            producer,
            shared,
            session: 0,
        };
        (sender, Fetcher { consumer, shared })
    }
}

impl<const N: usize> Default for Outgoing<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// The encoder's end.
pub struct Sender<'q> {
    producer: Producer<'q, Packet>,
    shared: &'q Shared,
    /// The one that messages are of.
    session: u32,
}

impl Sender<'_> {
    /// What is sent from now on is of the host's session as it is now. Until the call after the begin of a
    /// session, messages are dropped: they answer a host that is gone.
    pub fn follow(&mut self) {
        self.session = self.shared.session();
    }

    /// Whether a host listens to what would be sent.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        self.shared.is_listening() && self.shared.session() == self.session
    }

    /// Whether a message of `bytes` can be queued without waiting.
    #[must_use]
    pub fn has_room(&self, bytes: usize) -> bool {
        let free = self.producer.capacity() - self.producer.len();
        bytes / PACKET_BYTES < free
    }

    /// Queues a message; calls `wait` where the queue is full, until there is room.
    ///
    /// Returns `false`, and counts the rest as dropped, where nobody listens, the session ends, or `wait`
    /// says `false`. An empty message is none.
    pub fn send(&mut self, message: &[u8], mut wait: impl FnMut() -> bool) -> bool {
        let mut rest = message;
        while !message.is_empty() {
            let (bytes, after) = rest.split_at_checked(PACKET_BYTES).unwrap_or((rest, &[]));
            while self.is_heard() && !self.producer.ready() {
                if !wait() {
                    return self.drop_message(rest);
                }
            }
            let packet = Packet::new(self.session, bytes);
            if !self.is_heard() || self.producer.enqueue(packet).is_err() {
                return self.drop_message(rest);
            }
            if bytes.len() < PACKET_BYTES {
                break;
            }
            rest = after;
        }
        true
    }

    fn drop_message(&self, rest: &[u8]) -> bool {
        add(&self.shared.messages_dropped, 1);
        add(&self.shared.bytes_dropped, rest.len());
        false
    }
}

/// The bus's end.
pub struct Fetcher<'q> {
    pub(crate) consumer: Consumer<'q, Packet>,
    pub(crate) shared: &'q Shared,
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    fn lens(fetcher: &mut Fetcher<'_>) -> Vec<usize> {
        core::iter::from_fn(|| fetcher.consumer.dequeue())
            .map(|packet| packet.bytes().len())
            .collect()
    }

    #[test]
    fn messages_end_with_a_packet_that_is_not_full() {
        let mut outgoing = Outgoing::<8>::new();
        let (mut sender, mut fetcher) = outgoing.split();
        fetcher.shared.listen(true);
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
        assert!(!sender.has_room(448));
        assert_eq!(fetcher.shared.bytes_dropped(), 0);
    }

    #[test]
    fn what_nobody_hears_is_counted() {
        let mut outgoing = Outgoing::<4>::new();
        let (mut sender, mut fetcher) = outgoing.split();
        assert!(!sender.send(&[1; 10], || true));
        fetcher.shared.listen(true);
        // Three packets fit.
        assert!(!sender.send(&[2; 200], || false));
        assert_eq!(fetcher.shared.messages_dropped(), 2);
        assert_eq!(fetcher.shared.bytes_dropped(), 10 + 200 - 192);
        assert_eq!(lens(&mut fetcher), [64, 64, 64]);
        // The session ends while the sender waits.
        let shared = fetcher.shared;
        let sent = sender.send(&[3; 200], || {
            shared.begin_session();
            true
        });
        assert!(!sent && !sender.is_heard());
        assert_eq!(shared.messages_dropped(), 3);
        assert_eq!(shared.bytes_dropped(), 10 + 8 + 8);
        sender.follow();
        assert!(sender.is_heard());
    }
}
