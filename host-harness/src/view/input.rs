//! Reads a recording or a file of frames as one stream of events.

use std::ops::Range;
use std::path::Path;

use anyhow::Result;
use eecvs::frame_file::LinkReport;
use eecvs::reconstruct::recover::Confidences;
use eecvs_nostd::{Event, Sensor};
use event_files::content::Content;
use event_files::frames::FrameEvents;
use event_files::input::ReadSeek;
use event_files::input::piped::name_of;
use event_files::{Ahead, BATCH_EVENTS, EventReader, Reading};

/// A stream of events from a file of either kind.
pub enum Input {
    /// Events of a recording.
    Recording(Ahead),
    /// Events decoded from frames.
    Frames(Box<FrameEvents<Box<dyn ReadSeek>>>),
}

impl Input {
    /// Opens frames, or a recording of any known format; the first bytes or the extension `.eecvs` identify frames.
    /// `reading` supplies what a recording does not state itself.
    ///
    /// # Errors
    /// Fails if the file cannot be opened, its format is unknown, or no frame of it decodes.
    pub fn open(path: &Path, reading: &Reading) -> Result<Self> {
        Ok(match Content::of(path)? {
            Content::Frames(source) => {
                let frames = FrameEvents::new(source, &name_of(path), reading)?;
                Self::Frames(Box::new(frames))
            }
            Content::Recording(recording) => Self::recording(recording.open(reading)?),
        })
    }

    /// Wraps a reader of a recording.
    #[must_use]
    pub fn recording(reader: Box<dyn EventReader>) -> Self {
        Self::Recording(Ahead::new(reader, BATCH_EVENTS))
    }

    /// Returns the size of the sensor.
    #[must_use]
    pub fn sensor(&self) -> Sensor {
        match self {
            Self::Recording(reader) => reader.sensor(),
            Self::Frames(frames) => frames.sensor(),
        }
    }

    /// Returns the earliest time in the first batch of events, in us, before any of them is read; `None` if there
    /// are no events.
    #[must_use]
    pub fn first_us(&mut self) -> Option<u64> {
        let events = match self {
            Self::Recording(reader) => reader.events(),
            Self::Frames(frames) => frames.ahead(),
        };
        events.iter().map(|event| event.t_us).min()
    }

    /// Leaves out what can be left out because it is not between two times, if the file has an index of them.
    ///
    /// # Errors
    /// Fails if the index cannot be read.
    pub fn seek(&mut self, times: Range<u64>) -> Result<()> {
        match self {
            // Its first events have been read already.
            Self::Recording(_) => {}
            Self::Frames(frames) => {
                frames.seek(times)?;
            }
        }
        Ok(())
    }

    /// Appends the next events and returns their number; 0 at the end.
    ///
    /// # Errors
    /// Fails if the recording is damaged or on I/O errors, after everything before has been returned.
    pub fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        match self {
            Self::Recording(reader) => Ok(reader.read(events)?),
            Self::Frames(frames) => {
                let Some(window) = frames.next_window()? else {
                    return Ok(0);
                };
                let count = window.events.len();
                events.extend_from_slice(&window.events);
                frames.reuse(window);
                Ok(count)
            }
        }
    }

    /// Returns the confidence counts of the times found in frames so far.
    #[must_use]
    pub fn confidences(&self) -> Confidences {
        match self {
            Self::Recording(_) => Confidences::default(),
            Self::Frames(frames) => frames.confidences(),
        }
    }

    /// Returns what was damaged or lost among the frames read so far; `None` for a recording.
    #[must_use]
    pub fn report(&self) -> Option<&LinkReport> {
        match self {
            Self::Recording(_) => None,
            Self::Frames(frames) => Some(frames.report()),
        }
    }
}
