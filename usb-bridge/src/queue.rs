//! A queue between two threads, bounded in bytes.
//!
//! The sender chooses how long it waits: [`Queue::offer`] refuses an item that does not fit, [`Queue::force`] makes
//! room by dropping the oldest items, and [`Queue::wait`] waits for room. All three return what was not kept, so
//! that it can be counted.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// An item with a size.
pub trait Weigh {
    /// Returns the number of bytes that the item takes of the queue's limit.
    fn weight(&self) -> usize;
}

/// What [`Queue::take`] found.
#[derive(Debug, PartialEq, Eq)]
pub enum Taken<T> {
    /// The oldest item.
    Item(T),
    /// Nothing arrived in time.
    Nothing,
    /// The queue is closed and empty.
    Closed,
}

/// Current and peak fill of a queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fill {
    /// Bytes in the queue.
    pub bytes: usize,
    /// Most bytes that were ever in the queue; never above its limit.
    pub peak_bytes: usize,
}

struct State<T> {
    items: VecDeque<T>,
    fill: Fill,
    closed: bool,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    changed: Condvar,
    limit_bytes: usize,
}

/// A handle to a queue; clones refer to the same queue.
pub struct Queue<T>(Arc<Shared<T>>);

impl<T> Clone for Queue<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T: Weigh> Queue<T> {
    /// Creates an empty queue of at most `limit_bytes` bytes.
    #[must_use]
    pub fn new(limit_bytes: usize) -> Self {
        Self(Arc::new(Shared {
            state: Mutex::new(State {
                items: VecDeque::new(),
                fill: Fill {
                    bytes: 0,
                    peak_bytes: 0,
                },
                closed: false,
            }),
            changed: Condvar::new(),
            limit_bytes,
        }))
    }

    /// Locks the state. A poisoned lock is safe to use: no code that runs under it can panic halfway through a
    /// change.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, state: &mut State<T>, item: T) {
        state.fill.bytes += item.weight();
        state.fill.peak_bytes = state.fill.peak_bytes.max(state.fill.bytes);
        state.items.push_back(item);
        self.0.changed.notify_all();
    }

    fn has_room(&self, state: &State<T>, item: &T) -> bool {
        let free = self.0.limit_bytes.saturating_sub(state.fill.bytes);
        !state.closed && item.weight() <= free
    }

    /// Appends an item if there is room for it now.
    ///
    /// # Errors
    /// Returns the item if the queue is full or closed.
    pub fn offer(&self, item: T) -> Result<(), T> {
        let mut state = self.lock();
        if !self.has_room(&state, &item) {
            return Err(item);
        }
        self.put(&mut state, item);
        Ok(())
    }

    /// Appends an item, dropping the oldest items until there is room. Returns the dropped items; this is `item`
    /// itself if it is larger than the whole queue or the queue is closed.
    pub fn force(&self, item: T) -> Vec<T> {
        let mut state = self.lock();
        let mut gone = Vec::new();
        if state.closed || item.weight() > self.0.limit_bytes {
            gone.push(item);
            return gone;
        }
        while !self.has_room(&state, &item) {
            let Some(oldest) = state.items.pop_front() else {
                break;
            };
            state.fill.bytes -= oldest.weight();
            gone.push(oldest);
        }
        self.put(&mut state, item);
        gone
    }

    /// Appends an item, waiting for room while `goes_on` returns true. An item larger than the queue is not waited
    /// for.
    ///
    /// # Errors
    /// Returns the item if the wait was given up, the queue was closed or the item can never fit.
    pub fn wait(&self, item: T, goes_on: impl Fn() -> bool) -> Result<(), T> {
        let mut state = self.lock();
        while !self.has_room(&state, &item) {
            if state.closed || item.weight() > self.0.limit_bytes || !goes_on() {
                return Err(item);
            }
            (state, _) = self
                .0
                .changed
                .wait_timeout(state, Duration::from_millis(50))
                .unwrap_or_else(PoisonError::into_inner);
        }
        self.put(&mut state, item);
        Ok(())
    }

    /// Takes the oldest item, waiting for one for at most `timeout`.
    pub fn take(&self, timeout: Duration) -> Taken<T> {
        let until = Instant::now() + timeout;
        let mut state = self.lock();
        loop {
            if let Some(item) = state.items.pop_front() {
                state.fill.bytes -= item.weight();
                self.0.changed.notify_all();
                return Taken::Item(item);
            }
            if state.closed {
                return Taken::Closed;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Taken::Nothing;
            }
            (state, _) = self
                .0
                .changed
                .wait_timeout(state, left)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Closes the queue: nothing more can be appended, but what is queued can still be taken.
    pub fn close(&self) {
        self.lock().closed = true;
        self.0.changed.notify_all();
    }

    /// Closes the queue and returns everything left in it.
    pub fn abandon(&self) -> Vec<T> {
        let mut state = self.lock();
        state.closed = true;
        state.fill.bytes = 0;
        self.0.changed.notify_all();
        state.items.drain(..).collect()
    }

    /// Returns the current and the peak fill.
    #[must_use]
    pub fn fill(&self) -> Fill {
        self.lock().fill
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    struct Item(usize, usize);

    impl Weigh for Item {
        fn weight(&self) -> usize {
            self.1
        }
    }

    proptest! {
        /// Every item is taken or returned, the order is kept and the limit holds.
        #[test]
        fn every_item_is_taken_or_returned(
            limit in 0..100_usize,
            steps in proptest::collection::vec((0..4_u8, 0..60_usize), 0..200),
        ) {
            let queue = Queue::new(limit);
            let mut waiting = VecDeque::new();
            for (number, (step, weight)) in steps.into_iter().enumerate() {
                let item = Item(number, weight);
                let bytes = |waiting: &VecDeque<Item>| waiting.iter().map(|item| item.1).sum::<usize>();
                match step {
                    0 => {
                        let fits = bytes(&waiting) + weight <= limit;
                        prop_assert_eq!(queue.offer(item).is_ok(), fits);
                        if fits {
                            waiting.push_back(item);
                        }
                    }
                    1 => {
                        let gone = queue.force(item);
                        if weight > limit {
                            prop_assert_eq!(gone, vec![item]);
                        } else {
                            waiting.push_back(item);
                            let kept = waiting.split_off(gone.len());
                            prop_assert_eq!(gone, Vec::from(waiting));
                            waiting = kept;
                        }
                    }
                    _ => {
                        let taken = queue.take(Duration::ZERO);
                        let expected = waiting.pop_front().map_or(Taken::Nothing, Taken::Item);
                        prop_assert_eq!(taken, expected);
                    }
                }
                prop_assert_eq!(queue.fill().bytes, bytes(&waiting));
                prop_assert!(queue.fill().peak_bytes <= limit);
            }
            queue.close();
            prop_assert_eq!(queue.offer(Item(0, 0)), Err(Item(0, 0)));
            prop_assert_eq!(queue.abandon(), Vec::from(waiting));
            prop_assert_eq!(queue.take(Duration::ZERO), Taken::Closed);
        }
    }

    #[test]
    fn a_full_queue_is_waited_for_until_it_is_given_up() {
        let queue = Queue::new(10);
        assert_eq!(queue.wait(Item(0, 8), || true), Ok(()));
        assert_eq!(queue.wait(Item(1, 8), || false), Err(Item(1, 8)));
        assert_eq!(queue.wait(Item(1, 11), || true), Err(Item(1, 11)));
        let other = queue.clone();
        let waiting = std::thread::spawn(move || other.wait(Item(2, 8), || true));
        assert_eq!(queue.take(Duration::from_secs(5)), Taken::Item(Item(0, 8)));
        assert_eq!(waiting.join().unwrap(), Ok(()));
        assert_eq!(queue.take(Duration::ZERO), Taken::Item(Item(2, 8)));
    }
}
