//! The image with a simulated sensor (`firmware/src/sensor/simulated.rs`): its recording, and what came of it.

use std::collections::VecDeque;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use eecvs_nostd::Config;
use eecvs_nostd::event_link::{FIELDS_BYTES_MAX, Setup, Status};
use eecvs_nostd::evt2::{Evt2Encoder, is_event};
use event_types::Event;
use event_types::stream::{Context, MemoryReader, Result};
use event_types::{bail, ensure};

use super::account::Account;
use super::link::Demultiplexer;
use super::qemu::{self, Machine};
use super::{Job, Outcome, host_frames, limits};

/// Words of a block, as in the image.
pub const BLOCK_WORDS: usize = 128;
/// Number of blocks in the image.
pub const BLOCKS: usize = 16;
/// Time after which a sensor sends a block that is not full.
pub const BLOCK_US: u32 = 1000;
/// Number of windows in the image.
const WINDOWS: usize = 2;
/// Files of the image, in the folder in which it runs.
const WORDS: &str = "sensor.words";
const FRAMES: &str = "sensor.frames";

/// A sensor on a microcontroller.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'s> {
    /// What the sensor sees, in the order of time.
    pub events: &'s [Event],
    /// Size of the sensor; how the encoder is set up.
    pub config: Config,
    /// The rate of the link that carries frames away.
    pub link_bytes_per_second: u32,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// The encoder's frames and counts; the times are those of the machine.
    pub outcome: Outcome,
    /// Number of events in blocks that were overwritten before the interrupt had them, which are among the lost ones.
    pub overrun: u64,
}

impl Scene<'_> {
    /// Plays the scene to an image `sensor`, at 2^`shift` ns for an instruction.
    ///
    /// # Errors
    /// QEMU is not installed; an image that is missing, fails, or is not done within `patience`; events that EVT 2.0 cannot
    /// hold.
    pub fn play(
        &self,
        machine: Machine,
        image: &Path,
        shift: u8,
        patience: Duration,
    ) -> Result<Seen> {
        let folder = tempfile::tempdir().context("cannot create a folder for the recording")?;
        let words = folder.path().join(WORDS);
        fs::write(&words, self.words()?).with_context(|| words.display().to_string())?;
        let said = qemu::play(machine, image, folder.path(), shift, patience)?;
        let overrun = said
            .lines()
            .find_map(|line| line.strip_prefix(r#"{"overrun":"#)?.strip_suffix('}'))
            .and_then(|count| count.parse().ok())
            .context("the image did not say how many blocks were overwritten")?;
        let frames = folder.path().join(FRAMES);
        let frames = fs::read(&frames).with_context(|| frames.display().to_string())?;
        let mut outcome = self.account(&frames, None)?;
        if outcome.events_lost == 0 {
            let expected = self.host_frames(&outcome)?;
            outcome = self.account(&frames, Some(expected))?;
        }
        Ok(Seen { outcome, overrun })
    }

    /// Returns the frames that this host makes of the scene with the image's limits.
    ///
    /// # Errors
    /// A configuration that the host's encoder refuses.
    pub fn host_frames(&self, image: &Outcome) -> Result<Vec<Vec<u8>>> {
        let sensor = self.config.window.sensor;
        let open = || Ok(Box::new(MemoryReader::new(sensor, self.events.to_vec())) as Box<_>);
        let job = Job {
            open: &open,
            config: self.config,
            hot: &[],
            drop_when_full: true,
        };
        host_frames(&job, limits(&image.status))
    }

    /// Accounts for what an encoder sent.
    fn account(&self, bytes: &[u8], expected: Option<Vec<Vec<u8>>>) -> Result<Outcome> {
        let mut incoming = Demultiplexer::default();
        let mut account = Account::new(Status::default(), 0, expected);
        for chunk in bytes.chunks(1 << 16) {
            incoming.push(chunk);
            while let Some(message) = incoming.next_message() {
                if let ControlFlow::Break(()) = account.take(message, &mut incoming)? {
                    return Ok(account.finish(self.events.len() as u64, incoming.damaged_bytes()));
                }
            }
        }
        bail!(Damaged, "the image ended without a last status")
    }

    fn setup(&self) -> Setup {
        Setup {
            when_full: Setup::DROP,
            ..Setup::new(&self.config, 0)
        }
    }

    /// Returns the content of the image's file, which `firmware/src/sensor/simulated.rs` describes.
    fn words(&self) -> Result<Vec<u8>> {
        let mut body = [0; FIELDS_BYTES_MAX];
        let Ok(len) = self.setup().write(&mut body) else {
            bail!(CannotHold, "the setup does not fit into a packet");
        };
        let mut out = (len as u32).to_le_bytes().to_vec();
        out.extend(&body[..len]);
        out.extend(self.link_bytes_per_second.to_le_bytes());
        for block in self.blocks()? {
            out.extend(block.full_us.to_le_bytes());
            out.extend((block.words.len() as u16).to_le_bytes());
            out.extend((block.events() as u16).to_le_bytes());
            out.extend(block.words.iter().flat_map(|word| word.to_le_bytes()));
        }
        Ok(out)
    }

    /// Returns the blocks that the sensor fills.
    ///
    /// # Errors
    /// Events that are not in the order of time, or that EVT 2.0 cannot hold; more than 67 s, as the image's clock is one of
    /// 32 bits.
    pub fn blocks(&self) -> Result<Vec<Block>> {
        let Some(start) = self.events.first().map(|event| event.t_us) else {
            return Ok(Vec::new());
        };
        let mut encoder = Evt2Encoder::new(0);
        let mut blocks: Vec<Block> = Vec::new();
        let mut first_us = 0;
        for event in self.events {
            let Some((time, word)) = encoder.encode(*event) else {
                bail!(
                    CannotHold,
                    "an event at {} us: no EVT 2.0 word has this time",
                    event.t_us
                );
            };
            let us = event.t_us.saturating_sub(start);
            let Some(us) = Some(us as u32).filter(|_| us < 1 << 26) else {
                bail!(
                    CannotHold,
                    "events from {start} to {} us: a scene is at most 67 s long",
                    event.t_us
                );
            };
            for word in time.into_iter().chain([word]) {
                match blocks.last_mut() {
                    Some(last) if last.words.len() < BLOCK_WORDS && us <= first_us + BLOCK_US => {
                        ensure!(
                            us >= last.full_us,
                            Refused,
                            "an event at {} us after a later one: a sensor sends them in order",
                            event.t_us
                        );
                        last.full_us = us;
                        last.words.push(word);
                    }
                    last => {
                        if let Some(last) = last.filter(|last| last.words.len() < BLOCK_WORDS) {
                            last.full_us = first_us + BLOCK_US;
                        }
                        first_us = us;
                        blocks.push(Block {
                            full_us: us,
                            words: vec![word],
                        });
                    }
                }
            }
        }
        Ok(blocks)
    }
}

/// What a sensor sends at once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// When it is full, or the sensor waits no longer, in microseconds from the start.
    pub full_us: u32,
    /// Its EVT 2.0 words.
    pub words: Vec<u32>,
}

impl Block {
    /// Returns its number of events.
    #[must_use]
    pub fn events(&self) -> usize {
        self.words.iter().filter(|word| is_event(**word)).count()
    }
}

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
    use eecvs_nostd::evt2::is_time;
    use eecvs_nostd::{Coder, Fidelity, Hybrid, Mode, Sensor, Thresholds, WindowConfig};
    use event_types::Polarity;

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

    fn blocks(times: &[u64]) -> Result<Vec<Block>> {
        let event = |t_us: &u64| Event {
            t_us: *t_us,
            x: 1,
            y: 2,
            polarity: Polarity::On,
        };
        let events: Vec<Event> = times.iter().map(event).collect();
        let window = WindowConfig::new(Sensor::new(4, 4).unwrap(), 1000);
        let mode = Mode::Hybrid(Hybrid {
            coder: Coder::Fast,
            fidelity: Fidelity::Lossless,
        });
        let scene = Scene {
            events: &events,
            config: Config::new(window, Thresholds::new(0, 0).unwrap(), mode),
            link_bytes_per_second: 1,
        };
        scene.blocks()
    }

    #[test]
    fn a_block_is_sent_when_it_is_full_and_after_a_while() {
        let many: Vec<u64> = (0..300).map(|event| 7_000_000 + event / 100).collect();
        let full = blocks(&many).unwrap();
        let sizes: Vec<_> = full
            .iter()
            .map(|block| (block.full_us, block.events()))
            .collect();
        // The first block begins with a time.
        assert_eq!(sizes, [(1, 127), (2, 128), (2, 45)]);
        assert!(is_time(full[0].words[0]) && full[0].words.len() == BLOCK_WORDS);

        let few = blocks(&[5, 905, 1005, 1006, 9000]).unwrap();
        let sizes: Vec<_> = few
            .iter()
            .map(|block| (block.full_us, block.events()))
            .collect();
        assert_eq!(sizes, [(1000, 3), (2001, 1), (8995, 1)]);
        assert!(blocks(&[]).unwrap().is_empty());
    }

    #[test]
    fn what_no_sensor_sends_is_refused() {
        for (times, what) in [
            (&[5, 9, 8][..], "after a later one"),
            (&[0, 1 << 26], "a scene is at most 67 s long"),
            (&[1 << 40], "no EVT 2.0 word has this time"),
        ] {
            let error = blocks(times).unwrap_err().to_string();
            assert!(error.contains(what), "{times:?}: {error}");
        }
    }
}
