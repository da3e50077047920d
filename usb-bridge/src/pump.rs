//! The thread that empties a link, so that slow processing never holds up a device.
//!
//! A camera's own buffer is small: if the host reads its link late, the camera loses events without counting them.
//! One thread therefore does nothing but read. Chunks for which the queue has no room are dropped here, where they
//! are counted and the parser is informed of the loss.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use crate::link::{Link, LinkError, Loss, Received};
use crate::queue::{Queue, Weigh};

/// Longest wait for one receive.
const WAIT: Duration = Duration::from_millis(50);
/// After the device was stopped, silence of this length means that everything has arrived.
const QUIET: Duration = Duration::from_millis(200);
/// Longest time that a device which keeps sending after it was stopped is read.
const DRAIN_MAX: Duration = Duration::from_secs(2);
/// Number of buffers kept for reuse.
const SPARE: usize = 64;

/// Consecutive bytes of a link.
#[derive(Debug)]
pub struct Chunk {
    /// Bytes of one transfer.
    pub bytes: Vec<u8>,
    /// When the last of them arrived.
    pub at: Instant,
    /// Whether bytes before these are missing.
    pub after_loss: bool,
}

impl Weigh for Chunk {
    fn weight(&self) -> usize {
        // The capacity may exceed the length.
        self.bytes.capacity()
    }
}

/// Counts of what arrived over a link and of what was lost.
#[derive(Debug, Default)]
pub struct LinkAccount {
    /// Bytes that arrived.
    bytes: AtomicU64,
    /// Transfers that arrived.
    pub transfers: AtomicU64,
    /// Bytes that arrived but were dropped because the queue was full.
    pub overrun_bytes: AtomicU64,
    /// Transfers that arrived but were dropped because the queue was full.
    pub overrun_transfers: AtomicU64,
    /// Losses that the link reported, by cause: overflow, damaged, stalled, injected.
    losses: [AtomicU64; 4],
}

/// Causes and names of the counters in [`LinkAccount::losses`].
const CAUSES: [(Loss, &str); 4] = [
    (Loss::Overflow, "transfers that overflowed"),
    (Loss::Damaged, "transfers that were damaged"),
    (Loss::Stalled, "halts of the endpoint"),
    (Loss::Injected, "transfers dropped on purpose"),
];

impl LinkAccount {
    fn lose(&self, cause: Loss) {
        let at = CAUSES.iter().position(|(other, _)| *other == cause);
        if let Some(count) = at.and_then(|at| self.losses.get(at)) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns the number of bytes that arrived and of the transfers that carried them.
    #[must_use]
    pub fn arrived(&self) -> (u64, u64) {
        let bytes = self.bytes.load(Ordering::Relaxed);
        (bytes, self.transfers.load(Ordering::Relaxed))
    }

    /// Returns the number of bytes that arrived but were dropped because the queue was full.
    #[must_use]
    pub fn overrun_bytes(&self) -> u64 {
        self.overrun_bytes.load(Ordering::Relaxed)
    }

    /// Returns the losses that occurred, by name.
    pub fn losses(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        let names = CAUSES.iter().map(|(_, name)| *name);
        let counts = self.losses.iter().map(|n| n.load(Ordering::Relaxed));
        let overrun = self.overrun_transfers.load(Ordering::Relaxed);
        names
            .zip(counts)
            .chain([("transfers that the queue had no room for", overrun)])
            .filter(|(_, n)| *n > 0)
    }
}

/// State shared between the pump and its consumers.
pub struct Pumped {
    /// Chunks in the order in which they arrived.
    pub queue: Queue<Chunk>,
    /// Counts of what arrived and of what was lost.
    pub account: LinkAccount,
    stopping: AtomicBool,
    ended: AtomicBool,
    failure: Mutex<Option<LinkError>>,
    spare: Mutex<Vec<Vec<u8>>>,
}

impl Pumped {
    /// Ends the pump once the device has been stopped: what it sent before is still received, then the queue
    /// closes.
    pub fn stop(&self) {
        self.stopping.store(true, Ordering::Relaxed);
    }

    /// Returns whether the pump has ended. Queued chunks can still be taken.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        self.ended.load(Ordering::Relaxed)
    }

    /// Returns why the link failed, if it did, and only to the first caller after the queue has closed.
    pub fn failure(&self) -> Option<LinkError> {
        self.failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }

    /// Takes back the buffer of a used chunk.
    pub fn reuse(&self, mut bytes: Vec<u8>) {
        bytes.clear();
        let mut spare = self.spare.lock().unwrap_or_else(PoisonError::into_inner);
        if spare.len() < SPARE {
            spare.push(bytes);
        }
    }

    fn buffer(&self) -> Vec<u8> {
        self.spare
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .pop()
            .unwrap_or_default()
    }

    /// Receives until the stream ends, the link fails, or the device is silent after a stop.
    fn run(&self, link: &mut dyn Link) {
        let mut after_loss = false;
        let mut quiet_since = Instant::now();
        let mut stopped_at = None;
        loop {
            if self.stopping.load(Ordering::Relaxed) {
                let since = *stopped_at.get_or_insert_with(Instant::now);
                quiet_since = quiet_since.max(since);
                if quiet_since.elapsed() > QUIET || since.elapsed() > DRAIN_MAX {
                    break;
                }
            }
            match link.receive(WAIT) {
                Ok(Received::Bytes { bytes, at }) => {
                    quiet_since = Instant::now();
                    self.account
                        .bytes
                        .fetch_add(bytes.len() as u64, Ordering::Relaxed);
                    self.account.transfers.fetch_add(1, Ordering::Relaxed);
                    let mut buffer = self.buffer();
                    buffer.extend_from_slice(bytes);
                    let chunk = Chunk {
                        bytes: buffer,
                        at,
                        after_loss,
                    };
                    match self.queue.offer(chunk) {
                        Ok(()) => after_loss = false,
                        Err(chunk) => {
                            after_loss = true;
                            let lost = chunk.bytes.len() as u64;
                            self.account
                                .overrun_bytes
                                .fetch_add(lost, Ordering::Relaxed);
                            self.account
                                .overrun_transfers
                                .fetch_add(1, Ordering::Relaxed);
                        }
                    }
                }
                Ok(Received::Lost { cause, .. }) => {
                    after_loss = true;
                    self.account.lose(cause);
                }
                Ok(Received::Nothing) => {}
                Ok(Received::Ended) => break,
                Err(error) => {
                    let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
                    *failure = Some(error);
                    break;
                }
            }
        }
        self.queue.close();
        self.ended.store(true, Ordering::Relaxed);
    }
}

/// Handle of the pump's thread; joining it returns the link.
pub type Thread = JoinHandle<Box<dyn Link>>;

/// Starts the thread that pumps a link into a queue of at most `queue_bytes` bytes.
///
/// # Errors
/// The thread cannot be started.
pub fn start(mut link: Box<dyn Link>, queue_bytes: usize) -> Result<(Arc<Pumped>, Thread)> {
    let pumped = Arc::new(Pumped {
        queue: Queue::new(queue_bytes),
        account: LinkAccount::default(),
        stopping: AtomicBool::new(false),
        ended: AtomicBool::new(false),
        failure: Mutex::new(None),
        spare: Mutex::new(Vec::new()),
    });
    let shared = Arc::clone(&pumped);
    let thread = Builder::new()
        .name("pump".to_owned())
        .spawn(move || {
            shared.run(link.as_mut());
            link
        })
        .context("starting the link's thread")?;
    Ok((pumped, thread))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::collections::VecDeque;

    use crate::queue::Taken;

    /// What a scripted link returns next.
    #[derive(Debug, Clone)]
    pub(crate) enum Step {
        Bytes(Vec<u8>),
        Lost(Loss),
        Wait,
        Unplug,
    }

    /// A link that plays a script.
    pub(crate) struct Scripted {
        pub steps: VecDeque<Step>,
        pub current: Vec<u8>,
    }

    impl Scripted {
        pub(crate) fn link(steps: impl IntoIterator<Item = Step>) -> Box<dyn Link> {
            Box::new(Self {
                steps: steps.into_iter().collect(),
                current: Vec::new(),
            })
        }
    }

    impl Link for Scripted {
        fn name(&self) -> &str {
            "script"
        }

        fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
            Ok(match self.steps.pop_front() {
                Some(Step::Bytes(bytes)) => {
                    self.current = bytes;
                    Received::Bytes {
                        bytes: &self.current,
                        at: Instant::now(),
                    }
                }
                Some(Step::Lost(cause)) => Received::Lost { bytes: None, cause },
                Some(Step::Wait) => {
                    std::thread::sleep(timeout.min(Duration::from_millis(2)));
                    Received::Nothing
                }
                Some(Step::Unplug) => {
                    return Err(LinkError::Unplugged {
                        link: "script".to_owned(),
                    });
                }
                None => Received::Ended,
            })
        }

        fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
            Ok(())
        }
    }

    fn chunks(pumped: &Pumped) -> Vec<(Vec<u8>, bool)> {
        let mut chunks = Vec::new();
        while let Taken::Item(chunk) = pumped.queue.take(Duration::from_secs(5)) {
            chunks.push((chunk.bytes, chunk.after_loss));
        }
        chunks
    }

    #[test]
    fn losses_stand_before_the_bytes_that_follow() {
        let link = Scripted::link([
            Step::Bytes(vec![1]),
            Step::Wait,
            Step::Lost(Loss::Damaged),
            Step::Lost(Loss::Overflow),
            Step::Bytes(vec![2, 3]),
            Step::Bytes(vec![4]),
            Step::Unplug,
        ]);
        let (pumped, thread) = start(link, 1 << 10).unwrap();
        thread.join().unwrap();
        assert_eq!(
            chunks(&pumped),
            [(vec![1], false), (vec![2, 3], true), (vec![4], false)]
        );
        assert!(matches!(
            pumped.failure(),
            Some(LinkError::Unplugged { .. })
        ));
        let losses: Vec<_> = pumped.account.losses().collect();
        assert_eq!(
            losses,
            [
                ("transfers that overflowed", 1),
                ("transfers that were damaged", 1)
            ]
        );
    }

    #[test]
    fn what_has_no_room_is_counted_and_marked() {
        let link = Scripted::link([
            Step::Bytes(vec![0; 60]),
            Step::Bytes(vec![1; 60]),
            Step::Bytes(vec![2; 30]),
        ]);
        let (pumped, thread) = start(link, 100).unwrap();
        thread.join().unwrap();
        let met = chunks(&pumped);
        assert_eq!(met, [(vec![0; 60], false), (vec![2; 30], true)]);
        assert_eq!(pumped.account.overrun_bytes.load(Ordering::Relaxed), 60);
        assert_eq!(pumped.account.bytes.load(Ordering::Relaxed), 150);
    }

    #[test]
    fn after_a_stop_what_was_sent_is_still_taken() {
        let waits = std::iter::repeat_n(Step::Wait, 20);
        let steps = waits
            .clone()
            .chain([Step::Bytes(vec![7])])
            .chain(std::iter::repeat_n(Step::Wait, 1 << 20));
        let (pumped, thread) = start(Scripted::link(steps), 100).unwrap();
        pumped.stop();
        thread.join().unwrap();
        assert_eq!(chunks(&pumped), [(vec![7], false)]);
        assert!(pumped.failure().is_none());
    }
}
