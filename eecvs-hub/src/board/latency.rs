//! Latencies of frames over the last ten seconds, in bounded memory.

use std::time::Duration;

use serde::Serialize;

/// Duration of a slot of samples, in seconds.
const SLOT_S: u64 = 2;

/// Number of slots: ten seconds, and the slot that is being filled.
const SLOTS: usize = 6;

/// Maximum number of samples in a slot.
const SAMPLES_MAX: usize = 128;

/// Latencies of frames that arrived in order, in microseconds, without the difference between the clocks. A negative
/// one is one of 0, within the error of that difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Latency {
    /// Median.
    pub p50_us: i64,
    /// 99th percentile.
    pub p99_us: i64,
}

#[derive(Debug, Clone, Default)]
struct Slot {
    number: u64,
    samples: Vec<i64>,
    /// One frame in this many is sampled.
    stride: u64,
    seen: u64,
}

/// Samples of the latencies of frames: all of them while they are few, otherwise evenly spaced ones. Times are
/// relative to any fixed moment.
#[derive(Debug, Clone, Default)]
pub struct Latencies {
    slots: [Slot; SLOTS],
}

impl Latencies {
    /// Adds the latency of a frame that arrived at `at`.
    pub fn add(&mut self, at: Duration, latency_us: i64) {
        let number = at.as_secs() / SLOT_S;
        let slot = &mut self.slots[(number % SLOTS as u64) as usize];
        if slot.number != number || slot.stride == 0 {
            let mut samples = std::mem::take(&mut slot.samples);
            samples.clear();
            *slot = Slot {
                number,
                samples,
                stride: 1,
                seen: 0,
            };
        }
        if slot.seen.is_multiple_of(slot.stride) {
            if slot.samples.len() == SAMPLES_MAX {
                let mut index = 0;
                slot.samples.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                slot.stride *= 2;
            }
            // Also if the stride has just doubled: the number of frames seen is a multiple of the new one too.
            slot.samples.push(latency_us);
        }
        slot.seen += 1;
    }

    /// Returns the latencies of the last ten seconds before `at`; `None` if no frame arrived.
    #[must_use]
    pub fn over(&self, at: Duration) -> Option<Latency> {
        let now = at.as_secs() / SLOT_S;
        let mut all: Vec<(i64, u64)> = self
            .slots
            .iter()
            .filter(|slot| slot.stride > 0 && slot.number + (SLOTS as u64) > now)
            .flat_map(|slot| slot.samples.iter().map(|sample| (*sample, slot.stride)))
            .collect();
        all.sort_unstable();
        // A sample represents as many frames as its stride.
        let frames: u64 = all.iter().map(|(_, weight)| weight).sum();
        let at_share = |hundredths: u64| {
            let wanted = (frames * hundredths).div_ceil(100);
            let mut before = 0;
            all.iter()
                .find(|(_, weight)| {
                    before += weight;
                    before >= wanted
                })
                .map(|(sample, _)| *sample)
        };
        Some(Latency {
            p50_us: at_share(50)?,
            p99_us: at_share(99)?,
        })
    }
}
