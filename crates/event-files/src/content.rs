//! Decides by a path's first bytes whether it leads to EECVS frames or to a recording; a pipe's bytes are not
//! lost.

use std::io::Read;
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result};

use crate::format::{FRAMES_MARK, FRAMES_SYNC, refuse_unknown};
use crate::input::ReadSeek;
use crate::input::piped::{Piped, is_stream, name_of, open_bytes};
use crate::output::temporary::{Temporary, copy};
use crate::{EventReader, Reading};

/// What a path leads to, decided by [`Content::of`].
pub enum Content {
    /// EECVS frames, from the first byte on.
    Frames(Box<dyn ReadSeek>),
    /// Anything else, which is opened as a recording.
    Recording(Unopened),
}

/// A recording that has not been opened yet.
pub enum Unopened {
    /// A file, a folder, or a place inside one.
    File(PathBuf),
    /// A pipe, and its name in messages.
    Pipe(Piped, String),
}

impl Content {
    /// Looks at the first bytes of `path`; for a pipe it waits for them.
    ///
    /// A file whose name ends in `.eecvs` is taken for frames whatever its first bytes, since these may be
    /// damaged.
    ///
    /// # Errors
    /// The file cannot be opened or read.
    pub fn of(path: &Path) -> Result<Self> {
        let is_named_so = path.extension().is_some_and(|ending| ending == "eecvs");
        if is_stream(path) {
            let name = name_of(path);
            let mut pipe = Piped::open(path)?;
            let front = pipe.front(FRAMES_SYNC.len());
            let front = front.with_context(|| format!("{name}: cannot be read"))?;
            return Ok(if is_named_so || are_frames(front) {
                Self::Frames(Box::new(pipe))
            } else {
                Self::Recording(Unopened::Pipe(pipe, name))
            });
        }
        // A folder, or a place inside a file, is a recording.
        if path.is_file() && (is_named_so || begins_with_frames(path)?) {
            return Ok(Self::Frames(Box::new(open_bytes(path)?)));
        }
        Ok(Self::Recording(Unopened::File(path.to_owned())))
    }
}

/// Returns whether a file or a stream that begins so holds frames.
fn are_frames(start: &[u8]) -> bool {
    [FRAMES_SYNC, FRAMES_MARK].iter().any(|sync| start == sync)
}

fn begins_with_frames(path: &Path) -> Result<bool> {
    let mut start = Vec::new();
    open_bytes(path)?
        .take(FRAMES_SYNC.len() as u64)
        .read_to_end(&mut start)
        .with_context(|| format!("{}: cannot be read", path.display()))?;
    Ok(are_frames(&start))
}

impl Unopened {
    /// Opens the recording; `reading` states what it does not.
    ///
    /// # Errors
    /// Those of [`crate::open`].
    pub fn open(self, reading: &Reading) -> Result<Box<dyn EventReader>> {
        match self {
            Self::File(path) => crate::open(&path, reading),
            Self::Pipe(pipe, name) => crate::open_pipe(pipe, &name, reading),
        }
    }
}

/// A recording that can be read several times: what comes through a pipe is kept in a temporary file.
pub struct Rereadable {
    path: PathBuf,
    name: String,
    /// The temporary file of a pipe, removed when this is dropped.
    whole: Option<Temporary>,
}

impl Rereadable {
    /// Prepares a recording for reading. A pipe is read to its end; nothing else is read yet.
    ///
    /// # Errors
    /// A pipe cannot be read, or its temporary file cannot be written.
    pub fn of(path: &Path) -> Result<Self> {
        let name = name_of(path);
        if !is_stream(path) {
            return Ok(Self {
                path: path.to_owned(),
                name,
                whole: None,
            });
        }
        let unkept = || format!("{name}: cannot be copied to a temporary file");
        let mut pipe = Piped::open(path)?;
        refuse_unknown(&mut pipe, &name)?;
        let (mut file, whole) = Temporary::create().with_context(unkept)?;
        copy(&mut pipe, &mut file, &name).with_context(unkept)?;
        Ok(Self {
            path: whole.path().to_owned(),
            name,
            whole: Some(whole),
        })
    }

    /// Returns the recording's name in messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Opens the recording from its first event on.
    ///
    /// # Errors
    /// Those of [`crate::open`].
    pub fn open(&self, reading: impl Into<Reading>) -> Result<Box<dyn EventReader>> {
        if self.whole.is_none() {
            return crate::open(&self.path, reading);
        }
        let file = open_bytes(&self.path)?;
        crate::open_source(Box::new(file), &self.name, reading)
    }
}
