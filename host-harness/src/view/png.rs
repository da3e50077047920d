//! Writes frames as PNG files: a single one, or numbered ones in a folder.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use event_files::output::OutputFile;

use super::Screen;
use super::frames::Frame;
use super::picture::{Look, picture};

/// Lists the numbered pictures in a folder, in any order.
pub fn numbered(folder: &Path) -> impl Iterator<Item = (u64, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| {
        let name = entry.file_name();
        let name = name.to_str()?;
        let number = name.strip_prefix("frame_")?.strip_suffix(".png")?;
        Some((number.parse().ok()?, entry.path()))
    })
}

/// Writer of PNG files.
#[derive(Debug)]
pub struct Pngs {
    place: Place,
    look: Look,
    frames: u64,
}

#[derive(Debug)]
enum Place {
    File(PathBuf),
    Folder(PathBuf),
}

impl Pngs {
    /// Writes to one file; each frame replaces the one before, so it is meant for a single frame.
    #[must_use]
    pub fn file(path: &Path, look: Look) -> Self {
        Self {
            place: Place::File(path.to_owned()),
            look,
            frames: 0,
        }
    }

    /// Writes pictures named `frame_000000.png` and so on; creates the folder if it does not exist.
    ///
    /// # Errors
    /// Fails if the folder cannot be created; the message names it.
    pub fn folder(path: &Path, look: Look) -> Result<Self> {
        std::fs::create_dir_all(path)
            .with_context(|| format!("{}: cannot make the folder", path.display()))?;
        Ok(Self {
            place: Place::Folder(path.to_owned()),
            look,
            frames: 0,
        })
    }
}

impl Screen for Pngs {
    fn show(&mut self, frame: &Frame) -> Result<()> {
        let path = match &self.place {
            Place::File(path) => path.clone(),
            Place::Folder(path) => path.join(format!("frame_{:06}.png", self.frames)),
        };
        let png = picture(frame, self.look).png()?;
        let mut file = OutputFile::create(&path)?;
        file.write_all(&png)?;
        file.finish()?;
        self.frames += 1;
        Ok(())
    }

    /// Removes pictures of an earlier run with numbers beyond this run's last.
    fn finish(self: Box<Self>) -> Result<()> {
        let Place::Folder(folder) = &self.place else {
            return Ok(());
        };
        for (_, stale) in numbered(folder).filter(|(number, _)| *number >= self.frames) {
            std::fs::remove_file(&stale)
                .with_context(|| format!("{}: cannot be removed", stale.display()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::picture::tests::{LOOK, frame};

    #[test]
    fn a_folder_gets_numbered_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/frames");
        let mut screen = Box::new(Pngs::folder(&path, LOOK).unwrap());
        let frames = [frame((3, 2), Some((1, 1))), frame((4, 4), None)];
        for frame in &frames {
            screen.show(frame).unwrap();
        }
        screen.finish().unwrap();
        for (i, frame) in frames.iter().enumerate() {
            let bytes = std::fs::read(path.join(format!("frame_00000{i}.png"))).unwrap();
            assert!(bytes == picture(frame, LOOK).png().unwrap());
        }
        let mut screen = Box::new(Pngs::folder(&path, LOOK).unwrap());
        screen.show(&frames[1]).unwrap();
        screen.finish().unwrap();
        let left: Vec<_> = numbered(&path).map(|(number, _)| number).collect();
        assert_eq!(left, [0]);
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let error = Pngs::folder(&file.join("x"), LOOK).unwrap_err();
        assert!(format!("{error:#}").contains("file"), "{error:#}");
    }
}
