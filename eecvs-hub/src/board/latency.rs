//! How long frames take, over the last ten seconds, in bounded memory.

use std::time::Duration;

use serde::Serialize;

/// Time that samples are kept together for.
const SLOT_S: u64 = 2;

/// Slots kept: ten seconds, and a part of one that still grows.
const SLOTS: usize = 6;

/// Samples of a slot, at the most.
const SAMPLES_MAX: usize = 128;

/// How long frames that came in their turn took, in microseconds. Below 0 the sensor's clock is ahead of this computer's, so that these
/// figures say more of the clocks than of the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Latency {
    /// Half of the frames took no longer.
    pub p50_us: i64,
    /// 99 of 100 took no longer.
    pub p99_us: i64,
}

#[derive(Debug, Clone, Default)]
struct Slot {
    number: u64,
    samples: Vec<i64>,
    /// Every so many frames there is a sample.
    stride: u64,
    seen: u64,
}

/// Samples of frames' latencies: all of them where they are few, evenly chosen ones of many. Times are since any
/// fixed moment.
#[derive(Debug, Clone, Default)]
pub struct Latencies {
    slots: [Slot; SLOTS],
}

impl Latencies {
    /// Adds a frame's.
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
            // Also where the stride has just grown: the count is even then.
            slot.samples.push(latency_us);
        }
        slot.seen += 1;
    }

    /// The last ten seconds'; none where no frame came.
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
        // A sample stands for as many frames as its stride.
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
