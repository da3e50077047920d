//! What waits for one subscription.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Messages that wait; beyond a depth, the oldest are let go of.
pub struct Queue {
    depth: usize,
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Default)]
struct Waiting {
    messages: VecDeque<Arc<[u8]>>,
    closed: bool,
}

/// Whoever panicked while something was locked has left it whole.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Queue {
    /// Nothing waits.
    pub fn new(depth: usize) -> Self {
        Self {
            depth: depth.max(1),
            waiting: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Adds a message; whether anyone is still to take it.
    pub fn push(&self, message: Arc<[u8]>) -> bool {
        let mut waiting = lock(&self.waiting);
        while waiting.messages.len() >= self.depth {
            waiting.messages.pop_front();
        }
        waiting.messages.push_back(message);
        self.changed.notify_one();
        !waiting.closed
    }

    /// The oldest message, or the first that comes in time.
    pub fn take(&self, wait: Duration) -> Option<Vec<u8>> {
        let until = Instant::now() + wait;
        let mut waiting = lock(&self.waiting);
        loop {
            if let Some(message) = waiting.messages.pop_front() {
                return Some(message.to_vec());
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

    /// Nobody takes any more.
    pub fn close(&self) {
        lock(&self.waiting).closed = true;
    }
}
