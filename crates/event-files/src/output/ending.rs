//! Checks that the ending of an output's name fits the kind of file that is written.

use std::path::Path;

use event_types::ensure;
use event_types::stream::Result;

use crate::FORMATS;
use crate::format::{FRAMES, FRAMES_ENDING};

/// The kind of a file that a command writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// EECVS frames.
    Frames,
    /// Events, in the format that the ending names.
    Recording,
    /// Events, in a format that does not depend on the ending.
    AnyRecording,
    /// A volume, as an array.
    Volume,
    /// The truth about an emulated recording, as arrays.
    Truth,
    /// A picture or an animation.
    Picture,
    /// A chart in SVG.
    Chart,
    /// Thresholds of a calibration.
    Settings,
    /// A device's byte stream.
    Stream,
}

const KINDS: [Kind; 8] = [
    Kind::Frames,
    Kind::Recording,
    Kind::Volume,
    Kind::Truth,
    Kind::Picture,
    Kind::Chart,
    Kind::Settings,
    Kind::Stream,
];

impl Kind {
    /// Checks that the name does not have the ending of another kind; for [`Kind::Recording`], that a format with a
    /// writer has its ending.
    ///
    /// # Errors
    /// The ending does not fit; the message names the file and a suitable ending.
    pub fn check(self, path: &Path) -> Result<()> {
        if self == Self::Recording {
            return crate::writable(path).map(|_| ());
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.to_ascii_lowercase();
        let is_other = !self.has(&name) && KINDS.iter().any(|kind| kind.has(&name));
        ensure!(
            !is_other,
            Refused,
            "{}: this extension is that of another kind of file: use {}",
            path.display(),
            self.endings().first().copied().unwrap_or_default()
        );
        Ok(())
    }

    fn has(self, name: &str) -> bool {
        let ends = |ending: &&str| name.ends_with(*ending);
        if !matches!(self, Self::Recording | Self::AnyRecording) {
            return self.endings().iter().any(ends);
        }
        let formats = FORMATS.iter().filter(|format| format.name != FRAMES);
        formats.flat_map(|format| format.endings).any(ends)
    }

    const fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Frames => &[FRAMES_ENDING],
            Self::Recording | Self::AnyRecording => &[],
            Self::Volume => &[".npy", ".npz"],
            Self::Truth => &[".npz"],
            Self::Picture => &[".gif", ".png"],
            Self::Chart => &[".svg"],
            Self::Settings => &[".toml"],
            Self::Stream => &[".stream"],
        }
    }
}
