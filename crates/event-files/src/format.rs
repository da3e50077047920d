//! The table of formats: how each is recognised by its first bytes, opened and created.

use std::fs::File;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Error, Result};
use event_types::{Event, Sensor, bail, ensure, error};

#[cfg(feature = "aedat4")]
use crate::aedat::aedat4;
use crate::aedat::{aedat1, aedat2, aedat3};
#[cfg(feature = "arrow")]
use crate::arrow;
use crate::evt::header::{RawHeader, Words};
use crate::evt::{evt2, evt3, evt4, evt21};
#[cfg(feature = "eecvs")]
use crate::frames;
#[cfg(feature = "hdf5")]
use crate::hdf5;
use crate::input::marked::{MARK, Marked};
use crate::input::piped::{Piped, is_stream, name_of, whole};
use crate::input::{Input, ReadSeek, adjusted};
#[cfg(feature = "mat")]
use crate::mat;
#[cfg(feature = "npz")]
use crate::numpy::npz;
use crate::output::temporary::Temporary;
use crate::output::{Output, is_stdout};
#[cfg(feature = "parquet")]
use crate::parquet;
use crate::reading::Reading;
#[cfg(feature = "ros")]
use crate::ros;
use crate::{EventReader, EventWriter, dat, es, nmnist, text};

/// File in the folder of a ROS 2 bag that describes the bag's files.
pub const METADATA: &str = "metadata.yaml";

/// Name of the format of EECVS frames.
pub const FRAMES: &str = "eecvs";

/// Ending of the names of EECVS frame files.
pub const FRAMES_ENDING: &str = ".eecvs";

/// First bytes of every EECVS frame.
pub const FRAMES_SYNC: [u8; 2] = [0xEE, 0xC5];
/// First two bytes of a file of frames whose end is marked.
pub const FRAMES_MARK: [u8; 2] = [0xEE, 0xC8];

/// Formats that this build leaves out: their titles and the features that add them.
const LEFT_OUT: &[(&str, &str)] = &[
    #[cfg(not(feature = "aedat4"))]
    ("AEDAT 4", "aedat4"),
    #[cfg(not(feature = "arrow"))]
    ("Arrow", "arrow"),
    #[cfg(not(feature = "eecvs"))]
    ("EECVS frames", "eecvs"),
    #[cfg(not(feature = "hdf5"))]
    ("HDF5", "hdf5"),
    #[cfg(not(feature = "mat"))]
    ("MATLAB", "mat"),
    #[cfg(not(feature = "npz"))]
    ("NumPy arrays and zip files", "npz"),
    #[cfg(not(feature = "parquet"))]
    ("Parquet", "parquet"),
    #[cfg(not(feature = "ros"))]
    ("ROS bags", "ros"),
];

/// Number of leading bytes that detection looks at.
const START_BYTES: usize = 4096;

/// Number of bytes in which a header of text is looked for: more than that of a RAW file may have. AEDAT files are known
/// by their first line.
const HEADER_BYTES: usize = 1 << 17;

/// All formats, in the order in which they are tried; text comes last, since nearly any file may be text.
pub const FORMATS: &[Format] = &[
    #[cfg(feature = "eecvs")]
    frames::FORMAT,
    #[cfg(feature = "aedat4")]
    aedat4::FORMAT,
    aedat2::FORMAT,
    aedat1::FORMAT,
    aedat3::FORMAT,
    evt2::FORMAT,
    evt21::FORMAT,
    evt3::FORMAT,
    evt4::FORMAT,
    dat::FORMAT,
    es::FORMAT,
    #[cfg(feature = "hdf5")]
    hdf5::FORMAT,
    #[cfg(feature = "npz")]
    npz::FORMAT,
    #[cfg(feature = "npz")]
    npz::NPY_FORMAT,
    #[cfg(feature = "mat")]
    mat::FORMAT,
    #[cfg(feature = "arrow")]
    arrow::FORMAT,
    #[cfg(feature = "arrow")]
    arrow::STREAM_FORMAT,
    #[cfg(feature = "parquet")]
    parquet::FORMAT,
    #[cfg(feature = "ros")]
    ros::bag::FORMAT,
    #[cfg(feature = "ros")]
    ros::db3::FORMAT,
    #[cfg(feature = "ros")]
    ros::mcap::FORMAT,
    nmnist::FORMAT,
    text::FORMAT,
    text::CSV_FORMAT,
];

/// A format of recordings: its names, its abilities and the functions that open and create its files.
#[derive(Clone, Copy)]
pub struct Format {
    /// Short name, as `eecvs info` prints it and [`EventReader::format`] returns it.
    pub name: &'static str,
    /// Name in messages and tables.
    pub title: &'static str,
    /// Endings of its files' names, in lower case and with their dot. A recording is created in the format that
    /// has the longest matching ending.
    pub endings: &'static [&'static str],
    /// Returns whether a file that begins with these bytes has this format.
    pub detect: fn(&Start) -> bool,
    /// Opens a file that [`Format::detect`] has recognised.
    pub open: fn(Opening) -> Result<Box<dyn EventReader>>,
    /// Whether a path may name a place inside the file after the file's name, as [`open`] describes.
    pub has_places: bool,
    /// Whether its readers themselves apply the caller's unit, columns, offset and choice on bad events, as those
    /// of tables do.
    pub is_table: bool,
    /// Whether a file can be read from front to back while it is still being written.
    pub grows: bool,
    /// Whether files are read, and written if there is a writer, strictly from front to back, so that a pipe will
    /// do.
    pub streams: bool,
    /// The events that its files can hold.
    pub limits: Limits,
    /// Creates a file; `None` if there is no writer.
    pub create: Option<Create>,
}

impl std::fmt::Debug for Format {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name)
    }
}

/// The range of events that a format's files can hold; writers refuse events outside it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest column.
    pub x_max: u16,
    /// Largest row.
    pub y_max: u16,
    /// Largest time in microseconds.
    pub t_max_us: u64,
    /// Whether an event's time may be before that of the previous event.
    pub steps_back: bool,
}

impl Limits {
    /// The limits of a format that holds every event of every sensor, in any order, with times up to 2^60 us.
    pub const NONE: Self = Self {
        x_max: Sensor::SIDE_MAX - 1,
        y_max: Sensor::SIDE_MAX - 1,
        t_max_us: 1 << 60,
        steps_back: true,
    };
}

/// The start of a file, from which its format is recognised.
pub struct Start<'a> {
    /// The file's first bytes, at most 4,096.
    pub bytes: &'a [u8],
    /// The file's name.
    pub name: &'a str,
    /// The file's length in bytes.
    pub length: u64,
    /// The header of `% ` lines, if the file begins with one.
    pub header: Option<RawHeader>,
}

impl Start<'_> {
    /// Returns whether the file begins with `magic`.
    #[must_use]
    pub fn begins(&self, magic: &[u8]) -> bool {
        self.bytes.starts_with(magic)
    }

    /// Returns whether the file begins with a header that announces `words`.
    #[must_use]
    pub fn holds(&self, words: Words) -> bool {
        let header = self.header.as_ref();
        header.is_some_and(|header| header.words == Ok(words))
    }

    /// Returns whether the file's name ends with `ending`, a dot and lower-case letters; the name's case is
    /// ignored.
    #[must_use]
    pub fn is_named(&self, ending: &str) -> bool {
        self.name.to_ascii_lowercase().ends_with(ending)
    }
}

/// A file that a format's [`Format::open`] is to open.
pub struct Opening<'a> {
    /// The file's bytes.
    pub source: Box<dyn ReadSeek>,
    /// The file's name in messages.
    pub name: &'a str,
    /// The file's path, unless it is bytes in memory.
    pub path: Option<&'a Path>,
    /// The place inside the file that the caller named, if any; only for formats with [`Format::has_places`].
    pub place: Option<&'a str>,
    /// What the caller knows about the file.
    pub reading: Reading,
}

/// Opens a recording, whose format is recognised by its content; `reading` states what the file does not.
///
/// The path may go on after the file's name to select a dataset or group of an HDF5 file
/// (`FILE.hdf5/davis/right/events`), a topic of a ROS bag, a stream of an AEDAT 4 file, an array of an npz file,
/// or a recording of a zip file. A folder with a `metadata.yaml` is opened as a ROS 2 bag, one with `.npy` files
/// as one recording. A named pipe, and stdin under the name `-`, are read as [`open_pipe`] does.
///
/// # Errors
/// The format is unknown, the file cannot be read, or its header is damaged.
pub fn open(path: &Path, reading: impl Into<Reading>) -> Result<Box<dyn EventReader>> {
    let reading = reading.into();
    if is_stream(path) {
        return open_pipe(Piped::open(path)?, &name_of(path), &reading);
    }
    let inside = place_inside(path);
    let (file, place) = match &inside {
        Some((file, place)) => (*file, Some(place.as_str())),
        None => (path, None),
    };
    let name = file.display().to_string();
    let metadata = std::fs::metadata(file).with_context(|| format!("{name}: cannot be opened"))?;
    if metadata.is_dir() {
        return open_folder(file, place, &name, &reading);
    }
    let source = File::open(file).with_context(|| format!("{name}: cannot be opened"))?;
    open_place(Opening {
        source: Box::new(source),
        name: &name,
        path: Some(file),
        place,
        reading,
    })
}

/// Opens a folder: a ROS 2 bag or a recording of `.npy` arrays.
fn open_folder(
    folder: &Path,
    place: Option<&str>,
    name: &str,
    reading: &Reading,
) -> Result<Box<dyn EventReader>> {
    #[cfg(feature = "npz")]
    if !folder.join(METADATA).is_file() && npz::is_folder(folder) {
        return npz::open_folder(folder, reading);
    }
    #[cfg(feature = "ros")]
    {
        let format = &ros::folder::FORMAT;
        adjusted::check(format, name, reading)?;
        let reader = ros::folder::open(folder, place, reading.size)?;
        adjusted::adjusted(Box::new(reader), format, name, reading)
    }
    #[cfg(not(feature = "ros"))]
    {
        let _ = (folder, place, reading);
        bail!(
            Unsupported,
            "{name}: is a folder: ROS bags need this crate's feature `ros`"
        );
    }
}

/// Returns the part of a path that is a file or a bag's folder, without the place inside it.
#[must_use]
pub fn file_of(path: &Path) -> &Path {
    place_inside(path).map_or(path, |(file, _)| file)
}

/// Splits a path that leads into a file or a bag's folder; `None` if the path itself exists or leads into neither.
pub(crate) fn place_inside(path: &Path) -> Option<(&Path, String)> {
    let is_bag = |folder: &Path| folder.join(METADATA).is_file();
    if path.exists() {
        return None;
    }
    let mut above = path.ancestors().skip(1);
    let file = above.find(|above| above.is_file() || is_bag(above))?;
    let rest = path.strip_prefix(file).ok()?;
    let names: Option<Vec<&str>> = rest.iter().map(|name| name.to_str()).collect();
    Some((file, names?.join("/")))
}

/// Opens a file or bytes in memory as [`open`] does; messages call them `name`.
///
/// # Errors
/// Those of [`open`].
pub fn open_source(
    source: Box<dyn ReadSeek>,
    name: &str,
    reading: impl Into<Reading>,
) -> Result<Box<dyn EventReader>> {
    open_place(Opening {
        source,
        name,
        path: None,
        place: None,
        reading: reading.into(),
    })
}

/// Opens a recording that comes through a pipe.
///
/// The events are returned as they arrive if the pipe's first bytes show the format and the sensor's size, and the
/// format is read strictly from front to back. Otherwise the pipe is first copied to a temporary file.
///
/// # Errors
/// Those of [`open`].
pub fn open_pipe(mut pipe: Piped, name: &str, reading: &Reading) -> Result<Box<dyn EventReader>> {
    refuse_unknown(&mut pipe, name)?;
    let front = pipe.front(START_BYTES);
    let front = front.with_context(|| format!("{name}: cannot be read"))?;
    let front = front.to_vec();
    let open_front =
        |reading: Reading| open_source(Box::new(Cursor::new(front.clone())), name, reading);
    let source: Box<dyn ReadSeek> = if is_told_by_front(open_front, reading) {
        Box::new(pipe)
    } else {
        Box::new(whole(pipe, name)?)
    };
    open_source(source, name, reading.clone())
}

/// Refuses a pipe whose first bytes are those of no format, before all of it is copied: it may have no end.
///
/// # Errors
/// The format is not known, or the pipe cannot be read.
pub(crate) fn refuse_unknown(pipe: &mut Piped, name: &str) -> Result<()> {
    let front = pipe.front(START_BYTES);
    let front = front.with_context(|| format!("{name}: cannot be read"))?;
    // A shorter pipe has ended, and says more of itself when it is opened.
    if front.len() < START_BYTES {
        return Ok(());
    }
    let front = front.to_vec();
    // Noise may begin as text does: text has no mark of its own, but it has no zeros either.
    let zero = front.iter().position(|byte| *byte == 0);
    let zero = zero.filter(|_| !text::is_utf16(&front));
    let format = tell(&mut Input::new(Box::new(Cursor::new(front)), name)?)?;
    match zero {
        Some(zero) if format.name == text::FORMAT.name => bail!(
            Damaged,
            "{name}: byte {zero}: a zero, which no text has: not a recording of a known format"
        ),
        _ => Ok(()),
    }
}

/// Returns whether a recording can be opened by its first bytes, and read as a stream, whatever follows them.
fn is_told_by_front(
    open_front: impl Fn(Reading) -> Result<Box<dyn EventReader>>,
    reading: &Reading,
) -> bool {
    let Ok(reader) = open_front(reading.clone()) else {
        return false;
    };
    let format = FORMATS.iter().find(|format| format.name == reader.format());
    let has_size = || has_size(&open_front, reading, reader.sensor());
    // Each frame states its own size.
    format.is_some_and(|format| {
        format.streams && (reading.size.is_some() || format.name == FRAMES || has_size())
    })
}

/// Returns whether a recording states its own size, which is `sensor`; one that does not would accept any other.
pub(super) fn has_size(
    open: impl Fn(Reading) -> Result<Box<dyn EventReader>>,
    reading: &Reading,
    sensor: Sensor,
) -> bool {
    let larger = Sensor {
        width: if sensor.width == Sensor::SIDE_MAX {
            1
        } else {
            sensor.width + 1
        },
        ..sensor
    };
    let reading = Reading {
        size: Some(larger),
        ..reading.clone()
    };
    // If the reader does not take another size, the file states its own.
    !open(reading).is_ok_and(|reader| reader.sensor() != sensor)
}

fn open_place(opening: Opening) -> Result<Box<dyn EventReader>> {
    let Opening { name, place, .. } = opening;
    let mut input = Input::new(opening.source, name)?;
    let mut format = tell(&mut input)?;
    if format.name == text::FORMAT.name
        && let Some(marked) = tell_marked(&mut input)?
    {
        format = marked;
        let source = Marked::new(input.into_source());
        input = Input::new(
            Box::new(source.with_context(|| format!("{name}: cannot be read"))?),
            name,
        )?;
    }
    ensure!(
        place.is_none() || format.has_places,
        Refused,
        "{name}: {} has no parts to name: give only the name of the file",
        format.title
    );
    adjusted::check(format, name, &opening.reading)?;
    let reading = opening.reading.clone();
    let reader = (format.open)(Opening {
        source: input.into_source(),
        ..opening
    })?;
    adjusted::adjusted(reader, format, name, &reading)
}

/// Recognises the format of a recording by its first bytes.
fn tell(input: &mut Input) -> Result<&'static Format> {
    let name = input.name().to_owned();
    let mut bytes = vec![0; START_BYTES];
    let filled = input.fill(&mut bytes)?;
    bytes.truncate(filled);
    // Text and N-MNIST have no header: an empty file is a recording without events.
    let may_be_empty = |ending| name.to_ascii_lowercase().ends_with(ending);
    if bytes.is_empty() && ![".bin", ".csv", ".txt"].into_iter().any(may_be_empty) {
        bail!(Damaged, "{name}: byte 0: the file is empty");
    }
    let header = if bytes.starts_with(b"%") {
        input.seek(0)?;
        Some(RawHeader::read(input)?)
    } else {
        None
    };
    let start = Start {
        bytes: &bytes,
        name: &name,
        length: input.length(),
        header,
    };
    let format = FORMATS.iter().find(|format| (format.detect)(&start));
    format.ok_or_else(|| unknown(&start))
}

/// Recognises the format of a recording with a header of text behind a byte-order mark; `None` for any other, and for
/// text, whose reader skips the mark itself.
fn tell_marked(input: &mut Input) -> Result<Option<&'static Format>> {
    let mut bytes = vec![0; MARK.len() + HEADER_BYTES];
    let filled = input.fill_at(0, &mut bytes)?;
    let rest = bytes.get(..filled).unwrap_or_default().strip_prefix(MARK);
    let Some(rest) = rest.filter(|rest| rest.starts_with(b"%") || rest.starts_with(b"#!AER"))
    else {
        return Ok(None);
    };
    let name = input.name().to_owned();
    let mut hidden = Input::new(Box::new(Cursor::new(rest.to_vec())), &name)?;
    let format = tell(&mut hidden)?;
    Ok(Some(format).filter(|format| format.name != text::FORMAT.name))
}

/// Lists the formats that this build leaves out, as the end of a message; empty if it has them all.
fn left_out() -> String {
    let names: Vec<String> = LEFT_OUT
        .iter()
        .map(|(title, feature)| format!("{title} (`{feature}`)"))
        .collect();
    match names.as_slice() {
        [] => String::new(),
        names => format!(
            "; not in this build, which lacks their features: {}",
            names.join(", ")
        ),
    }
}

/// Returns the error for a file of no known format, as specific as possible.
fn unknown(start: &Start) -> Error {
    let name = start.name;
    let is_left_out = start.begins(b"#!AER-DAT4") && cfg!(not(feature = "aedat4"));
    if start.begins(b"#!AER-DAT") && !is_left_out {
        return error!(
            Unsupported,
            "{name}: byte 0: only AEDAT 1, 2, 3 and 4 are known: convert it with DV"
        );
    }
    let words = start.header.as_ref().map(|header| &header.words);
    if let Some(Err(other)) = words
        && !other.is_empty()
    {
        return error!(
            Unsupported,
            "{name}: byte 0: {other} is not known: record EVT 2, 2.1, 3 or 4"
        );
    }
    let known: Vec<&str> = FORMATS.iter().map(|format| format.title).collect();
    error!(
        Unsupported,
        "{name}: byte 0: not a recording of a known format ({}){}",
        known.join(", "),
        left_out()
    )
}

/// Creates a recording in the format of its file name's ending; the file gets its name when it is finished.
///
/// # Errors
/// Those of [`writable`]; the file cannot be written; the format cannot hold the sensor.
pub fn create(path: &Path, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    create_as(path, writable(path)?.0, sensor)
}

/// Creates a recording in `format`, whatever the file's name; otherwise like [`create`].
///
/// Output to a pipe is written event by event if the format is written from front to back, and otherwise copied to
/// the pipe when it is complete.
///
/// # Errors
/// Those of [`create`]; `format` has no writer.
pub fn create_as(path: &Path, format: &Format, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    let create = format
        .create
        .with_context(|| format!("{}: {} cannot be written", path.display(), format.title))?;
    let output = Output::begin(path)?;
    if output.is_direct() && !format.streams {
        let (_, file) = Temporary::create().with_context(|| {
            format!(
                "{}: no temporary file can be created for it",
                path.display()
            )
        })?;
        let writer = create(file.path(), sensor)?;
        return Ok(Box::new(Later {
            writer,
            file,
            output,
        }));
    }
    let writer = create(output.path(), sensor)?;
    Ok(Box::new(Kept { writer, output }))
}

/// Creates a recording directly under its own name, for names that are temporary anyway; otherwise like
/// [`create`].
///
/// # Errors
/// Those of [`create`].
pub fn create_in_place(path: &Path, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    let (_, create) = writable(path)?;
    create(path, sensor)
}

/// A writer whose file gets its name when it is complete.
struct Kept {
    // Declared first, so that the writer is dropped before the output is removed or renamed.
    writer: Box<dyn EventWriter>,
    output: Output,
}

impl EventWriter for Kept {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        self.writer.write(events)
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self { writer, output } = *self;
        writer.finish()?;
        output.keep()
    }

    fn finish_incomplete(self: Box<Self>) -> Result<Option<PathBuf>> {
        let Self { writer, output } = *self;
        writer.finish()?;
        output.keep_incomplete().map(Some)
    }
}

/// A writer to a temporary file that is copied to a pipe when it is complete.
struct Later {
    // Declared first, so that the writer is dropped before the file is removed.
    writer: Box<dyn EventWriter>,
    file: Temporary,
    output: Output,
}

impl EventWriter for Later {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        self.writer.write(events)
    }

    fn finish(self: Box<Self>) -> Result<()> {
        let Self {
            writer,
            file,
            output,
        } = *self;
        writer.finish()?;
        let name = output.name().display();
        let mut file = File::open(file.path())
            .with_context(|| format!("{name}: its temporary file cannot be opened"))?;
        let mut pipe = output.file()?;
        io::copy(&mut file, &mut pipe).with_context(|| format!("{name}: cannot be written"))?;
        output.keep()
    }
}

/// The function that creates a format's files.
pub type Create = fn(&Path, Sensor) -> Result<Box<dyn EventWriter>>;

/// Returns the format of a file to be written, recognised by the longest known ending of its name, and its
/// function.
///
/// # Errors
/// No format with a writer has this ending.
pub fn writable(path: &Path) -> Result<(&'static Format, Create)> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.to_ascii_lowercase();
    let all = || {
        FORMATS.iter().flat_map(|format| {
            let endings = format.endings.iter().copied();
            endings.filter_map(move |ending| Some((ending, format, format.create?)))
        })
    };
    let longest = all()
        .filter(|(ending, ..)| name.ends_with(ending))
        .max_by_key(|(ending, ..)| ending.len());
    if let Some((_, format, create)) = longest {
        return Ok((format, create));
    }
    ensure!(
        !name.ends_with(FRAMES_ENDING),
        Unsupported,
        "{}: frames are written by `eecvs encode`",
        path.display()
    );
    ensure!(
        !is_stdout(path),
        Undecided,
        "{}: stdout has no extension: name the format with --format",
        path.display()
    );
    let endings: Vec<&str> = all().map(|(ending, ..)| ending).collect();
    bail!(
        Unsupported,
        "{}: no format has this extension: use {}",
        path.display(),
        endings.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn names_and_endings_are_of_one_format_each() {
        let names: HashSet<_> = FORMATS.iter().map(|format| format.name).collect();
        assert_eq!(names.len(), FORMATS.len());
        let endings: Vec<_> = FORMATS.iter().flat_map(|format| format.endings).collect();
        assert_eq!(endings.iter().collect::<HashSet<_>>().len(), endings.len());
        assert!(endings.iter().all(|ending| ending.starts_with('.')));
    }

    #[test]
    fn the_longest_ending_names_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let sensor = Sensor::new(320, 240).unwrap();
        for (name, format) in [
            ("a.raw", "evt3"),
            ("a.evt2.raw", "evt2"),
            ("a.EVT2", "evt2"),
            ("a.evt21.raw", "evt21"),
            ("a.evt4.raw", "evt4"),
            ("a.dat", "dat"),
            ("a.aedat4", "aedat4"),
        ] {
            let path = folder.path().join(name);
            create(&path, sensor).unwrap().finish().unwrap();
            assert_eq!(open(&path, None).unwrap().format(), format, "{name}");
        }
        let Err(error) = create(&folder.path().join("a.jpg"), sensor) else {
            panic!("a picture is no recording");
        };
        assert!(error.to_string().contains(".aedat4"), "{error}");
    }
}
