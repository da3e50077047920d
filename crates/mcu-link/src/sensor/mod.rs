//! The image with a simulated sensor (`firmware/src/sensor/simulated.rs`): its recording, and what came of it.
//!
//! | file | contents |
//! |---|---|
//! | `resources.rs` | what a microcontroller has for a sensor's events, and what it has to drop |
//! | `disturbed.rs` | the same image, of which a debugger changes something |

mod disturbed;
mod resources;

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

pub use disturbed::{Disturbed, End};
pub use resources::Resources;

/// Words of a block, as in the image.
pub const BLOCK_WORDS: usize = 128;
/// Number of blocks in the image.
pub const BLOCKS: usize = 16;
/// Time after which a sensor sends a block that is not full.
pub const BLOCK_US: u32 = 1000;
/// Words that a port of 8 bits and 50 MHz carries in 2 us.
const PORT_WORDS: u32 = 25;
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
        let (mut first_us, mut last_us) = (0, 0);
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
            ensure!(
                us >= last_us,
                Refused,
                "an event at {} us after a later one: a sensor sends them in order",
                event.t_us
            );
            last_us = us;
            for word in time.into_iter().chain([word]) {
                match blocks.last_mut() {
                    Some(last) if last.words.len() < BLOCK_WORDS && us <= first_us + BLOCK_US => {
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
        // The port takes its time for each.
        let mut free_us = 0;
        for block in &mut blocks {
            let words = block.words.len() as u32;
            block.full_us = block
                .full_us
                .max(free_us + (2 * words).div_ceil(PORT_WORDS));
            free_us = block.full_us;
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

#[cfg(test)]
mod tests {
    use super::*;
    use eecvs_nostd::evt2::is_time;
    use eecvs_nostd::{Coder, Fidelity, Hybrid, Mode, Sensor, Thresholds, WindowConfig};
    use event_types::Polarity;

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
        // As quickly as the port allows.
        assert_eq!(sizes, [(11, 127), (22, 128), (26, 45)]);
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
