//! Reads videos: the frames from which events are emulated.
//!
//! | source | reader | times | response |
//! |---|---|---|---|
//! | a folder of PNG files, in the order of their names' numbers | `png_folder` | `fps` or a file of times | sRGB |
//! | YUV4MPEG2 (`.y4m`), also through a pipe | `y4m` | its header | sRGB |
//! | an array of NumPy, frames x rows x columns (`.npy`, `.npz`) | [`crate::numpy`] | a second array of the `.npz`, `fps` or a file of times | sRGB for integers, linear for floats |
//! | gray pixels without a header, also through a pipe | `raw_gray` | `fps` or a file of times | sRGB |
//! | frames of an AEDAT 4 recording | [`crate::aedat`] | their own | linear |
//! | `sensor_msgs/Image` of a ROS bag | [`crate::ros`] | their own | linear |
//!
//! Each has numbers from black to white: of a video with colours, its luma. A reader holds one frame.

mod checked;
mod clock;
mod png_folder;
mod raw_gray;
mod y4m;

use std::fs::File;
use std::io::{BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Result, VideoReader};
use event_types::{Sensor, bail, ensure};

pub(crate) use checked::{Frames, Taken};
pub use clock::Fps;
pub use raw_gray::RawGray;
pub(crate) use raw_gray::numbers;

use crate::aedat::{aedat4, aedat4_frames};
use crate::format::{METADATA, place_inside};
use crate::input::piped::{is_stream, name_of, open_bytes};
use crate::numpy::{npy_header, npz, stack};
use crate::reading::TimeUnit;
use crate::ros::{bag, db3, images, mcap};
use checked::Checked;
use clock::Clock;

/// Number of bytes by which a format is recognised.
const START_BYTES: usize = 16;

/// Size of the buffer of a source that is read from front to back.
const BUFFER_BYTES: usize = 1 << 16;

/// What the caller knows about a video, and its file may not say.
#[derive(Debug, Clone, Default)]
pub struct VideoReading {
    /// Rate of the frames, in place of the source's own times.
    pub fps: Option<Fps>,
    /// File with a time for each frame, one per line, in place of the source's own times.
    pub times: Option<PathBuf>,
    /// Unit of the times in that file, or in an array of times.
    pub time_unit: Option<TimeUnit>,
    /// The number that is white; otherwise the largest one of an integer type, and 1 for floats.
    pub white: Option<f64>,
    /// That the source is gray pixels without a header, and their layout.
    pub raw: Option<RawGray>,
    /// Whether the luma of YUV4MPEG2 has its full range, whatever its header says.
    pub full_range: Option<bool>,
}

/// Opens a video: a file, a folder, or stdin under the name `-`. A path may go on after the name of a recording to select
/// a stream of frames (`FILE.aedat4/0`) or a topic (`FILE.bag/davis/image_raw`), and after that of an `.npz` to select an
/// array.
///
/// # Errors
/// The source is no video that is known, cannot be read, does not state what it has to, or contradicts `reading`; the
/// message says what to give.
pub fn open_video(path: &Path, reading: &VideoReading) -> Result<Box<dyn VideoReader>> {
    let clock = Clock::of(reading)?;
    if let Some(white) = reading.white {
        ensure!(
            white.is_finite() && white > 0.0,
            Refused,
            "white is {white}; give a number above 0"
        );
    }
    let frames = open_frames(path, reading, clock.is_some())?;
    Ok(Box::new(Checked::new(frames, clock)))
}

/// Opens the frames of a video, whose times may be stated by the caller.
fn open_frames(path: &Path, reading: &VideoReading, has_clock: bool) -> Result<Box<dyn Frames>> {
    let inside = place_inside(path);
    let (file, place) = match &inside {
        Some((file, place)) => (*file, Some(place.as_str())),
        None => (path, None),
    };
    let name = name_of(file);
    if !is_stream(file) && file.is_dir() {
        if file.join(METADATA).is_file() {
            return Ok(Box::new(images::Images::folder(file, place)?));
        }
        need_clock(has_clock, &name, "PNG files have no times")?;
        return Ok(Box::new(png_folder::PngFolder::open(file, reading.white)?));
    }
    let mut bytes = open_bytes(file)?;
    // What a pipe has given is not given again.
    let mut start = vec![0; START_BYTES];
    let got = fill(&mut bytes, &mut start).with_context(|| format!("{name}: cannot be read"))?;
    start.truncate(got);
    let source = BufReader::with_capacity(BUFFER_BYTES, Cursor::new(start.clone()).chain(bytes));
    if let Some(raw) = reading.raw {
        need_clock(has_clock, &name, "frames without a header have no times")?;
        return Ok(Box::new(raw_gray::RawFrames::new(
            Box::new(source),
            &name,
            raw,
            reading.white,
        )?));
    }
    if start.starts_with(y4m::MAGIC) {
        let frames = y4m::Y4m::new(Box::new(source), &name, reading)?;
        need_clock(
            has_clock || frames.has_rate(),
            &name,
            "the header has no frame rate",
        )?;
        return Ok(Box::new(frames));
    }
    if start.starts_with(npy_header::MAGIC) {
        need_clock(has_clock, &name, "an array of frames has no times")?;
        return Ok(Box::new(stack::Stack::npy(
            Box::new(source),
            &name,
            reading.white,
        )?));
    }
    // What is below is read at several places.
    let is_known = [
        npz::MAGIC.as_slice(),
        aedat4::MAGIC,
        bag::MAGIC,
        db3::MAGIC,
        mcap::MAGIC,
    ]
    .iter()
    .any(|magic| start.starts_with(magic));
    ensure!(
        !is_known || !is_stream(file),
        Refused,
        "{name}: this format cannot be read as a video through a pipe: give a file"
    );
    if start.starts_with(npz::MAGIC) {
        let file = Box::new(reopened(file, &name)?);
        let frames = stack::Stack::npz(file, &name, place, reading, has_clock)?;
        return Ok(Box::new(frames));
    }
    if start.starts_with(aedat4::MAGIC) {
        let frames =
            aedat4_frames::Aedat4Frames::new(Box::new(reopened(file, &name)?), &name, place)?;
        return Ok(Box::new(frames));
    }
    if is_known {
        return Ok(Box::new(images::Images::file(file, place)?));
    }
    bail!(
        Unsupported,
        "{name}: byte 0: no video that is known: give YUV4MPEG2 (ffmpeg -i VIDEO -f yuv4mpegpipe -), a folder of PNG \
         files, .npy or .npz of frames x rows x columns, a recording with frames (AEDAT 4, a ROS bag), or the size of \
         gray pixels (--size WxH)"
    )
}

fn reopened(path: &Path, name: &str) -> Result<File> {
    File::open(path).with_context(|| format!("{name}: cannot be opened"))
}

fn need_clock(has_clock: bool, name: &str, why: &str) -> Result<()> {
    ensure!(
        has_clock,
        Undecided,
        "{name}: {why}: give --fps, or --times FILE with --time-unit"
    );
    Ok(())
}

/// Returns the size of frames, if a sensor may have it.
pub(crate) fn size_of(width: u64, height: u64) -> Result<Sensor, String> {
    let side = |side| u16::try_from(side).unwrap_or(0);
    Sensor::new(side(width), side(height)).ok_or_else(|| {
        format!(
            "frames of {width} x {height} pixels; a sensor has sides of 1 to {}: scale the video (ffmpeg -vf scale=346:260)",
            Sensor::SIDE_MAX
        )
    })
}

/// Fills `bytes` as far as the source has any, and returns how many it had.
pub(crate) fn fill(source: &mut impl Read, bytes: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while let Some(rest) = bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
        match source.read(rest) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}
