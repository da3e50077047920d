//! Where a recording's events come from, how they are read, and what a reading found.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use event_emulator::{Emulator, Model, PixelParameters, SceneConfig, emulate_with};
use event_files::Reading;
use event_files::findings::Findings;
use event_files::sort::Sorted;
use event_types::stream::{Assumption, BATCH_EVENTS, Error, EventReader, Result, Skipped};
use event_types::{Event, Sensor, ensure, error};
use pyo3::prelude::*;

use super::stamp::Stamp;
use crate::errors::warn_of_loss;
use crate::layout::Layout;
use crate::work::{Raised, Signals, in_pool};

/// Events for which there is always room: a reader's next batch.
pub const MARGIN_EVENTS: u64 = 2 * BATCH_EVENTS as u64;

/// Where events come from.
pub enum Origin {
    /// A file, and what it does not state.
    File { path: PathBuf, reading: Reading },
    /// A scene of the emulator.
    Scene {
        config: SceneConfig,
        pixel: Box<PixelParameters>,
    },
}

/// The origin of a recording, and how it is read.
pub struct Source {
    pub origin: Origin,
    /// What the origin was when it was opened, if it is a file.
    pub stamp: Option<Stamp>,
    pub name: String,
    pub sort: bool,
    pub layout: Layout,
    /// Whether damage ends a recording with a warning in place of an exception.
    pub keeps_damaged: bool,
}

impl Source {
    /// Returns the path that was opened, if it was one.
    pub fn path(&self) -> Option<&Path> {
        match &self.origin {
            Origin::File { path, .. } => Some(path),
            Origin::Scene { .. } => None,
        }
    }

    /// Starts the emulation, with causes of events.
    ///
    /// # Errors
    /// There is none, or it does not know the causes.
    pub fn scene(&self) -> Result<Emulator> {
        match &self.origin {
            Origin::Scene { config, pixel } if config.model == Model::Physical => {
                Ok(emulate_with(*config, pixel)?.parallel(true))
            }
            Origin::Scene { .. } => Err(error!(
                Unsupported,
                "model 1 does not know the causes of its events: take model=2"
            )),
            Origin::File { path, .. } => Err(error!(
                Unsupported,
                "{}: only scenes of the emulator know the causes of their events",
                path.display()
            )),
        }
    }

    /// Returns what scene is emulated.
    ///
    /// # Errors
    /// There is none.
    pub fn config(&self) -> Result<&SceneConfig> {
        match &self.origin {
            Origin::Scene { config, .. } => Ok(config),
            Origin::File { path, .. } => Err(error!(
                Unsupported,
                "{}: only scenes of the emulator know what is seen in them",
                path.display()
            )),
        }
    }

    /// Returns an error if the source is a pipe, which cannot be read again.
    ///
    /// # Errors
    /// As stated.
    pub fn refuse_pipe(&self) -> Result<()> {
        ensure!(
            !self.path().is_some_and(is_pipe),
            Refused,
            "a pipe can be read once: write what comes through it to a file"
        );
        Ok(())
    }

    /// Opens the source for the first time. A pipe may have no writer yet: an exception of a signal ends the wait.
    ///
    /// # Errors
    /// Those of opening.
    pub fn open_first(self: &Arc<Self>, raised: &Raised) -> Result<Box<dyn EventReader>> {
        if !self.path().is_some_and(is_pipe) {
            return self.open();
        }
        let (opened_to, opened) = mpsc::channel();
        let source = Arc::clone(self);
        // If it is not waited for any more, it ends with the process.
        std::thread::spawn(move || opened_to.send(source.open()));
        let mut signals = Signals::new(raised);
        loop {
            match opened.recv_timeout(Duration::from_millis(20)) {
                Ok(opened) => return opened,
                Err(RecvTimeoutError::Timeout) => signals.check()?,
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(error!(Refused, "the pipe could not be opened"));
                }
            }
        }
    }

    /// Opens the source once more.
    ///
    /// # Errors
    /// Those of opening; the source is a pipe, or no longer what it was.
    pub fn open_again(&self) -> Result<Box<dyn EventReader>> {
        self.refuse_pipe()?;
        self.unchanged(|| self.open())
    }

    /// Opens a reader of the file as it was opened before; else what was read and what is read now would be of two files.
    ///
    /// # Errors
    /// Those of opening; the source is no longer what it was.
    pub fn unchanged(
        &self,
        open: impl FnOnce() -> Result<Box<dyn EventReader>>,
    ) -> Result<Box<dyn EventReader>> {
        let refuse = || self.refuse_if(|old, now| old != now);
        refuse()?;
        let reader = open()?;
        // Or replaced in this moment; what is replaced from now on, the reader does not read.
        refuse()?;
        Ok(reader)
    }

    /// Returns an error if the first reader, which is open since then, would read bytes of another content.
    ///
    /// # Errors
    /// As stated.
    pub fn refuse_overwritten(&self) -> Result<()> {
        self.refuse_if(Stamp::is_overwritten_by)
    }

    fn refuse_if(&self, is_other: impl Fn(&Stamp, &Stamp) -> bool) -> Result<()> {
        if let (Some(old), Some(path)) = (&self.stamp, self.path()) {
            // A file that is not there any more is missed where it is opened.
            let now = Stamp::of(event_files::file_of(path));
            ensure!(
                !now.is_some_and(|now| is_other(old, &now)),
                Refused,
                "{}: the file was changed or replaced since it was opened: open it again",
                self.name
            );
        }
        Ok(())
    }

    /// Returns a reader that begins with the first event, in the file's order, and needs not look for the sensor's size if
    /// it is given.
    ///
    /// # Errors
    /// Those of opening; the source is no longer what it was.
    pub fn open_as_it_is(&self, sensor: Option<Sensor>) -> Result<Box<dyn EventReader>> {
        self.unchanged(|| self.open_unsorted(sensor))
    }

    fn open_unsorted(&self, sensor: Option<Sensor>) -> Result<Box<dyn EventReader>> {
        let reader = match &self.origin {
            Origin::File { path, reading } => event_files::open(
                path,
                Reading {
                    size: reading.size.or(sensor),
                    ..reading.clone()
                },
            )?,
            Origin::Scene { config, pixel } => {
                Box::new(emulate_with(*config, pixel)?.parallel(true))
            }
        };
        Ok(Box::new(OwnProcess::new(reader)))
    }

    /// Returns a reader that begins with the first event.
    ///
    /// # Errors
    /// Those of opening.
    fn open(&self) -> Result<Box<dyn EventReader>> {
        let reader = self.open_unsorted(None)?;
        if self.sort {
            return Ok(Box::new(Sorted::new(reader, &mut |_| {})?));
        }
        Ok(reader)
    }
}

/// Returns whether a path is read through a pipe.
fn is_pipe(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|file| !file.is_file() && !file.is_dir())
}

/// A reader that its own process alone may use: a forked one has the same place in the same open file.
struct OwnProcess {
    reader: Box<dyn EventReader>,
    process: u32,
    /// Whether reading may use several threads.
    in_pool: bool,
}

impl OwnProcess {
    fn new(reader: Box<dyn EventReader>) -> Self {
        Self {
            in_pool: ["eecvs", "scene"].contains(&reader.format()),
            reader,
            process: std::process::id(),
        }
    }
}

impl EventReader for OwnProcess {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.reader.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        ensure!(
            self.process == std::process::id(),
            Refused,
            "this reading was begun in another process: begin it in this one"
        );
        if self.in_pool {
            return in_pool(|| self.reader.read(events))?;
        }
        self.reader.read(events)
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.reader.seek(t_us)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        self.reader.end_at(t_us)
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}

/// What the latest complete reading found besides events.
#[derive(Debug, Default, Clone)]
pub struct Found {
    pub findings: Findings,
    pub lost: Vec<(&'static str, u64)>,
    pub damage: Option<String>,
}

impl Found {
    pub fn of(reader: &dyn EventReader, damage: Option<&Error>) -> Self {
        Self {
            findings: Findings::of(reader),
            lost: reader.skipped().events().collect(),
            damage: damage.map(|error| format!("{error:#}")),
        }
    }

    /// Returns one line of what was lost; `None` if nothing was.
    fn loss(&self, name: &str) -> Option<String> {
        let lost = self
            .lost
            .iter()
            .map(|(kind, count)| format!("{count} {kind}"));
        let lost: Vec<String> = self.damage.iter().cloned().chain(lost).collect();
        (!lost.is_empty()).then(|| match &self.damage {
            Some(damage) => format!("{damage}: everything before was read"),
            None => format!("{name}: left out: {}", lost.join(", ")),
        })
    }
}

pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Notes what a reading found, and warns of losses. Returns the exception for damage that is not to be kept.
pub fn note(
    py: Python<'_>,
    source: &Source,
    slot: &Mutex<Found>,
    found: Found,
    failure: Option<&Error>,
) -> PyResult<Option<PyErr>> {
    let loss = found.loss(&source.name);
    py.detach(|| *locked(slot) = found);
    if let Some(error) = failure
        && !source.keeps_damaged
    {
        return Ok(Some(crate::errors::exception(
            py,
            error,
            Some(&source.name),
        )));
    }
    if let Some(loss) = loss {
        warn_of_loss(py, &loss)?;
    }
    Ok(None)
}
