//! The queue of messages for one subscription.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::PublisherId;

/// A bounded queue of messages: when it is full, the oldest are dropped.
pub struct Queue {
    depth: usize,
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Default)]
struct Waiting {
    messages: VecDeque<(Arc<[u8]>, PublisherId)>,
    closed: bool,
}

/// Locks a mutex. Poisoning is ignored: a panic while it is locked leaves the contents consistent.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Queue {
    /// Creates an empty queue for `depth` messages, at least one.
    pub fn new(depth: usize) -> Self {
        Self {
            depth: depth.max(1),
            waiting: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Adds a message; returns false if the queue is closed.
    pub fn push(&self, message: Arc<[u8]>, publisher: PublisherId) -> bool {
        let mut waiting = lock(&self.waiting);
        while waiting.messages.len() >= self.depth {
            waiting.messages.pop_front();
        }
        waiting.messages.push_back((message, publisher));
        self.changed.notify_one();
        !waiting.closed
    }

    /// Returns the oldest message, or the first that arrives within `wait`, and its publisher.
    pub fn take(&self, wait: Duration) -> Option<(Vec<u8>, PublisherId)> {
        let until = Instant::now() + wait;
        let mut waiting = lock(&self.waiting);
        loop {
            if let Some((message, publisher)) = waiting.messages.pop_front() {
                return Some((message.to_vec(), publisher));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            (waiting, _) = self
                .changed
                .wait_timeout(waiting, left)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Closes the queue: nothing takes messages from it any more.
    pub fn close(&self) {
        lock(&self.waiting).closed = true;
    }
}
