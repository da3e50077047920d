//! Writes volumes as files of NumPy: `.npy` holds the array alone, `.npz` also the times of the windows.
//!
//! | file | arrays |
//! |---|---|
//! | `.npy` | float32, C x H x W for one window, T x C x H x W for all; then also `NAME.times.npy`, int64, T x 2 |
//! | `.npz` | `volume` as above; `t0_us` and `duration_us`, int64, of T or no dimensions; compressed |

use std::ffi::OsString;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use eecvs::reconstruct::volume::Volume;
use event_files::output::OutputFile;
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

use crate::npy::write_array;

/// The lowest level compresses volumes well enough, since they are mostly zeros.
const DEFLATE_LEVEL: i64 = 1;

/// Arrays of this size or more need ZIP's 64-bit fields.
const LARGE_BYTES: u64 = 1 << 31;

/// File format, chosen by the extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Npy,
    Npz,
}

/// A file of volumes that is being written, for one window or for all.
///
/// The number of volumes is known only at the end. Until then the volumes are kept in an unnamed file beside the
/// output, so that memory holds one plane, whatever the shape.
#[derive(Debug)]
pub struct VolumeFile {
    path: PathBuf,
    kind: Kind,
    all: bool,
    waiting: BufWriter<File>,
    plane: Vec<f32>,
    shape: Option<[usize; 3]>,
    /// Start and duration of each window, in us.
    times: Vec<[i64; 2]>,
}

impl VolumeFile {
    /// Starts a file at `path`; `all` gives the array a dimension of windows.
    ///
    /// # Errors
    /// Fails if the name ends neither with .npy nor with .npz, or if no temporary file can be created in the
    /// folder.
    pub fn new(path: &Path, all: bool) -> Result<Self> {
        let kind = kind(path)?;
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let waiting = tempfile::tempfile_in(folder.unwrap_or(Path::new(".")));
        let waiting = waiting.with_context(|| {
            format!(
                "{}: no temporary file can be created beside it",
                path.display()
            )
        })?;
        Ok(Self {
            path: path.to_owned(),
            kind,
            all,
            waiting: BufWriter::new(waiting),
            plane: Vec::new(),
            shape: None,
            times: Vec::new(),
        })
    }

    /// Appends the volume of a window that begins at `t0_us` and lasts `duration_us`.
    ///
    /// # Errors
    /// Fails on I/O errors, or if the shape differs from that of earlier volumes.
    pub fn append(&mut self, volume: &Volume<'_>, t0_us: u64, duration_us: u32) -> Result<()> {
        let shape = volume.shape();
        let first = *self.shape.get_or_insert(shape);
        ensure!(
            shape == first,
            "{}: the volume of the window at {t0_us} us has the shape {shape:?}, but those before \
             have {first:?}: the windows have different transforms: use --bins B, or encode with \
             --transform",
            self.path.display()
        );
        let [channels, height, width] = shape;
        self.plane.resize(height * width, 0.0);
        let mut bytes = Vec::with_capacity(4 * self.plane.len());
        for channel in 0..channels {
            volume.plane(channel, &mut self.plane);
            bytes.clear();
            bytes.extend(self.plane.iter().flat_map(|value| value.to_le_bytes()));
            let written = self.waiting.write_all(&bytes);
            written.with_context(|| format!("{}: cannot be written", self.path.display()))?;
        }
        let t0_us =
            i64::try_from(t0_us).with_context(|| format!("time {t0_us} us is above 2^63 us"))?;
        self.times.push([t0_us, duration_us.into()]);
        Ok(())
    }

    /// Returns the number of volumes appended.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.times.len()
    }

    /// Returns whether no volume has been appended.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Writes the file, and `NAME.times.npy` if there is one.
    ///
    /// # Errors
    /// Fails on I/O errors, or if no volume was appended.
    pub fn finish(self) -> Result<()> {
        let name = self.path.display().to_string();
        let shape = self
            .shape
            .with_context(|| format!("{name}: no window, so no volume"))?;
        let mut sides = if self.all {
            vec![self.times.len() as u64]
        } else {
            vec![]
        };
        sides.extend(shape.map(|side| side as u64));
        let context = || format!("{name}: cannot be written");
        let waiting = self
            .waiting
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error);
        let mut waiting = waiting.with_context(context)?;
        waiting.rewind().with_context(context)?;
        let values = BufReader::new(waiting);
        let mut out = OutputFile::create(&self.path)?;
        match self.kind {
            Kind::Npy => {
                // Both files are created before either gets its name, so that a failed write leaves neither.
                let times = times_of(&self.path, self.all).map(|path| OutputFile::create(&path));
                write_array(&mut out, "<f4", &sides, values).with_context(context)?;
                if let Some(times) = times {
                    let mut out = times?;
                    let bytes: Vec<u8> = self
                        .times
                        .iter()
                        .flatten()
                        .flat_map(|time| time.to_le_bytes())
                        .collect();
                    write_array(
                        &mut out,
                        "<i8",
                        &[self.times.len() as u64, 2],
                        bytes.as_slice(),
                    )
                    .with_context(context)?;
                    out.finish()?;
                }
                out.finish()?;
            }
            Kind::Npz => {
                write_npz(&mut out, &sides, values, &self.times).with_context(context)?;
                out.finish()?;
            }
        }
        Ok(())
    }
}

fn write_npz(
    out: &mut impl Write,
    sides: &[u64],
    values: impl Read,
    times: &[[i64; 2]],
) -> Result<()> {
    let mut zip = zip::ZipWriter::new_stream(out);
    let bytes = 4 * sides.iter().product::<u64>();
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(DEFLATE_LEVEL));
    zip.start_file("volume.npy", options.large_file(bytes >= LARGE_BYTES))?;
    write_array(&mut zip, "<f4", sides, values)?;
    // The times have the shape of the windows: (T) or ().
    let of_windows = sides
        .split_last_chunk::<3>()
        .map_or(sides, |(before, _)| before);
    for (at, name) in ["t0_us.npy", "duration_us.npy"].into_iter().enumerate() {
        let column = times.iter().filter_map(|time| time.get(at));
        let bytes: Vec<u8> = column.flat_map(|time| time.to_le_bytes()).collect();
        zip.start_file(name, options)?;
        write_array(&mut zip, "<i8", of_windows, bytes.as_slice())?;
    }
    zip.finish()?;
    Ok(())
}

/// Returns the path of the times beside the file at `path`, if it is an `.npy` of `all` windows.
#[must_use]
pub fn times_of(path: &Path, all: bool) -> Option<PathBuf> {
    let is_npy = kind(path).is_ok_and(|kind| kind == Kind::Npy);
    (all && is_npy).then(|| times_beside(path))
}

/// Returns `NAME.times.npy` in the folder of `NAME.npy`.
#[must_use]
pub fn times_beside(path: &Path) -> PathBuf {
    let mut name: OsString = path.file_stem().unwrap_or_default().to_owned();
    name.push(".times.npy");
    path.with_file_name(name)
}

fn kind(path: &Path) -> Result<Kind> {
    let ending = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase();
    match ending.as_str() {
        "npy" => Ok(Kind::Npy),
        "npz" => Ok(Kind::Npz),
        _ => bail!("{}: a volume is written as .npy or .npz", path.display()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_are_checked() {
        let folder = tempfile::tempdir().unwrap();
        assert!(VolumeFile::new(&folder.path().join("v.NPZ"), true).is_ok());
        for name in ["v.txt", "v", "npy"] {
            let refused = VolumeFile::new(&folder.path().join(name), false).unwrap_err();
            assert!(refused.to_string().contains(".npz"), "{refused}");
        }
        assert_eq!(
            times_beside(Path::new("a/v.npy")),
            Path::new("a/v.times.npy")
        );
    }
}
