//! What a microcontroller has for a sensor's events, and what it has to drop.

use std::collections::VecDeque;

use super::{BLOCKS, Block, WINDOWS};

/// What a microcontroller has for a sensor's events, each in nanoseconds of its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resources {
    /// To receive an event, up to its place in a window.
    pub receive_ns: f64,
    /// To drop an event for which no block is free.
    pub drop_ns: f64,
    /// To encode an event.
    pub encode_ns: f64,
    /// For the link to carry an event's share of a frame; the processor need not do anything.
    pub link_ns: f64,
    /// Number of events in a window.
    pub window_events: usize,
    /// Number of events in a frame.
    pub frame_events: f64,
}

impl Resources {
    /// Returns which resource is the scarcer one, if events are lost.
    #[must_use]
    pub fn scarce(&self, is_lost: bool) -> &'static str {
        match (is_lost, self.link_ns > self.receive_ns + self.encode_ns) {
            (false, _) => "",
            (true, true) => "link",
            (true, false) => "processor",
        }
    }

    /// Returns for each of a sensor's blocks whether its events will be dropped.
    ///
    /// Every microsecond the processor drops or receives first, and encodes in the time that is left; it sends a frame once
    /// the one before has left. Blocks wait while both windows are full or being encoded.
    #[must_use]
    pub fn dropped(&self, blocks: &[Block]) -> Vec<bool> {
        const STEP_NS: f64 = 1000.0;
        const EPSILON: f64 = 1e-6;
        let mut arriving = blocks.iter().peekable();
        // Events in the blocks that wait, in the window that is filled, in the windows that are full, and left of the one
        // that is encoded.
        let mut waiting = VecDeque::new();
        let (mut open, mut full, mut encoding) = (0.0, 0, 0.0);
        let window_events = self.window_events as f64;
        let mut dropped = Vec::with_capacity(blocks.len());
        let mut to_drop = 0.0;
        // Events of the frame that are not yet encoded, and of an encoded one that waits for the link.
        let (mut in_frame, mut sent, mut to_send, mut link_free_ns) = (0.0, 0.0, 0.0, 0.0);
        let end_us = blocks.last().map_or(0, |block| block.full_us);
        for us in 0..=end_us {
            while let Some(block) = arriving.next_if(|block| block.full_us <= us) {
                let events = block.events() as f64;
                let is_dropped = waiting.len() + 1 >= BLOCKS;
                if is_dropped {
                    to_drop += events * self.drop_ns;
                } else {
                    waiting.push_back(events);
                }
                dropped.push(is_dropped);
            }
            let mut left_ns = STEP_NS;
            while left_ns > EPSILON {
                if to_drop > EPSILON {
                    let now = left_ns.min(to_drop);
                    to_drop -= now;
                    left_ns -= now;
                    continue;
                }
                let is_encoding = encoding > 0.0 || to_send > 0.0;
                if open + EPSILON >= window_events && full + usize::from(is_encoding) < WINDOWS {
                    full += 1;
                    open = 0.0;
                }
                if !is_encoding && full > 0 {
                    full -= 1;
                    encoding = window_events;
                    continue;
                }
                let has_window = full + usize::from(is_encoding) < WINDOWS;
                if let (true, Some(first)) = (has_window, waiting.front_mut()) {
                    let room: f64 = window_events - open;
                    let now = (left_ns / self.receive_ns).min(room).min(*first);
                    *first -= now;
                    open += now;
                    left_ns -= now * self.receive_ns;
                    if *first <= EPSILON {
                        waiting.pop_front();
                    }
                    continue;
                }
                if !is_encoding {
                    break;
                }
                if to_send > 0.0 {
                    let now_ns = f64::from(us + 1) * STEP_NS - left_ns;
                    if link_free_ns > now_ns {
                        break;
                    }
                    link_free_ns = now_ns + to_send * self.link_ns;
                    to_send = 0.0;
                    continue;
                }
                if in_frame <= 0.0 {
                    in_frame = self.frame_events.min(encoding);
                    sent = in_frame;
                }
                let now = (left_ns / self.encode_ns).min(in_frame).min(encoding);
                encoding -= now;
                in_frame -= now;
                left_ns -= now * self.encode_ns;
                // What is left of an event is none.
                if in_frame <= EPSILON {
                    (in_frame, to_send) = (0.0, sent);
                }
                if encoding <= EPSILON {
                    encoding = 0.0;
                }
            }
        }
        dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESOURCES: Resources = Resources {
        receive_ns: 50.0,
        drop_ns: 10.0,
        encode_ns: 150.0,
        link_ns: 0.0,
        window_events: 5000,
        frame_events: 1250.0,
    };

    /// The share of events that is lost of ten thousand blocks, evenly spread.
    fn lost(resources: &Resources, events_per_us: f64) -> f64 {
        let block = |number: u32| Block {
            full_us: (f64::from(number + 1) * 100.0 / events_per_us) as u32,
            words: vec![0; 100],
        };
        let blocks: Vec<Block> = (0..10_000).map(block).collect();
        let dropped = resources.dropped(&blocks);
        dropped.into_iter().filter(|is_dropped| *is_dropped).count() as f64 / 1e4
    }

    #[test]
    fn what_is_too_much_for_the_processor_is_dropped() {
        for rate in [0.5, 2.0, 4.9] {
            assert_eq!(lost(&RESOURCES, rate), 0.0, "{rate}");
        }
        for rate in [6.0, 8.0, 10.0, 20.0] {
            // What is left beside the dropping.
            let kept = (1000.0 - 10.0 * rate) / (50.0 + 150.0 - 10.0);
            let expected = 1.0 - kept / rate;
            let lost = lost(&RESOURCES, rate);
            assert!((lost - expected).abs() < 0.01, "{rate}: {lost} {expected}");
        }
    }

    #[test]
    fn what_is_too_much_for_the_link_is_dropped() {
        let link = Resources {
            link_ns: 400.0,
            ..RESOURCES
        };
        for rate in [0.5, 2.0, 2.4] {
            assert_eq!(lost(&link, rate), 0.0, "{rate}");
        }
        for rate in [3.0, 4.0, 6.0] {
            let expected = 1.0 - 2.5 / rate;
            let lost = lost(&link, rate);
            assert!((lost - expected).abs() < 0.02, "{rate}: {lost} {expected}");
        }
    }
}
