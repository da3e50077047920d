//! What a path leads to, frames or a recording, by its first bytes: those of a pipe stay for who reads it.

use std::io::Read;
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result};
use tempfile::{NamedTempFile, TempPath};

use crate::format::FRAMES_SYNC;
use crate::input::piped::{Piped, is_stream, name_of, open_bytes};
use crate::{EventReader, Reading};

/// What a path leads to.
pub enum Content {
    /// Frames of the codec, from the first on.
    Frames(Box<dyn Read + Send>),
    /// Anything else.
    Recording(Unopened),
}

/// A recording that has not been opened.
pub enum Unopened {
    /// A file, a folder, or a place in one.
    File(PathBuf),
    /// A pipe, and what messages call it.
    Pipe(Piped, String),
}

impl Content {
    /// Looks at the first bytes; a name that ends in `.eecvs` is of frames, as damage may hide what they
    /// begin with. Of a pipe, waits for these bytes.
    ///
    /// # Errors
    /// A file that cannot be opened or read.
    pub fn of(path: &Path) -> Result<Self> {
        let is_named_so = path.extension().is_some_and(|ending| ending == "eecvs");
        if is_stream(path) {
            let name = name_of(path);
            let mut pipe = Piped::open(path)?;
            let front = pipe.front(FRAMES_SYNC.len());
            let front = front.with_context(|| format!("{name}: cannot be read"))?;
            return Ok(if is_named_so || front == FRAMES_SYNC {
                Self::Frames(Box::new(pipe))
            } else {
                Self::Recording(Unopened::Pipe(pipe, name))
            });
        }
        // A folder and a place in a file are recordings.
        if path.is_file() && (is_named_so || begins_with_frames(path)?) {
            return Ok(Self::Frames(Box::new(open_bytes(path)?)));
        }
        Ok(Self::Recording(Unopened::File(path.to_owned())))
    }
}

fn begins_with_frames(path: &Path) -> Result<bool> {
    let mut start = Vec::new();
    open_bytes(path)?
        .take(FRAMES_SYNC.len() as u64)
        .read_to_end(&mut start)
        .with_context(|| format!("{}: cannot be read", path.display()))?;
    Ok(start == FRAMES_SYNC)
}

impl Unopened {
    /// Opens it; `reading` says what it does not.
    ///
    /// # Errors
    /// As [`crate::open`].
    pub fn open(self, reading: &Reading) -> Result<Box<dyn EventReader>> {
        match self {
            Self::File(path) => crate::open(&path, reading),
            Self::Pipe(pipe, name) => crate::open_pipe(pipe, &name, reading),
        }
    }
}

/// A recording that is read several times: a temporary file has all of what came through a pipe.
pub struct Rereadable {
    path: PathBuf,
    name: String,
    /// Of a pipe; removed with this.
    whole: Option<TempPath>,
}

impl Rereadable {
    /// Waits for all of a pipe; of anything else nothing is read.
    ///
    /// # Errors
    /// A pipe that cannot be read or kept.
    pub fn of(path: &Path) -> Result<Self> {
        let name = name_of(path);
        if !is_stream(path) {
            return Ok(Self {
                path: path.to_owned(),
                name,
                whole: None,
            });
        }
        let unkept = || format!("{name}: cannot be kept in a temporary file");
        let mut whole = NamedTempFile::new().with_context(unkept)?;
        std::io::copy(&mut open_bytes(path)?, &mut whole).with_context(unkept)?;
        let whole = whole.into_temp_path();
        Ok(Self {
            path: whole.to_path_buf(),
            name,
            whole: Some(whole),
        })
    }

    /// What messages call it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Opens it from its first event.
    ///
    /// # Errors
    /// As [`crate::open`].
    pub fn open(&self, reading: impl Into<Reading>) -> Result<Box<dyn EventReader>> {
        if self.whole.is_none() {
            return crate::open(&self.path, reading);
        }
        let file = open_bytes(&self.path)?;
        crate::open_source(Box::new(file), &self.name, reading)
    }
}
