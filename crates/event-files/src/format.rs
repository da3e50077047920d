//! The table of formats: what tells each by its first bytes, and how it is opened and created.

use std::fs::File;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use event_types::stream::{Context, Error, Result};
use event_types::{Event, Sensor, bail, ensure, error};
use tempfile::{NamedTempFile, TempPath};

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
use crate::input::piped::{Piped, is_stream, name_of, whole};
use crate::input::{Input, ReadSeek, adjusted};
#[cfg(feature = "mat")]
use crate::mat;
#[cfg(feature = "npz")]
use crate::numpy::npz;
use crate::output::{Output, is_stdout};
#[cfg(feature = "parquet")]
use crate::parquet;
use crate::reading::Reading;
#[cfg(feature = "ros")]
use crate::ros;
use crate::{EventReader, EventWriter, dat, es, nmnist, text};

/// What the folder of a bag of ROS 2 has beside its files.
pub const METADATA: &str = "metadata.yaml";

/// Name of the format of frames.
pub const FRAMES: &str = "eecvs";

/// Ending of files of frames.
pub const FRAMES_ENDING: &str = ".eecvs";

/// First bytes of every frame.
pub const FRAMES_SYNC: [u8; 2] = [0xEE, 0xC5];

/// Formats that this build leaves out: their titles, and the features that have them.
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
    ("bags of ROS", "ros"),
];

/// Bytes that a format is told by.
const START_BYTES: usize = 4096;

/// Every format, in the order in which they are tried: text, which nearly anything may be, last.
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

/// A format of recordings.
#[derive(Clone, Copy)]
pub struct Format {
    /// As `eecvs info` prints it and [`EventReader::format`] returns it.
    pub name: &'static str,
    /// In messages and tables.
    pub title: &'static str,
    /// Endings of its files, in small letters, each with its dot; a recording is created in the format
    /// that has the longest ending of its name.
    pub endings: &'static [&'static str],
    /// Whether a file that begins so is of this format.
    pub detect: fn(&Start) -> bool,
    /// Opens a file that [`Format::detect`] has told.
    pub open: fn(Opening) -> Result<Box<dyn EventReader>>,
    /// Whether a place in a file can be named behind it, as [`open`] says.
    pub has_places: bool,
    /// Whether its readers see to the caller's unit, columns, offset and bad events themselves, as tables do.
    pub is_table: bool,
    /// Whether a file can be read from front to back while it is being written.
    pub grows: bool,
    /// Whether a file is read, and written where there is a writer, from front to back alone: a pipe will do.
    pub streams: bool,
    /// What its files hold of events.
    pub limits: Limits,
    /// Creates a file, where there is a writer.
    pub create: Option<Create>,
}

impl std::fmt::Debug for Format {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name)
    }
}

/// What files of a format hold of events; writers refuse what is beyond.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest column.
    pub x_max: u16,
    /// Largest row.
    pub y_max: u16,
    /// Largest time in microseconds.
    pub t_max_us: u64,
    /// Whether a time may be before the one of the event before it.
    pub steps_back: bool,
}

impl Limits {
    /// Every event of every sensor, in any order, with times up to 2^60 us.
    pub const NONE: Self = Self {
        x_max: Sensor::SIDE_MAX - 1,
        y_max: Sensor::SIDE_MAX - 1,
        t_max_us: 1 << 60,
        steps_back: true,
    };
}

/// How a file begins.
pub struct Start<'a> {
    /// Its first bytes, 4,096 of them at the most.
    pub bytes: &'a [u8],
    /// Its name.
    pub name: &'a str,
    /// Its length in bytes.
    pub length: u64,
    /// The lines of `% ` that it begins with, if it does.
    pub header: Option<RawHeader>,
}

impl Start<'_> {
    /// Whether the file begins with `magic`.
    #[must_use]
    pub fn begins(&self, magic: &[u8]) -> bool {
        self.bytes.starts_with(magic)
    }

    /// Whether the file begins with a header that announces `words`.
    #[must_use]
    pub fn holds(&self, words: Words) -> bool {
        let header = self.header.as_ref();
        header.is_some_and(|header| header.words == Ok(words))
    }

    /// Whether the file's name ends with `ending`, a dot and small letters.
    #[must_use]
    pub fn is_named(&self, ending: &str) -> bool {
        self.name.to_ascii_lowercase().ends_with(ending)
    }
}

/// A file to be opened.
pub struct Opening<'a> {
    /// Its bytes.
    pub source: Box<dyn ReadSeek>,
    /// What messages call it.
    pub name: &'a str,
    /// Where the file is, unless it is bytes in memory.
    pub path: Option<&'a Path>,
    /// Where in the file the events are, if that was told: never but where [`Format::has_places`].
    pub place: Option<&'a str>,
    /// What the caller knows of it.
    pub reading: Reading,
}

/// Opens a recording, its format found by content; `reading` says what the file does not.
///
/// A dataset or group of an HDF5 file is named behind it: `FILE.hdf5/davis/right/events`; so is a topic
/// of a bag of ROS, a stream of an AEDAT 4 file, an array of an npz file, a recording of a zip file. A folder with a
/// `metadata.yaml` is a bag of ROS 2, one with `.npy` files a recording.
///
/// # Errors
/// Unknown format, unreadable file, damaged header.
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

/// Opens a bag of ROS 2, or a folder of arrays.
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
            "{name}: is a folder: bags of ROS need this crate's feature `ros`"
        );
    }
}

/// The file, or folder of a bag, that holds what a path names.
#[must_use]
pub fn file_of(path: &Path) -> &Path {
    place_inside(path).map_or(path, |(file, _)| file)
}

/// The file, or folder of a bag, and the rest of a path that leads into it.
fn place_inside(path: &Path) -> Option<(&Path, String)> {
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

/// As [`open`], for a file or bytes in memory, which messages call `name`.
///
/// # Errors
/// As [`open`].
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

/// Opens a recording that comes through a pipe: event by event where its format and size are told by its front
/// and it is read from front to back alone, and else from a temporary file, when all of it has come.
///
/// # Errors
/// As [`open`].
pub fn open_pipe(mut pipe: Piped, name: &str, reading: &Reading) -> Result<Box<dyn EventReader>> {
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

/// Whether a recording's front is enough to open it, whatever follows.
fn is_told_by_front(
    open_front: impl Fn(Reading) -> Result<Box<dyn EventReader>>,
    reading: &Reading,
) -> bool {
    let Ok(reader) = open_front(reading.clone()) else {
        return false;
    };
    let format = FORMATS.iter().find(|format| format.name == reader.format());
    let has_size = || has_size(&open_front, reading, reader.sensor());
    // Frames have a size each.
    format.is_some_and(|format| {
        format.streams && (reading.size.is_some() || format.name == FRAMES || has_size())
    })
}

/// Whether a recording says its size, which is `sensor`; where it does not, any other would do.
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
    // Where another size is refused, the file tells its own.
    !open(reading).is_ok_and(|reader| reader.sensor() != sensor)
}

fn open_place(opening: Opening) -> Result<Box<dyn EventReader>> {
    let Opening { name, place, .. } = opening;
    let mut input = Input::new(opening.source, name)?;
    let format = tell(&mut input)?;
    ensure!(
        place.is_none() || format.has_places,
        Refused,
        "{name}: {} has no places: nothing is behind its name",
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

/// The format of a recording, by its first bytes.
fn tell(input: &mut Input) -> Result<&'static Format> {
    let name = input.name().to_owned();
    let mut bytes = vec![0; START_BYTES];
    let filled = input.fill(&mut bytes)?;
    bytes.truncate(filled);
    // Text and N-MNIST have no header: a recording of no events is an empty file.
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

/// What this build leaves out, in brackets; nothing where it has all formats.
fn left_out() -> String {
    let names: Vec<String> = LEFT_OUT
        .iter()
        .map(|(title, feature)| format!("{title} (`{feature}`)"))
        .collect();
    match names.as_slice() {
        [] => String::new(),
        names => format!("; left out, without these features: {}", names.join(", ")),
    }
}

/// What a file is not, told as well as it can be.
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

/// Creates a recording, which has its name when it is finished; the extension names the format.
///
/// # Errors
/// As [`writable`]; an unwritable file, a sensor that the format cannot hold.
pub fn create(path: &Path, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    create_as(path, writable(path)?.0, sensor)
}

/// As [`create`], in a format whatever the name. What goes to a pipe goes there event by event where the format is
/// written from front to back, and else when it is complete.
///
/// # Errors
/// As [`create`]; a format without a writer.
pub fn create_as(path: &Path, format: &Format, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    let create = format
        .create
        .with_context(|| format!("{}: {} are not written", path.display(), format.title))?;
    let output = Output::begin(path)?;
    if output.is_direct() && !format.streams {
        let file = NamedTempFile::new()
            .with_context(|| format!("{}: no temporary file for it", path.display()))?;
        let file = file.into_temp_path();
        let writer = create(&file, sensor)?;
        return Ok(Box::new(Later {
            writer,
            file,
            output,
        }));
    }
    let writer = create(output.path(), sensor)?;
    Ok(Box::new(Kept { writer, output }))
}

/// As [`create`], but the file is written under its own name: meant for a name that is temporary.
///
/// # Errors
/// As [`create`].
pub fn create_in_place(path: &Path, sensor: Sensor) -> Result<Box<dyn EventWriter>> {
    let (_, create) = writable(path)?;
    create(path, sensor)
}

/// A recording that has its name when it is complete.
struct Kept {
    // Closed before the output is removed or renamed.
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

/// A recording that goes to a pipe when it is complete.
struct Later {
    // Closed before the file is read or removed.
    writer: Box<dyn EventWriter>,
    file: TempPath,
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
        let mut file = File::open(&file).with_context(|| format!("{name}: its temporary file"))?;
        let mut pipe = output.file()?;
        io::copy(&mut file, &mut pipe).with_context(|| format!("{name}: cannot be written"))?;
        output.keep()
    }
}

/// How a format's files are created.
pub type Create = fn(&Path, Sensor) -> Result<Box<dyn EventWriter>>;

/// The format that a file is written in, told by its longest known ending.
///
/// # Errors
/// An ending of no format that can be written.
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
