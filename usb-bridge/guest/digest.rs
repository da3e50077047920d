//! A digest of a stream's events in a few numbers, which the host's side passes to the guest's.

use std::str::FromStr;

use anyhow::{Context as _, Error, Result, ensure};
use eecvs_nostd::Event;

/// Number of events, a sum over them that does not depend on their order, and a hash that does.
///
/// For an event e, m(e) mixes all its bits:
///
/// ```text
/// sum   = sum of m(e_i)                      modulo 2^64
/// chain = (... (m(e_0) * K + m(e_1)) * K ...) modulo 2^64, K odd
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Digest {
    /// Number of events.
    pub events: u64,
    sum: u64,
    chain: u64,
    latest_us: u64,
    runs_back: bool,
}

impl Digest {
    /// Adds events to the digest.
    pub fn take(&mut self, events: &[Event]) {
        for event in events {
            let place = u64::from(event.x) << 33 | u64::from(event.y) << 1 | event.polarity as u64;
            let mixed = (event.t_us ^ place.wrapping_mul(0x9E37_79B9_7F4A_7C15))
                .wrapping_mul(0xD6E8_FEB8_6659_FD93);
            let mixed = mixed ^ mixed >> 32;
            self.sum = self.sum.wrapping_add(mixed);
            self.chain = self
                .chain
                .wrapping_mul(0xA076_1D64_78BD_642F)
                .wrapping_add(mixed);
            self.runs_back |= event.t_us < self.latest_us;
            self.latest_us = event.t_us;
        }
        self.events += events.len() as u64;
    }

    /// Formats the digest for the command line: `EVENTS,SUM,CHAIN`.
    pub fn words(&self) -> String {
        format!("{},{},{}", self.events, self.sum, self.chain)
    }

    /// Checks that these are the events of `sent` and that their times do not run back; with `keeps_order`, also
    /// that their order is the same.
    ///
    /// # Errors
    /// They differ; the message says how.
    pub fn require(&self, sent: &Self, keeps_order: bool) -> Result<()> {
        ensure!(
            self.events == sent.events,
            "{} events arrived, {} were sent",
            self.events,
            sent.events
        );
        ensure!(self.sum == sent.sum, "events arrived changed");
        ensure!(!self.runs_back, "times run backwards");
        ensure!(
            !keeps_order || self.chain == sent.chain,
            "events arrived in another order"
        );
        Ok(())
    }
}

impl FromStr for Digest {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers: Result<Vec<u64>, _> = text.split(',').map(str::parse).collect();
        let numbers = numbers.with_context(|| text.to_owned())?;
        let [events, sum, chain] = numbers[..] else {
            anyhow::bail!("{text}: expected EVENTS,SUM,CHAIN");
        };
        Ok(Self {
            events,
            sum,
            chain,
            ..Self::default()
        })
    }
}
