//! Queues between interrupts and `main`. No operation waits, fails or panics when it is interrupted.

use core::cell::Cell;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use critical_section::Mutex;
use heapless::Deque;

/// Queue of bytes from one interrupt to a less urgent one: one side puts, the other takes. `N` is a power of two.
pub struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes put and taken so far; these wrap.
    put: AtomicU32,
    taken: AtomicU32,
}

impl<const N: usize> Ring<N> {
    /// Returns an empty ring.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            put: AtomicU32::new(0),
            taken: AtomicU32::new(0),
        }
    }

    /// Returns the number of bytes in the ring.
    #[inline]
    #[must_use]
    pub fn len(&self) -> usize {
        let put = self.put.load(Ordering::Acquire);
        put.wrapping_sub(self.taken.load(Ordering::Acquire)) as usize
    }

    /// Returns whether the ring has no bytes.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns whether the ring takes no more bytes.
    #[inline]
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.len() >= N
    }

    /// Puts a byte; called only if the ring is not full.
    #[inline]
    pub fn put(&self, byte: u8) {
        let put = self.put.load(Ordering::Relaxed);
        if let Some(place) = self.bytes.get(put as usize % N) {
            place.store(byte, Ordering::Relaxed);
        }
        self.put.store(put.wrapping_add(1), Ordering::Release);
    }

    /// Returns the place after the byte that was put last.
    #[must_use]
    pub fn end(&self) -> u32 {
        self.put.load(Ordering::Acquire)
    }

    /// Takes the oldest byte if it was put before the place `end`, which must not be before that byte.
    #[inline]
    pub fn take_before(&self, end: u32) -> Option<u8> {
        match self.taken.load(Ordering::Relaxed) == end {
            true => None,
            false => self.take(),
        }
    }

    /// Skips all bytes that were put before the place `end`, if they are still there, and returns how many. For the
    /// taking side.
    pub fn skip_to(&self, end: u32) -> u32 {
        let taken = self.taken.load(Ordering::Relaxed);
        let skipped = end.wrapping_sub(taken);
        // That place has been passed already.
        if skipped as usize > self.len() {
            return 0;
        }
        self.taken.store(end, Ordering::Release);
        skipped
    }

    /// Takes the oldest byte, if there is one.
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

/// Queue of a few items of any other type.
pub struct Queue<T, const N: usize>(Mutex<Cell<Deque<T, N>>>);

impl<T, const N: usize> Queue<T, N> {
    /// Returns an empty queue.
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

    /// Returns whether the queue takes no more items.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.with(|queue| queue.is_full())
    }

    /// Returns whether the queue has no items.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.with(|queue| queue.is_empty())
    }

    /// Puts an item; called only if the queue is not full.
    pub fn put(&self, item: T) {
        // There is room.
        let _ = self.with(|queue| queue.push_back(item));
    }

    /// Takes the oldest item, if there is one.
    pub fn take(&self) -> Option<T> {
        self.with(Deque::pop_front)
    }
}

impl<T, const N: usize> Default for Queue<T, N> {
    fn default() -> Self {
        Self::new()
    }
}
