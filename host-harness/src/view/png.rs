//! Writes frames as PNG files: a single one, or numbered ones in a folder.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use eecvs_cli::folder::RunFolder;
use event_files::output::OutputFile;

use super::frames::Frame;
use super::picture::{Look, picture};
use super::{Screen, Wish};

/// Returns whether a picture in a folder has a name that [`Pngs::folder`] gives.
#[must_use]
pub fn is_numbered(name: &str) -> bool {
    let number = name
        .strip_prefix("frame_")
        .and_then(|name| name.strip_suffix(".png"));
    number.is_some_and(|number| number.len() >= 6 && number.bytes().all(|b| b.is_ascii_digit()))
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
    Folder(RunFolder),
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

    /// Writes pictures named `frame_000000.png` and so on to a folder that was checked, and makes it if it does not
    /// exist; pictures of an earlier run are removed before the first is written.
    ///
    /// # Errors
    /// Fails if the folder cannot be made; the message names it.
    pub fn folder(folder: RunFolder, look: Look) -> Result<Self> {
        folder.make()?;
        Ok(Self {
            place: Place::Folder(folder),
            look,
            frames: 0,
        })
    }
}

impl Screen for Pngs {
    fn show(&mut self, frame: &Frame) -> Result<Wish> {
        let path = match &self.place {
            Place::File(path) => path.clone(),
            Place::Folder(folder) => {
                if self.frames == 0 {
                    folder.begin()?;
                }
                folder.path().join(format!("frame_{:06}.png", self.frames))
            }
        };
        let png = picture(frame, self.look).png()?;
        let mut file = OutputFile::create(&path)?;
        file.write_all(&png)?;
        match &self.place {
            Place::File(_) => file.finish()?,
            // Each of thousands would wait for the disk.
            Place::Folder(_) => file.finish_unsynced()?,
        }
        self.frames += 1;
        Ok(Wish::Next)
    }

    fn finish(self: Box<Self>) -> Result<()> {
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
        let pngs = || {
            let folder = RunFolder::check(&path, true, is_numbered).unwrap();
            Box::new(Pngs::folder(folder, LOOK).unwrap())
        };
        let mut screen = pngs();
        let frames = [frame((3, 2), Some((1, 1))), frame((4, 4), None)];
        for frame in &frames {
            screen.show(frame).unwrap();
        }
        screen.finish().unwrap();
        for (i, frame) in frames.iter().enumerate() {
            let bytes = std::fs::read(path.join(format!("frame_00000{i}.png"))).unwrap();
            assert!(bytes == picture(frame, LOOK).png().unwrap());
        }
        // What another program has numbered stays.
        for name in ["frame_7.png", "frame_+00001.png"] {
            std::fs::write(path.join(name), "").unwrap();
        }
        // A run that ends early leaves no picture of the one before.
        let mut screen = pngs();
        screen.show(&frames[1]).unwrap();
        drop(screen);
        let mut left: Vec<_> = std::fs::read_dir(&path)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        left.sort();
        assert_eq!(
            left,
            ["frame_+00001.png", "frame_000000.png", "frame_7.png"]
        );
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        let path = file.join("x");
        let folder = RunFolder::check(&path, true, is_numbered).unwrap();
        let error = Pngs::folder(folder, LOOK).unwrap_err();
        assert!(format!("{error:#}").contains("file"), "{error:#}");
    }
}
