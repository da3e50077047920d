//! The image with a simulated sensor, of which a debugger changes something while it runs.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs_nostd::{Frame, Mode, Scan, scan};
use event_types::Event;
use event_types::stream::{Context, Result};

use super::{FRAMES, Scene, WORDS};
use crate::Outcome;
use crate::debugger::Debugger;
use crate::qemu::{self, Machine};

/// The debugger's port, in the folder in which the image runs.
const SOCKET: &str = "debugger";

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// By itself.
    Done(Disturbed),
    /// It restarted, with this record of why.
    Restarted(String),
    /// It restarted without a record.
    RestartedSilently,
    /// The processor could not even take an exception, as one was of no use: a board's watchdog restarts it, without a record.
    LockedUp,
    /// It ended with an error of its own, or of the emulator's: what it said last.
    Failed(String),
    /// It is where no chip is. It runs where there is no memory: a board takes a fault, QEMU reads zeros there, which are
    /// instructions, for hours. Or it is in a call of QEMU's that does not end, by which the simulated sensor and link reach
    /// the host's files.
    Outside {
        /// Where it runs; 0 in a call.
        pc: u32,
    },
    /// It goes on for ever: the watchdog sees progress, but the end of the recording does not come.
    GoesOn {
        /// Where it runs.
        pc: u32,
    },
}

/// What became of the events of a run that ended by itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Disturbed {
    /// Every event is in a frame or is counted as lost.
    Right {
        /// Number of those that are counted as lost.
        lost: u64,
    },
    /// The host notices: a frame is refused or missing, a count does not fit.
    Noticed(String),
    /// Nothing tells that events are not those of the sensor.
    Wrong {
        /// Number of events that the sensor never sent.
        events: u64,
    },
}

impl Scene<'_> {
    /// Plays the scene as [`Scene::play`] does, with a debugger that has the stopped machine at first and lets it go on;
    /// `disturb` returns whether it came to change something before the image's end.
    ///
    /// # Errors
    /// As those of [`Scene::play`], but for what the image does after the change.
    pub fn disturb(
        &self,
        machine: Machine,
        image: &Path,
        shift: u8,
        patience: Duration,
        disturb: impl FnOnce(&mut Debugger) -> Result<bool>,
    ) -> Result<Option<End>> {
        let folder = tempfile::tempdir().context("cannot create a folder for the recording")?;
        let words = folder.path().join(WORDS);
        fs::write(&words, self.words()?).with_context(|| words.display().to_string())?;
        let mut child = qemu::stopped(machine, image, folder.path(), shift, SOCKET)?;
        let disturbed = Debugger::connect(&folder.path().join(SOCKET))
            .and_then(|mut debugger| Ok((disturb(&mut debugger)?, debugger)));
        let status = match &disturbed {
            Ok(_) => wait(&mut child, patience)?,
            Err(_) => None,
        };
        let disturbed = match (status, disturbed) {
            (None, Ok((is_disturbed, mut debugger))) => {
                let end = still_runs(&mut debugger);
                // Fails only if the process has already ended.
                let _ = child.kill();
                Ok((is_disturbed, end?))
            }
            (_, Ok((is_disturbed, _))) => Ok((is_disturbed, End::Outside { pc: 0 })),
            (_, Err(error)) => {
                let _ = child.kill();
                Err(error)
            }
        };
        let output = child.wait_with_output().context("the emulator")?;
        let (is_disturbed, end) = disturbed?;
        if !is_disturbed {
            return Ok(None);
        }
        let Some(status) = status else {
            return Ok(Some(end));
        };
        let [said, errors] =
            [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
        Ok(Some(self.end(
            status,
            &said,
            &errors,
            &folder.path().join(FRAMES),
        )?))
    }

    fn end(&self, status: ExitStatus, said: &str, errors: &str, frames: &Path) -> Result<End> {
        if let Some((_, record)) = said.split_once("ended: ") {
            let record = record.lines().next().unwrap_or_default();
            return Ok(End::Restarted(record.to_owned()));
        }
        if said.matches("start\n").count() > 1 {
            return Ok(End::RestartedSilently);
        }
        if errors.contains("Lockup") {
            return Ok(End::LockedUp);
        }
        if !status.success() {
            let last = errors.lines().last().or(said.lines().last());
            return Ok(End::Failed(format!(
                "{status}: {}",
                last.unwrap_or_default()
            )));
        }
        let frames = fs::read(frames).with_context(|| frames.display().to_string())?;
        let outcome = match self.account(&frames, None) {
            Ok(outcome) => outcome,
            Err(error) => return Ok(End::Done(Disturbed::Noticed(error.to_string()))),
        };
        Ok(End::Done(self.became(&outcome)))
    }

    fn became(&self, outcome: &Outcome) -> Disturbed {
        if let Some(problem) = outcome.problems.first() {
            return Disturbed::Noticed(problem.clone());
        }
        let mut sent: BTreeMap<Event, u64> = BTreeMap::new();
        for event in self.events {
            *sent.entry(*event).or_default() += 1;
        }
        let mut wrong = 0;
        let mut decoder = HybridDecoder::default();
        let mut rest = &outcome.bytes[..];
        while let Scan::Frame(found) = scan(rest) {
            let (bytes, after) = rest.split_at(found.bytes);
            rest = after;
            let Ok(frame) = Frame::parse(bytes) else {
                return Disturbed::Noticed("a frame cannot be parsed".to_owned());
            };
            let Mode::Hybrid(hybrid) = frame.header.mode else {
                return Disturbed::Noticed("a frame of another mode".to_owned());
            };
            let Ok(events) = decoder.frame(&frame, hybrid) else {
                return Disturbed::Noticed("a frame cannot be unpacked".to_owned());
            };
            for event in events {
                match sent.get_mut(&event) {
                    Some(left) if *left > 0 => *left -= 1,
                    _ => wrong += 1,
                }
            }
        }
        match wrong {
            0 => Disturbed::Right {
                lost: outcome.events_lost,
            },
            events => Disturbed::Wrong { events },
        }
    }
}

/// Returns what a machine does that does not end.
fn still_runs(debugger: &mut Debugger) -> Result<End> {
    const PC: u8 = 15;
    // The MPS2 boards have as much of each.
    const MEMORY_BYTES: u32 = 4 << 20;
    const RAM: u32 = 0x2000_0000;
    if !debugger.stop()? {
        return Ok(End::Outside { pc: 0 });
    }
    let pc = debugger.register(PC)?;
    let is_memory = pc < MEMORY_BYTES || (RAM..RAM + MEMORY_BYTES).contains(&pc);
    Ok(if is_memory {
        End::GoesOn { pc }
    } else {
        End::Outside { pc }
    })
}

/// Waits for the emulator's end; `None` if it does not come.
fn wait(child: &mut Child, patience: Duration) -> Result<Option<ExitStatus>> {
    let started = Instant::now();
    while started.elapsed() < patience {
        if let Some(status) = child.try_wait().context("the emulator")? {
            return Ok(Some(status));
        }
        thread::sleep(Duration::from_millis(2));
    }
    Ok(None)
}
