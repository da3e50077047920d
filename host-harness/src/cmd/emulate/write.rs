//! From an emulation, through a readout if there is one, to the recording and its truth.

use anyhow::Result;
use eecvs_cli::progress::Progress;
use eecvs_nostd::{Event, Polarity};
use event_emulator::{Cause, Emulator, VideoEmulator};
use event_files::{EventReader, EventWriter};
use rayon::ThreadPool;

use super::Stage;
use super::truth::{TruthCounts, TruthFile};

/// Counts of the events written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Written {
    pub events: u64,
    pub on: u64,
}

/// An emulation of a scene or of a video.
pub trait Emulation: EventReader + Send {
    /// Returns how much has been emulated, in us.
    fn elapsed_us(&self) -> u64;

    /// Reads events and their causes.
    fn read_both(
        &mut self,
        events: &mut Vec<Event>,
        causes: &mut Vec<Cause>,
    ) -> event_types::stream::Result<usize>;
}

impl Emulation for Emulator {
    fn elapsed_us(&self) -> u64 {
        self.elapsed_us()
    }

    fn read_both(
        &mut self,
        events: &mut Vec<Event>,
        causes: &mut Vec<Cause>,
    ) -> event_types::stream::Result<usize> {
        self.read_with_causes(events, causes)
    }
}

impl Emulation for VideoEmulator {
    fn elapsed_us(&self) -> u64 {
        self.elapsed_us()
    }

    fn read_both(
        &mut self,
        events: &mut Vec<Event>,
        causes: &mut Vec<Cause>,
    ) -> event_types::stream::Result<usize> {
        self.read_with_causes(events, causes)
    }
}

/// A batch of events, and their causes where these are asked for.
#[derive(Debug, Default)]
struct Batch {
    events: Vec<Event>,
    causes: Option<Vec<Cause>>,
}

impl Batch {
    fn new(has_causes: bool) -> Self {
        Self {
            events: Vec::with_capacity(event_files::BATCH_EVENTS),
            causes: has_causes.then(Vec::new),
        }
    }

    fn clear(&mut self) {
        self.events.clear();
        if let Some(causes) = &mut self.causes {
            causes.clear();
        }
    }
}

/// Writes every event of an emulation, batch by batch and through the readout if there is one, and counts them; their causes
/// go to the truth, if it has any. The threads of `pool` read, this one writes.
///
/// # Errors
/// Reading or writing fails.
pub fn write_events(
    emulation: &mut impl Emulation,
    mut stage: Option<&mut Stage>,
    writer: &mut dyn EventWriter,
    mut truth: Option<&mut TruthFile>,
    pool: Option<&ThreadPool>,
) -> Result<Written> {
    let progress = Progress::new("ms emulated");
    let mut written = Written::default();
    let has_causes = truth.as_ref().is_some_and(|truth| truth.has_causes());
    let (mut fired, mut got) = (Batch::new(has_causes), Batch::new(has_causes));
    loop {
        let Batch { events, causes } = &mut fired;
        let mut read = || match causes {
            Some(causes) => emulation.read_both(events, causes),
            None => emulation.read(events),
        };
        let read = match pool {
            Some(pool) => pool.install(read)?,
            None => read()?,
        };
        match &mut stage {
            Some(stage) => {
                let (events, causes) = (&mut got.events, &mut got.causes);
                let readout = &mut stage.readout;
                readout.push(
                    &fired.events,
                    fired.causes.as_deref(),
                    events,
                    causes.as_mut(),
                );
                if read == 0 {
                    readout.finish(events, causes.as_mut());
                }
            }
            None => std::mem::swap(&mut fired, &mut got),
        }
        writer.write(&got.events)?;
        if let (Some(truth), Some(causes)) = (&mut truth, &got.causes) {
            truth.push(&got.events, causes)?;
        }
        written.events += got.events.len() as u64;
        let on = got.events.iter().filter(|e| e.polarity == Polarity::On);
        written.on += on.count() as u64;
        fired.clear();
        got.clear();
        if read == 0 {
            break;
        }
        progress.set(emulation.elapsed_us() / 1_000);
    }
    Ok(written)
}

/// Gives the recording and its truth their names. Both are complete before either gets it, so that a failed write leaves
/// neither.
///
/// # Errors
/// One of them cannot be written to the disk or renamed.
pub fn finish(
    writer: Box<dyn EventWriter>,
    mut truth: Option<TruthFile>,
) -> Result<Option<TruthCounts>> {
    if let Some(truth) = &mut truth {
        truth.pack()?;
    }
    writer.finish()?;
    truth.map(TruthFile::keep).transpose()
}
