//! Packs blocks of an output on other threads, and hands them back in the order in which they were given.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle, available_parallelism};

/// Most threads: beyond that, the thread that gives the blocks is the limit.
const THREADS_MAX: usize = 8;

/// What is to be done, and where its outcome goes.
type Job<T> = (Box<dyn FnOnce() -> T + Send>, SyncSender<T>);

/// Threads of one output, as many as there are cores, up to eight. They begin with the first block, so that an output of
/// a single block has none, and end with the output: a process may fork at any other time.
///
/// At most one block more than there are threads is under way.
pub struct Workers<T> {
    jobs: Option<Sender<Job<T>>>,
    threads: Vec<JoinHandle<()>>,
    under_way: VecDeque<Receiver<T>>,
    /// Blocks that may be under way; none where there is one core.
    most: usize,
}

impl<T: Send + 'static> Workers<T> {
    /// Prepares, without a thread.
    pub fn new() -> Self {
        let cores = available_parallelism().map_or(1, usize::from);
        Self::of(if cores == 1 { 0 } else { cores })
    }

    /// Prepares for this number of threads; without any, every block is packed where it is given.
    pub fn of(threads: usize) -> Self {
        let threads = threads.min(THREADS_MAX);
        Self {
            jobs: None,
            threads: Vec::new(),
            under_way: VecDeque::new(),
            most: if threads == 0 { 0 } else { threads + 1 },
        }
    }

    /// Gives a block to be packed, and returns an earlier one, or this one, if one is finished or too many are under way.
    pub fn give(&mut self, pack: impl FnOnce() -> T + Send + 'static) -> Option<T> {
        if self.most == 0 || self.jobs.is_none() && !self.begin() {
            return Some(pack());
        }
        let (outcome, place) = sync_channel(1);
        // The threads end after the sender only.
        let given = self.jobs.as_ref()?.send((Box::new(pack), outcome));
        given.ok()?;
        self.under_way.push_back(place);
        if self.under_way.len() > self.most {
            return self.take();
        }
        let first = self.under_way.front()?.try_recv().ok()?;
        self.under_way.pop_front();
        Some(first)
    }

    /// Waits for the earliest block that is under way; `None` if there is none.
    ///
    /// # Panics
    /// Packing it panicked.
    pub fn take(&mut self) -> Option<T> {
        let place = self.under_way.pop_front()?;
        Some(place.recv().expect("packing a block panicked"))
    }

    /// Starts the threads; returns whether there is one.
    fn begin(&mut self) -> bool {
        let (jobs, queue) = channel::<Job<T>>();
        let queue = Arc::new(Mutex::new(queue));
        for _ in 1..self.most {
            let queue = Arc::clone(&queue);
            let work = move || {
                loop {
                    let next = queue.lock().unwrap_or_else(PoisonError::into_inner).recv();
                    let Ok((pack, outcome)) = next else {
                        return;
                    };
                    // The output may have failed meanwhile.
                    let _ = outcome.send(pack());
                }
            };
            let thread = Builder::new().name("packing".to_owned()).spawn(work);
            self.threads.extend(thread.ok());
        }
        self.jobs = (!self.threads.is_empty()).then_some(jobs);
        // A system that refuses them once is not asked again.
        if self.threads.is_empty() {
            self.most = 0;
        }
        self.jobs.is_some()
    }
}

impl<T> Drop for Workers<T> {
    fn drop(&mut self) {
        self.under_way.clear();
        self.jobs = None;
        for thread in self.threads.drain(..) {
            // Its panic has been noticed where its block was missing.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn blocks_come_back_in_order() {
        for threads in [0, 1, 2, 8, 100] {
            let mut workers = Workers::of(threads);
            let mut got = Vec::new();
            for block in 0..200_u64 {
                // Later ones are sooner ready.
                let pack = move || {
                    std::thread::sleep(Duration::from_micros(if block % 3 == 0 { 300 } else { 0 }));
                    block
                };
                got.extend(workers.give(pack));
                assert!(block as usize + 1 - got.len() <= THREADS_MAX + 1);
            }
            got.extend(std::iter::from_fn(|| workers.take()));
            assert_eq!(got, (0..200).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_output_that_fails_waits_for_no_block() {
        let mut workers = Workers::of(2);
        for block in 0..3 {
            let _ = workers.give(move || block);
        }
        drop(workers);
    }

    #[test]
    #[should_panic(expected = "packing a block panicked")]
    fn a_panic_is_not_lost() {
        let mut workers = Workers::of(1);
        let _ = workers.give(|| panic!("of a block"));
        let _: Option<()> = workers.take();
    }
}
