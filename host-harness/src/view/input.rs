//! A recording or a file of frames as one stream of events.

use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result, bail};
use eecvs_nostd::{Event, Sensor};

use crate::decode::{WindowEvents, WindowReader};
use crate::formats::ahead::Ahead;
use crate::formats::{self, BATCH_EVENTS, EventReader};
use crate::frame_file::{FrameReader, is_frame_file};
use crate::reconstruct::DecodedWindow;
use crate::reconstruct::events::Finder;

/// Events of a file, whatever it holds.
pub enum Input {
    /// Of a recording.
    Recording(Ahead),
    /// Decoded from frames.
    Frames(Box<FrameEvents>),
}

/// Events of the windows of a file of frames.
pub struct FrameEvents {
    name: String,
    windows: WindowReader<File>,
    events: WindowEvents,
    sensor: Sensor,
    /// Decoded, to be read next.
    ahead: Option<DecodedWindow>,
}

impl Input {
    /// Opens a recording of any known format, or frames, told by their first bytes or the ending
    /// `.eecvs`; `size` is for recordings that have none.
    ///
    /// # Errors
    /// A file that cannot be opened, of no known format, or without a frame that decodes.
    pub fn open(path: &Path, size: Option<Sensor>) -> Result<Self> {
        // Damage may hide what frames begin with.
        let is_named_so = path.extension().is_some_and(|ending| ending == "eecvs");
        if is_named_so || is_frame_file(path)? {
            return Ok(Self::Frames(Box::new(FrameEvents::open(path)?)));
        }
        Ok(Self::recording(formats::open(path, size)?))
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
            Self::Frames(frames) => frames.sensor,
        }
    }

    /// The earliest time of the first events, in us, before the first of them is read; `None` where
    /// there are none.
    #[must_use]
    pub fn first_us(&self) -> Option<u64> {
        let events = match self {
            Self::Recording(reader) => reader.events(),
            Self::Frames(frames) => frames.ahead.as_ref()?.events.as_slice(),
        };
        events.iter().map(|event| event.t_us).min()
    }

    /// Appends the next events; 0 is the end.
    ///
    /// # Errors
    /// A damaged recording, or I/O; everything before has been returned.
    pub fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        match self {
            Self::Recording(reader) => reader.read(events),
            Self::Frames(frames) => frames.read(events),
        }
    }

    /// What was damaged or lost of the frames that were read.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        match self {
            Self::Recording(_) => None,
            Self::Frames(frames) => frames.windows.report().warning(),
        }
    }
}

impl FrameEvents {
    fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let mut windows = WindowReader::new(FrameReader::open(path)?);
        let mut events = WindowEvents::new(Finder::default());
        let mut first = windows.next_window().with_context(|| name.clone())?;
        let Some(window) = &mut first else {
            if windows.report().frames == 0 {
                bail!("{name}: no frame found; is it a file that `eecvs encode` wrote?");
            }
            bail!("{name}: no window with events");
        };
        events.fill(window);
        Ok(Self {
            sensor: window.header.sensor,
            name,
            windows,
            events,
            ahead: first,
        })
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        loop {
            let window = match self.ahead.take() {
                Some(window) => window,
                None => {
                    let next = self.windows.next_window();
                    let Some(mut window) = next.with_context(|| self.name.clone())? else {
                        return Ok(0);
                    };
                    self.events.fill(&mut window);
                    window
                }
            };
            let count = window.events.len();
            events.extend_from_slice(&window.events);
            self.windows.reuse(window);
            // A window may be without: 0 would be the end.
            if count > 0 {
                return Ok(count);
            }
        }
    }
}
