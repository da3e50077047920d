//! What interrupts and `main` share. No operation waits, fails or panics for being interrupted.

use core::cell::Cell;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use critical_section::Mutex;
use heapless::Deque;

/// Bytes from one interrupt to a less urgent one: one side puts, the other takes. `N` is a power
/// of two.
pub struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes put and taken so far; wrap.
    put: AtomicU32,
    taken: AtomicU32,
}

impl<const N: usize> Ring<N> {
    /// An empty ring.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            put: AtomicU32::new(0),
            taken: AtomicU32::new(0),
        }
    }

    /// Bytes in it.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        let put = self.put.load(Ordering::Acquire);
        put.wrapping_sub(self.taken.load(Ordering::Acquire)) as usize
    }

    /// Whether there is none.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether it takes no more.
    #[inline]
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.len() >= N
    }

    /// Puts a byte, asked only where the ring is not full.
    #[inline]
    pub fn put(&self, byte: u8) {
        let put = self.put.load(Ordering::Relaxed);
        if let Some(place) = self.bytes.get(put as usize % N) {
            place.store(byte, Ordering::Relaxed);
        }
        self.put.store(put.wrapping_add(1), Ordering::Release);
    }

    /// The place behind the byte that was put last.
    #[must_use]
    pub fn end(&self) -> u32 {
        self.put.load(Ordering::Acquire)
    }

    /// Takes the oldest byte, where it was put before the place `end`, which is not before that byte.
    #[inline]
    pub fn take_before(&self, end: u32) -> Option<u8> {
        match self.taken.load(Ordering::Relaxed) == end {
            true => None,
            false => self.take(),
        }
    }

    /// Leaves all bytes out that were put before the place `end`, as far as they are there; returns how
    /// many. The taking side's.
    pub fn skip_to(&self, end: u32) -> u32 {
        let taken = self.taken.load(Ordering::Relaxed);
        let skipped = end.wrapping_sub(taken);
        // Behind it already.
        if skipped as usize > self.len() {
            return 0;
        }
        self.taken.store(end, Ordering::Release);
        skipped
    }

    /// Takes the oldest byte.
    #[inline]
    pub fn take(&self) -> Option<u8> {
        if self.is_empty() {
            return None;
        }
        let taken = self.taken.load(Ordering::Relaxed);
        let byte = self.bytes.get(taken as usize % N)?.load(Ordering::Relaxed);
        self.taken.store(taken.wrapping_add(1), Ordering::Release);
        Some(byte)
    }
}

impl<const N: usize> Default for Ring<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Anything else, a few at a time.
pub struct Queue<T, const N: usize>(Mutex<Cell<Deque<T, N>>>);

impl<T, const N: usize> Queue<T, N> {
    /// An empty queue.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(Cell::new(Deque::new())))
    }

    fn with<R>(&self, act: impl FnOnce(&mut Deque<T, N>) -> R) -> R {
        critical_section::with(|token| {
            let cell = self.0.borrow(token);
            let mut queue = cell.take();
            let result = act(&mut queue);
            cell.set(queue);
            result
        })
    }

    /// Whether it takes no more.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.with(|queue| queue.is_full())
    }

    /// Whether there is nothing in it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.with(|queue| queue.is_empty())
    }

    /// Puts an item; asked only where the queue is not full.
    pub fn put(&self, item: T) {
        // There is room.
        let _ = self.with(|queue| queue.push_back(item));
    }

    /// Takes the oldest item.
    pub fn take(&self) -> Option<T> {
        self.with(Deque::pop_front)
    }
}

impl<T, const N: usize> Default for Queue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}
