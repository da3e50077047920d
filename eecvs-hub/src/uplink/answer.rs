//! Answers a request, one frame at a time.

use std::collections::VecDeque;
use std::sync::Arc;

use zenoh::query::Query;

use crate::message::{Answer, Range, Stamp};
use crate::store::Store;

/// Approximate limit on the bytes sent in answer to one request.
const ANSWER_BYTES: usize = 512 << 10;

/// A request that is being answered.
pub(super) struct Answering {
    pub(super) query: Query,
    pub(super) receiver: u64,
    pub(super) run: u64,
    pub(super) ranges: VecDeque<Range>,
    pub(super) answer: Answer,
    pub(super) bytes: usize,
}

impl Answering {
    /// Returns the next requested frame that is held, and records those that are not.
    pub(super) fn next(&mut self, store: &mut Store, own_run: u64) -> Option<(Stamp, Arc<[u8]>)> {
        while self.bytes < ANSWER_BYTES {
            let range = self.ranges.front_mut()?;
            // Frames that have not been made yet are not gone.
            let to = match self.run == own_run {
                true => range.to.min(store.next()),
                false => range.to,
            };
            if range.from >= to {
                self.ranges.pop_front();
                continue;
            }
            let held = store.next_held(self.run, range.from).unwrap_or(to).min(to);
            if held > range.from {
                let from = range.from;
                range.from = held;
                self.answer.gone.push(Range { from, to: held });
                continue;
            }
            range.from += 1;
            match store.get(self.run, held) {
                Some(kept) => {
                    self.bytes += kept.frame.len();
                    return Some((kept.stamp, kept.frame));
                }
                // It is held but cannot be read.
                None => self.answer.gone.push(Range {
                    from: held,
                    to: held + 1,
                }),
            }
        }
        None
    }
}
