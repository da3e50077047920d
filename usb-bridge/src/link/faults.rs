//! Fault injection around any link, reproducible from a seed.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use super::{Link, LinkError, Loss, Received, until};

/// Most pieces that are held back.
const HELD_MAX: usize = 64;

/// Most faults that the log keeps.
const LOG_MAX: usize = 1 << 16;

/// A fault that can happen to a piece of the stream; a piece is what one receive returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Fault {
    /// The piece is lost.
    Drop,
    /// Up to eight of its bytes are changed.
    Corrupt,
    /// The piece arrives twice.
    Duplicate,
    /// The piece arrives after the one that follows it.
    Reorder,
    /// The piece arrives later, and delays the pieces after it.
    Delay,
    /// The piece is split in two.
    Split,
    /// The end of the piece is lost.
    Cut,
}

impl Fault {
    /// All faults, in the order of [`Plan::rates`] and [`Counts::faults`].
    pub const ALL: [Self; 7] = [
        Self::Drop,
        Self::Corrupt,
        Self::Duplicate,
        Self::Reorder,
        Self::Delay,
        Self::Split,
        Self::Cut,
    ];
}

/// Which faults to inject, and how often.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Seed of the random generator: the same seed and pieces give the same faults.
    pub seed: u64,
    /// Probability of each of [`Fault::ALL`] per piece. They are drawn in this order, and the first that occurs is
    /// injected.
    pub rates: [f64; 7],
    /// Whether losses go unreported, as with a device that loses bytes itself; otherwise they are reported as
    /// [`Loss::Injected`].
    pub silent: bool,
    /// The longest delay.
    pub delay_max: Duration,
    /// Number of faults after which no more are injected.
    pub faults_max: u64,
}

impl Plan {
    /// Returns a plan without faults, to which [`Plan::with`] adds some.
    #[must_use]
    pub const fn none(seed: u64) -> Self {
        Self {
            seed,
            rates: [0.0; 7],
            silent: false,
            delay_max: Duration::from_millis(2),
            faults_max: u64::MAX,
        }
    }

    /// Returns a plan with every fault at the same rate.
    #[must_use]
    pub const fn all(seed: u64, rate: f64) -> Self {
        Self {
            rates: [rate; 7],
            ..Self::none(seed)
        }
    }

    /// Sets the rate of one fault.
    #[must_use]
    pub const fn with(mut self, fault: Fault, rate: f64) -> Self {
        self.rates[fault as usize] = rate;
        self
    }
}

/// A fault that was injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Happened {
    /// The kind of fault.
    pub fault: Fault,
    /// Number of bytes delivered before it.
    pub at: u64,
    /// Number of bytes lost.
    pub lost: u64,
}

/// Counts of pieces, bytes and faults so far.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of faults of each kind, in the order of [`Fault::ALL`].
    pub faults: [u64; 7],
    /// Pieces received from the inner link.
    pub pieces: u64,
    /// Bytes received from the inner link.
    pub bytes: u64,
    /// Bytes lost.
    pub bytes_lost: u64,
    /// Number of changes to bytes; one byte may be changed more than once.
    pub bytes_changed: u64,
}

/// A link that injects faults into what it receives; what it sends is passed on unchanged.
pub struct Faults<L> {
    inner: L,
    plan: Plan,
    random: Xoshiro256PlusPlus,
    held: VecDeque<Held>,
    lent: Vec<u8>,
    counts: Counts,
    log: Vec<Happened>,
    given: u64,
    /// A piece held until the next one has overtaken it.
    overtaken: Option<(Vec<u8>, Instant)>,
    /// How the inner link ended, while pieces are still held.
    ended: Option<Result<(), LinkError>>,
}

enum Held {
    Bytes {
        bytes: Vec<u8>,
        at: Instant,
        due: Option<Instant>,
    },
    Lost {
        bytes: Option<u64>,
        cause: Loss,
    },
}

impl<L: Link> Faults<L> {
    /// Wraps `inner` and injects faults according to `plan`.
    pub fn new(inner: L, plan: Plan) -> Self {
        Self {
            random: Xoshiro256PlusPlus::seed_from_u64(plan.seed),
            inner,
            plan,
            held: VecDeque::new(),
            lent: Vec::new(),
            counts: Counts::default(),
            log: Vec::new(),
            given: 0,
            overtaken: None,
            ended: None,
        }
    }

    /// Returns the counts of pieces, bytes and faults so far.
    pub const fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Returns the first 65,536 faults, in order.
    pub fn log(&self) -> &[Happened] {
        &self.log
    }

    fn random_below(&mut self, bound: usize) -> usize {
        // The bias of the remainder does not matter here.
        (self.random.next_u64() % bound.max(1) as u64) as usize
    }

    fn choose(&mut self) -> Option<Fault> {
        if self.counts.faults.iter().sum::<u64>() >= self.plan.faults_max {
            return None;
        }
        Fault::ALL.into_iter().find(|&fault| {
            // 53 bits, the precision of an `f64`.
            let draw = (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
            draw < self.plan.rates[fault as usize]
        })
    }

    fn happened(&mut self, fault: Fault, lost: u64) {
        self.counts.faults[fault as usize] += 1;
        self.counts.bytes_lost += lost;
        if self.log.len() < LOG_MAX {
            let held = self.held.iter().map(|held| match held {
                Held::Bytes { bytes, .. } => bytes.len() as u64,
                Held::Lost { .. } => 0,
            });
            let at = self.given + held.sum::<u64>();
            self.log.push(Happened { fault, at, lost });
        }
    }

    fn hold(&mut self, bytes: Vec<u8>, at: Instant, due: Option<Instant>) {
        if !bytes.is_empty() {
            self.held.push_back(Held::Bytes { bytes, at, due });
        }
    }

    fn lose(&mut self, fault: Fault, bytes: usize) {
        self.happened(fault, bytes as u64);
        if !self.plan.silent {
            self.held.push_back(Held::Lost {
                bytes: Some(bytes as u64),
                cause: Loss::Injected,
            });
        }
    }

    /// Takes a piece from the inner link and injects its fault, if any.
    fn take(&mut self, mut bytes: Vec<u8>, at: Instant) {
        self.counts.pieces += 1;
        self.counts.bytes += bytes.len() as u64;
        let fault = self.choose();
        let overtaken = self.overtaken.take();
        match fault {
            None => self.hold(bytes, at, None),
            Some(Fault::Drop) => self.lose(Fault::Drop, bytes.len()),
            Some(Fault::Corrupt) => {
                self.happened(Fault::Corrupt, 0);
                for _ in 0..=self.random_below(8) {
                    let index = self.random_below(bytes.len());
                    bytes[index] ^= 1 + self.random_below(255) as u8;
                    self.counts.bytes_changed += 1;
                }
                self.hold(bytes, at, None);
            }
            Some(Fault::Duplicate) => {
                self.happened(Fault::Duplicate, 0);
                self.hold(bytes.clone(), at, None);
                self.hold(bytes, at, None);
            }
            Some(Fault::Reorder) if overtaken.is_none() => {
                self.happened(Fault::Reorder, 0);
                self.overtaken = Some((bytes, at));
                return;
            }
            Some(Fault::Reorder) => self.hold(bytes, at, None),
            Some(Fault::Delay) => {
                self.happened(Fault::Delay, 0);
                let most = usize::try_from(self.plan.delay_max.as_micros()).unwrap_or(usize::MAX);
                let delay = self.random_below(most.saturating_add(1)) as u64;
                let due = Instant::now().checked_add(Duration::from_micros(delay));
                self.hold(bytes, at, due);
            }
            Some(Fault::Split) => {
                self.happened(Fault::Split, 0);
                let rest = bytes.split_off(self.random_below(bytes.len()));
                self.hold(bytes, at, None);
                self.hold(rest, at, None);
            }
            Some(Fault::Cut) => {
                let length = self.random_below(bytes.len());
                let lost = bytes.len() - length;
                bytes.truncate(length);
                self.hold(bytes, at, None);
                self.lose(Fault::Cut, lost);
            }
        }
        if let Some((bytes, at)) = overtaken {
            self.hold(bytes, at, None);
        }
    }

    /// Receives from the inner link, waiting for at most `wait`.
    fn fill(&mut self, wait: Duration) {
        let piece = match self.inner.receive(wait) {
            Ok(Received::Bytes { bytes, at }) => Some((bytes.to_vec(), at)),
            Ok(Received::Lost { bytes, cause }) => {
                self.held.push_back(Held::Lost { bytes, cause });
                None
            }
            Ok(Received::Nothing) => None,
            Ok(Received::Ended) => {
                self.ended = Some(Ok(()));
                None
            }
            Err(error) => {
                self.ended = Some(Err(error));
                None
            }
        };
        if let Some((bytes, at)) = piece {
            self.take(bytes, at);
        } else if self.ended.is_some()
            && let Some((bytes, at)) = self.overtaken.take()
        {
            // No piece follows that could overtake it.
            self.hold(bytes, at, None);
        }
    }
}

impl<L: Link> Link for Faults<L> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let deadline = until(timeout);
        loop {
            let now = Instant::now();
            let due = match self.held.front() {
                Some(Held::Bytes { due: Some(due), .. }) if *due > now => Some(*due),
                Some(_) => None,
                None => Some(deadline),
            };
            if due.is_none() {
                match self.held.pop_front() {
                    Some(Held::Bytes { bytes, at, .. }) => {
                        self.given += bytes.len() as u64;
                        self.lent = bytes;
                        return Ok(Received::Bytes {
                            bytes: &self.lent,
                            at,
                        });
                    }
                    Some(Held::Lost { bytes, cause }) => {
                        return Ok(Received::Lost { bytes, cause });
                    }
                    None => {}
                }
            }
            if self.held.is_empty() {
                match self.ended.take() {
                    Some(Ok(())) => {
                        self.ended = Some(Ok(()));
                        return Ok(Received::Ended);
                    }
                    // Returned once; the next receive gets the error from the inner link again.
                    Some(Err(error)) => return Err(error),
                    None => {}
                }
            }
            let wait = due.map_or(deadline, |due| due.min(deadline));
            let left = wait.saturating_duration_since(now);
            if self.ended.is_none() && self.held.len() < HELD_MAX {
                self.fill(left);
            } else {
                std::thread::sleep(left);
            }
            if self.held.is_empty() && self.ended.is_none() && Instant::now() >= deadline {
                return Ok(Received::Nothing);
            }
            let delayed = matches!(
                self.held.front(),
                Some(Held::Bytes { due: Some(due), .. }) if *due > Instant::now()
            );
            if delayed && Instant::now() >= deadline {
                return Ok(Received::Nothing);
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::link::loopback::pair;

    /// Sends `pieces` pieces of 100 equal bytes, numbered from 0; returns the reported losses, the bytes received,
    /// the counts and the log.
    fn run(plan: Plan, pieces: u8) -> (Vec<String>, Vec<u8>, Counts, Vec<Happened>) {
        let (mut near, far) = pair(1 << 20);
        for number in 0..pieces {
            near.send(&[number; 100]).unwrap();
        }
        drop(near);
        let mut link = Faults::new(far, plan);
        let (mut told, mut got) = (Vec::new(), Vec::new());
        loop {
            match link.receive(Duration::from_secs(1)).unwrap() {
                Received::Bytes { bytes, .. } => got.extend_from_slice(bytes),
                Received::Lost { bytes, cause } => told.push(format!("{cause:?} {bytes:?}")),
                Received::Nothing => panic!("nothing"),
                Received::Ended => break,
            }
        }
        (told, got, link.counts().clone(), link.log().to_vec())
    }

    #[test]
    fn without_faults_everything_passes() {
        let (told, got, counts, log) = run(Plan::none(1), 20);
        assert!(told.is_empty() && log.is_empty());
        assert_eq!(got.len(), 2000);
        assert!(got.is_sorted());
        assert_eq!(
            (counts.pieces, counts.bytes, counts.bytes_lost),
            (20, 2000, 0)
        );
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let only = |fault| run(Plan::none(7).with(fault, 1.0), 20);
        let (told, got, counts, _) = only(Fault::Drop);
        assert!(got.is_empty());
        assert_eq!(told, vec!["Injected Some(100)"; 20]);
        assert_eq!((counts.faults[0], counts.bytes_lost), (20, 2000));

        let (_, got, counts, log) = only(Fault::Corrupt);
        let changed = got
            .iter()
            .enumerate()
            .filter(|(i, b)| (i / 100) as u8 != **b);
        // A byte may have been changed back.
        assert!((1..=counts.bytes_changed).contains(&(changed.count() as u64)));
        assert_eq!((got.len(), log.len(), log[3].at), (2000, 20, 300));

        let (_, got, ..) = only(Fault::Duplicate);
        assert_eq!(got.len(), 4000);
        assert!(got.is_sorted());

        let (told, got, ..) = only(Fault::Reorder);
        assert!(told.is_empty() && !got.is_sorted());
        let mut sorted = got;
        sorted.sort_unstable();
        assert_eq!(sorted, run(Plan::none(0), 20).1);

        for fault in [Fault::Delay, Fault::Split] {
            let (_, got, counts, _) = only(fault);
            assert_eq!(got, run(Plan::none(0), 20).1, "{fault:?}");
            assert_eq!(counts.faults[fault as usize], 20);
        }

        let (told, got, counts, _) = only(Fault::Cut);
        assert_eq!(told.len(), 20);
        assert_eq!(got.len() as u64 + counts.bytes_lost, 2000);
    }

    #[test]
    fn a_seed_repeats_its_faults_and_silence_and_their_number_are_kept() {
        let plan = Plan::all(42, 0.1);
        let (told, got, counts, log) = run(plan, 250);
        assert_eq!((told.clone(), got, counts.clone(), log), run(plan, 250));
        assert!(counts.faults.iter().all(|&count| count > 0), "{counts:?}");
        assert_eq!(told.len() as u64, counts.faults[0] + counts.faults[6]);
        let silent = Plan {
            silent: true,
            faults_max: 5,
            ..plan
        };
        let (told, _, counts, _) = run(silent, 250);
        assert!(told.is_empty());
        assert_eq!(counts.faults.iter().sum::<u64>(), 5);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn no_byte_is_unaccounted_for(
            seed: u64,
            rates in prop::array::uniform7(0.0..0.4f64),
            silent: bool,
            pieces in 0..100u8,
        ) {
            let delay_max = Duration::from_micros(50);
            let plan = Plan { rates, silent, delay_max, ..Plan::none(seed) };
            let (told, got, counts, log) = run(plan, pieces);
            prop_assert_eq!(counts.pieces, u64::from(pieces));
            let twice = counts.faults[Fault::Duplicate as usize] * 100;
            prop_assert_eq!(got.len() as u64 + counts.bytes_lost, counts.bytes + twice);
            let losses = counts.faults[Fault::Drop as usize] + counts.faults[Fault::Cut as usize];
            prop_assert_eq!(told.len() as u64, if silent { 0 } else { losses });
            prop_assert_eq!(log.len() as u64, counts.faults.iter().sum::<u64>());
            prop_assert_eq!(log.iter().map(|one| one.lost).sum::<u64>(), counts.bytes_lost);
        }
    }
}
