//! A recording or a file of frames as one stream of events.

use std::io::Read;
use std::path::Path;

use anyhow::Result;
use eecvs::frame_file::LinkReport;
use eecvs_nostd::{Event, Sensor};
use event_files::content::Content;
use event_files::frames::FrameEvents;
use event_files::input::piped::name_of;
use event_files::{Ahead, BATCH_EVENTS, EventReader, Reading};

/// Events of a file, whatever it holds.
pub enum Input {
    /// Of a recording.
    Recording(Ahead),
    /// Decoded from frames.
    Frames(Box<FrameEvents<Box<dyn Read + Send>>>),
}

impl Input {
    /// Opens a recording of any known format, or frames, told by their first bytes or the ending
    /// `.eecvs`; `reading` says what a recording does not.
    ///
    /// # Errors
    /// A file that cannot be opened, of no known format, or without a frame that decodes.
    pub fn open(path: &Path, reading: &Reading) -> Result<Self> {
        Ok(match Content::of(path)? {
            Content::Frames(source) => {
                Self::Frames(Box::new(FrameEvents::new(source, &name_of(path))?))
            }
            Content::Recording(recording) => Self::recording(recording.open(reading)?),
        })
    }

    /// The events of a reader.
    #[must_use]
    pub fn recording(reader: Box<dyn EventReader>) -> Self {
        Self::Recording(Ahead::new(reader, BATCH_EVENTS))
    }

    /// Size of the sensor.
    #[must_use]
    pub fn sensor(&self) -> Sensor {
        match self {
            Self::Recording(reader) => reader.sensor(),
            Self::Frames(frames) => frames.sensor(),
        }
    }

    /// The earliest time of the first events, in us, before the first of them is read; `None` where
    /// there are none.
    #[must_use]
    pub fn first_us(&self) -> Option<u64> {
        let events = match self {
            Self::Recording(reader) => reader.events(),
            Self::Frames(frames) => frames.ahead(),
        };
        events.iter().map(|event| event.t_us).min()
    }

    /// Appends the next events; 0 is the end.
    ///
    /// # Errors
    /// A damaged recording, or I/O; everything before has been returned.
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

    /// What was damaged or lost of the frames that were read.
    #[must_use]
    pub fn report(&self) -> Option<&LinkReport> {
        match self {
            Self::Recording(_) => None,
            Self::Frames(frames) => Some(frames.report()),
        }
    }
}
