//! Reads the datasets of an HDF5 file, some rows at a time.

use std::io::SeekFrom;
use std::sync::{Arc, Mutex, PoisonError};

use event_types::stream::Result;
use event_types::{Sensor, bail, ensure, error};
use hdf5_reader::{
    Attribute, BlockCacheStorage, Dataset, Datatype, H5Type, Hdf5File, OpenOptions, SliceInfo,
    SliceInfoElem, Storage, StorageBuffer, error::Error,
};

use super::chunks::Chunks;
use super::{ecf, filters};
use crate::input::following::ANOTHER;
use crate::input::{ReadSeek, following};
use crate::numpy::npy_header::{Dtype, Number};
use crate::reading::TimeUnit;
use crate::table::event_numbers::{Row, find_names};
use crate::table::stated_size::StatedSize;
use crate::table::{stated_size, time_unit};

/// Signature of HDF5, at the start of a file or after a user block of 512 bytes times a power of two.
pub const MAGIC: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// First bytes of MATLAB's `-v7.3` files, whose HDF5 signature follows a user block.
const MATLAB: &[u8; 10] = b"MATLAB 7.3";

/// Attributes that state the unit of the times.
const UNIT_KEYS: [&str; 4] = ["units", "unit", "time_unit", "t_unit"];

/// Number of bytes read at once from the file's own structures, and number of these blocks that are cached.
const BLOCK_BYTES: usize = 1 << 16;
const BLOCKS: usize = 64;

/// Largest part of a dataset read at once; a batch of events has 2 MB.
const READ_BYTES: usize = 64 << 20;

/// Chunks of datasets that are kept unpacked, in bytes: some of each column, of 64 Ki numbers each. Files of larger chunks
/// are opened with more, as a chunk that is not kept is unpacked again for each batch of its rows.
const KEPT_BYTES: usize = 4 << 20;
const KEPT_BYTES_MAX: usize = 8 * filters::CHUNK_BYTES;

/// Largest header of a dataset or group, in bytes.
const HEADER_BYTES: usize = 1 << 20;

/// Depth below the root to which datasets are listed, largest number listed, and largest number that a message
/// names.
const LIST_DEPTH: usize = 4;
const LIST_MAX: usize = 500;
const DESCRIBE_MAX: usize = 24;

/// The source, as storage that any thread may read from.
pub struct Source {
    source: Mutex<Box<dyn ReadSeek>>,
    length: u64,
}

impl Source {
    /// Reads `len` bytes from `offset` on into `bytes`, replacing its content.
    pub fn read(&self, offset: u64, len: usize, bytes: &mut Vec<u8>) -> Result<(), Error> {
        let end = offset.checked_add(len as u64);
        // Checked before memory is allocated, since lengths come from the file.
        if end.is_none_or(|end| end > self.length) {
            return Err(Error::UnexpectedEof {
                offset,
                needed: len as u64,
                available: self.length.saturating_sub(offset),
            });
        }
        // Keeps the old bytes rather than zero them, since all are overwritten.
        bytes
            .try_reserve(len.saturating_sub(bytes.len()))
            .map_err(std::io::Error::from)?;
        bytes.resize(len, 0);
        // A thread that panicked while reading has only left the position undefined, and it is set here.
        let mut source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        source.seek(SeekFrom::Start(offset))?;
        source.read_exact(bytes)?;
        Ok(())
    }
}

impl Storage for Source {
    fn len(&self) -> u64 {
        self.length
    }

    fn read_range(&self, offset: u64, len: usize) -> Result<StorageBuffer, Error> {
        let mut bytes = Vec::new();
        self.read(offset, len, &mut bytes)?;
        Ok(StorageBuffer::from_vec(bytes))
    }
}

/// Storage that caches blocks with the file's own structures. Larger reads are of data, which is read only once,
/// and bypass the cache.
struct Pieces {
    source: Arc<Source>,
    kept: BlockCacheStorage,
}

impl Storage for Pieces {
    fn len(&self) -> u64 {
        self.source.length
    }

    fn read_range(&self, offset: u64, len: usize) -> Result<StorageBuffer, Error> {
        if len > BLOCK_BYTES {
            self.source.read_range(offset, len)
        } else {
            self.kept.read_range(offset, len)
        }
    }
}

fn options(kept_bytes: usize) -> OpenOptions {
    OpenOptions::default()
        .with_filter_registry(filters::registry())
        .with_chunk_cache_bytes(kept_bytes)
        .with_max_chunk_bytes(filters::CHUNK_BYTES)
        .with_max_read_bytes(READ_BYTES)
        .with_max_object_header_bytes(HEADER_BYTES)
}

/// An HDF5 file.
pub struct Hdf5 {
    name: String,
    file: Hdf5File,
    source: Arc<Source>,
    storage: Arc<Pieces>,
    length: u64,
    is_matlab: bool,
}

impl Hdf5 {
    /// Opens a file, which messages call `name`.
    pub fn open(mut source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let damaged = |error: Error| {
            error!(
                Damaged,
                "{name}: byte 0: damaged HDF5 file: {}",
                plain(&error)
            )
        };
        let length = source
            .seek(SeekFrom::End(0))
            .map_err(|error| damaged(error.into()))?;
        let mut start = [0; MATLAB.len()];
        let begins = source.rewind().and_then(|()| source.read_exact(&mut start));
        let is_matlab = begins.is_ok() && &start == MATLAB;
        let source = Mutex::new(source);
        let source = Arc::new(Source { source, length });
        let kept = BlockCacheStorage::new(source.clone(), BLOCK_BYTES, BLOCKS);
        let storage = Pieces {
            source: source.clone(),
            kept,
        };
        let storage = Arc::new(storage);
        let file = Hdf5File::from_storage_with_options(storage.clone(), options(KEPT_BYTES));
        let file = file.map_err(damaged)?;
        let superblock = file.superblock();
        let mut bytes = source.source.lock().unwrap_or_else(PoisonError::into_inner);
        for base in [0, superblock.base_address] {
            let end = superblock.eof_address.saturating_add(base);
            // If the writer has not closed the file, the stated end may lie outside it.
            if end >= length {
                continue;
            }
            let begins = |mark: &[u8]| following::is_at(bytes.as_mut(), end, mark);
            let marks: [&[u8]; 2] = [MAGIC, MATLAB];
            let joined: Result<Vec<bool>, _> = marks.into_iter().map(begins).collect();
            let joined = joined.map_err(|error| damaged(error.into()))?;
            ensure!(
                !joined.contains(&true),
                Damaged,
                "{name}: byte {end}: {ANOTHER}"
            );
        }
        drop(bytes);
        let name = name.to_owned();
        Ok(Self {
            name,
            file,
            source,
            storage,
            length,
            is_matlab,
        })
    }

    /// Makes room for two chunks of each of these datasets, which are part of this file; returns whether it had less. Then
    /// the datasets have to be looked up again.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn keep_chunks<'d>(&mut self, datasets: impl Iterator<Item = &'d Dataset>) -> Result<bool> {
        let bytes = datasets.fold(0_u64, |sum, dataset| {
            sum.saturating_add(chunk_bytes(dataset))
        });
        let bytes = usize::try_from(bytes.saturating_mul(2)).unwrap_or(usize::MAX);
        if bytes <= KEPT_BYTES {
            return Ok(false);
        }
        let options = options(bytes.min(KEPT_BYTES_MAX));
        let file = Hdf5File::from_storage_with_options(self.storage.clone(), options);
        self.file = file.map_err(|error| {
            let what = plain(&error);
            error!(Damaged, "{}: byte 0: damaged HDF5 file: {what}", self.name)
        })?;
        Ok(true)
    }

    /// Returns the name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the dataset at `path`; `None` if there is no dataset of this path.
    ///
    /// # Errors
    /// The dataset, or a group on the way to it, is damaged.
    pub fn dataset(&self, path: &str) -> Result<Option<Dataset>> {
        match self.file.dataset(path) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(error) if is_absence(&error) => Ok(None),
            Err(error) => {
                let what = plain(&error);
                bail!(Damaged, "{}: byte 0: damaged HDF5 file: {what}", self.name)
            }
        }
    }

    /// Returns the names of the members of the group at `path`: groups, then datasets.
    pub fn members(&self, path: &str) -> (Vec<String>, Vec<String>) {
        let group = if path.is_empty() {
            self.file.root_group()
        } else {
            self.file.group(path)
        };
        let names = group.and_then(|group| group.member_names());
        names.unwrap_or_default()
    }

    /// Returns the paths of the datasets, at most [`LIST_MAX`].
    pub fn datasets(&self) -> Vec<String> {
        let mut found = Vec::new();
        self.list("", 0, &mut found);
        found
    }

    fn list(&self, path: &str, depth: usize, found: &mut Vec<String>) {
        let (groups, datasets) = self.members(path);
        let room = LIST_MAX.saturating_sub(found.len());
        found.extend(datasets.iter().take(room).map(|name| join(path, name)));
        // The depth is limited because groups may contain one another.
        if depth < LIST_DEPTH {
            for name in groups.iter().take(LIST_MAX) {
                self.list(&join(path, name), depth + 1, found);
            }
        }
    }

    /// Lists the datasets and their shapes, for the message that no layout fits.
    pub fn describe(&self) -> String {
        let datasets = self.datasets();
        let named = |path: &String| {
            let dataset = self.dataset(path).ok().flatten();
            let shape = dataset.map(|dataset| shape(dataset.shape()));
            format!("{path} {}", shape.unwrap_or_default())
        };
        let more = datasets.len().saturating_sub(DESCRIBE_MAX);
        let names: Vec<String> = datasets.iter().take(DESCRIBE_MAX).map(named).collect();
        match (names.is_empty(), more) {
            (true, _) => "no datasets".to_owned(),
            (_, 0) => names.join(", "),
            _ => format!("{} and {more} more", names.join(", ")),
        }
    }

    /// Returns the sensor size that attributes or small datasets state, at `place`, the events' dataset or group,
    /// in the group above it, or in the root; and the number of datasets that state it.
    pub fn stated_size(&self, place: &str) -> (Option<Sensor>, usize) {
        let mut size = StatedSize::default();
        let mut used = 0;
        let above = place.rsplit_once('/').map_or("", |(above, _)| above);
        for group in [place, above, ""] {
            for attribute in self.attributes(group) {
                let name = attribute.name.as_str();
                if !stated_size::is_known(name) {
                    continue;
                }
                if let Ok(text) = attribute.read_string() {
                    size.text(name, &text);
                }
                let numbers = attribute.read_1d::<Cell>().or_else(|_| {
                    let scalar = attribute.read_scalar::<Cell>();
                    scalar.map(|cell| vec![cell])
                });
                let numbers = numbers
                    .unwrap_or_default()
                    .into_iter()
                    .filter_map(|Cell(number)| number);
                size.numbers(name, &numbers.map(Number::float).collect::<Vec<_>>());
            }
            let (_, names) = self.members(group);
            for name in names.iter().filter(|name| stated_size::is_known(name)) {
                if let Some(numbers) = self.few(&join(group, name)) {
                    size.numbers(name, &numbers);
                    used += 1;
                }
            }
            if group.is_empty() {
                break;
            }
        }
        (size.sensor(), used)
    }

    /// Returns the numbers of a dataset that has at most three.
    fn few(&self, path: &str) -> Option<Vec<f64>> {
        let dataset = self.dataset(path).ok()??;
        let count = dataset
            .shape()
            .iter()
            .try_fold(1_u64, |all, side| all.checked_mul(*side))?;
        let dtype = number_type(dataset.dtype()).filter(|_| count <= 3)?;
        let bytes = dataset.read_raw_bytes().ok()?;
        let mut numbers = Vec::new();
        dtype.numbers(&bytes, &mut numbers);
        Some(numbers.into_iter().flatten().map(Number::float).collect())
    }

    /// Returns the attributes of the dataset or group at `path`.
    fn attributes(&self, path: &str) -> Vec<Attribute> {
        if path.is_empty() {
            let root = self.file.root_group().and_then(|root| root.attributes());
            return root.unwrap_or_default();
        }
        match self.file.dataset(path) {
            Ok(dataset) => dataset.attributes(),
            Err(_) => {
                let group = self.file.group(path).and_then(|group| group.attributes());
                group.unwrap_or_default()
            }
        }
    }

    /// Returns the unit that an attribute such as `units` of one of these paths states.
    pub fn stated_unit(&self, paths: &[&str]) -> Option<TimeUnit> {
        let all = paths.iter().flat_map(|path| self.attributes(path));
        let mut units = all.filter(|attribute| UNIT_KEYS.contains(&attribute.name.as_str()));
        units.find_map(|attribute| time_unit::named(&attribute.read_string().ok()?))
    }

    /// Returns whether MATLAB wrote the file.
    pub fn is_matlab(&self) -> bool {
        self.is_matlab
    }

    /// Returns the file's length in bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Returns the chunks of a one-dimensional dataset that only this filter packs; see [`Chunks::find`].
    pub fn chunks(&self, dataset: &Dataset, filter: u16) -> Option<Chunks> {
        Chunks::find(&self.file, &self.source, dataset, filter)
    }

    /// Returns an error about a dataset, at the byte where its header begins.
    pub fn error(
        &self,
        dataset: &Dataset,
        what: impl std::fmt::Display,
    ) -> event_types::stream::Error {
        error!(
            Damaged,
            "{}: byte {}: {}: {what}",
            self.name,
            dataset.address(),
            dataset.name()
        )
    }
}

/// Returns the path of `name` in the group at `path`.
pub fn join(path: &str, name: &str) -> String {
    if path.is_empty() {
        name.to_owned()
    } else {
        format!("{path}/{name}")
    }
}

/// Returns whether an error means that there is no dataset of this path.
fn is_absence(error: &Error) -> bool {
    match error {
        Error::DatasetNotFound(_) | Error::GroupNotFound(_) => true,
        Error::Context { source, .. } => is_absence(source),
        _ => false,
    }
}

fn shape(sides: &[u64]) -> String {
    let sides: Vec<String> = sides.iter().map(u64::to_string).collect();
    format!("({})", sides.join(" x "))
}

/// Formats the error in one line, with advice if a filter is not supported.
pub fn plain(error: &Error) -> String {
    let text = error.to_string().replace('\n', " ");
    match error {
        Error::UnsupportedFilter(what) => text + &filters::advice(what),
        _ => text,
    }
}

/// Returns the type of a dataset's numbers as an array's type; `None` if they are not numbers.
pub fn number_type(datatype: &Datatype) -> Option<Dtype> {
    let big_endian = |order| order == hdf5_reader::ByteOrder::BigEndian;
    let (kind, order, bytes) = match datatype {
        Datatype::FixedPoint {
            size,
            signed,
            byte_order,
        } => (if *signed { b'i' } else { b'u' }, *byte_order, *size),
        Datatype::FloatingPoint { size, byte_order } => (b'f', *byte_order, *size),
        Datatype::Bitfield { size, byte_order } => (b'u', *byte_order, *size),
        // Python's bool is stored as an enumeration.
        Datatype::Enum { base, .. } => return number_type(base),
        _ => return None,
    };
    Dtype::new(kind, big_endian(order), usize::from(bytes))
}

/// Offset and type of a field of a compound.
pub type Field = (usize, Dtype);

/// Returns the offsets and types of t, x, y and p in a compound, found by their usual names or those given, and the
/// unit that the name of t states; `None` if one of them is missing.
pub fn fields(
    datatype: &Datatype,
    given: Option<&[String; 4]>,
) -> Option<([Field; 4], Option<TimeUnit>)> {
    let Datatype::Compound { fields, .. } = datatype else {
        return None;
    };
    let names = fields.iter().map(|field| field.name.as_str());
    let found = find_names(names, given)?;
    let [t, x, y, p] = found.places.map(|place| {
        let field = fields.get(place)?;
        let offset = usize::try_from(field.byte_offset).ok()?;
        Some((offset, number_type(&field.datatype)?))
    });
    Some(([t?, x?, y?, p?], found.unit))
}

/// A number of a dataset, of any type.
#[derive(Clone)]
struct Cell(Option<Number>);

impl H5Type for Cell {
    fn hdf5_type() -> Datatype {
        Datatype::FloatingPoint {
            size: 8,
            byte_order: hdf5_reader::ByteOrder::LittleEndian,
        }
    }

    fn from_bytes(bytes: &[u8], datatype: &Datatype) -> Result<Self, Error> {
        let dtype = number_type(datatype).ok_or_else(no_number)?;
        Ok(Self(dtype.number(bytes)))
    }

    fn element_size(datatype: &Datatype) -> usize {
        hdf5_reader::dtype_element_size(datatype).unwrap_or(0)
    }

    fn decode_vec(
        raw: &[u8],
        datatype: &Datatype,
        count: usize,
    ) -> Option<Result<Vec<Self>, Error>> {
        let Some(dtype) = number_type(datatype) else {
            return Some(Err(no_number()));
        };
        let elements = raw.chunks_exact(dtype.bytes).take(count);
        Some(Ok(elements
            .map(|bytes| Self(dtype.number(bytes)))
            .collect()))
    }
}

/// A record of a dataset of compounds: its t, x, y and p.
#[derive(Clone)]
struct Record(Row);

impl Record {
    fn of(bytes: &[u8], fields: &[(usize, Dtype); 4]) -> Self {
        Self(fields.map(|(offset, dtype)| dtype.number(bytes.get(offset..)?)))
    }
}

impl H5Type for Record {
    fn hdf5_type() -> Datatype {
        Datatype::Compound {
            size: 0,
            fields: Vec::new(),
        }
    }

    fn from_bytes(bytes: &[u8], datatype: &Datatype) -> Result<Self, Error> {
        let (fields, _) = fields(datatype, None).ok_or_else(no_number)?;
        Ok(Self::of(bytes, &fields))
    }

    fn element_size(datatype: &Datatype) -> usize {
        hdf5_reader::dtype_element_size(datatype).unwrap_or(0)
    }

    fn decode_vec(
        raw: &[u8],
        datatype: &Datatype,
        count: usize,
    ) -> Option<Result<Vec<Self>, Error>> {
        let (Some((fields, _)), size @ 1..) =
            (fields(datatype, None), Self::element_size(datatype))
        else {
            return Some(Err(no_number()));
        };
        let records = raw.chunks_exact(size).take(count);
        let record = |bytes: &[u8]| {
            if bytes == ecf::NO_EVENT {
                return Err(Error::InvalidData(
                    "the chunk ends before this event".to_owned(),
                ));
            }
            Ok(Self::of(bytes, &fields))
        };
        Some(records.map(record).collect())
    }
}

/// A record as bytes, for compounds whose fields the caller names.
#[derive(Clone)]
struct Bytes(Vec<u8>);

impl H5Type for Bytes {
    fn hdf5_type() -> Datatype {
        Record::hdf5_type()
    }

    fn from_bytes(bytes: &[u8], _datatype: &Datatype) -> Result<Self, Error> {
        Ok(Self(bytes.to_vec()))
    }

    fn element_size(datatype: &Datatype) -> usize {
        Record::element_size(datatype)
    }
}

fn no_number() -> Error {
    Error::InvalidData("the type is not numeric".to_owned())
}

fn rows(start: u64, count: u64) -> SliceInfoElem {
    SliceInfoElem::Slice {
        start,
        end: start.saturating_add(count),
        step: 1,
    }
}

/// Reads `count` numbers from row `start` on of a column: a dataset with at most one side that is not 1.
pub fn read_column(
    dataset: &Dataset,
    start: u64,
    count: u64,
) -> Result<Vec<Option<Number>>, Error> {
    let long = dataset
        .shape()
        .iter()
        .position(|side| *side != 1)
        .unwrap_or(0);
    let sides = 0..dataset.shape().len().max(1);
    let selections = sides.map(|side| {
        if side == long {
            rows(start, count)
        } else {
            rows(0, 1)
        }
    });
    let selections = selections.collect();
    let cells = dataset.read_slice::<Cell>(&SliceInfo { selections })?;
    Ok(cells.into_iter().map(|Cell(number)| number).collect())
}

/// Reads `count` rows from row `start` on of a dataset of shape (N, columns) or, if turned, (columns, N): the
/// columns at `order`.
pub fn read_table(
    dataset: &Dataset,
    start: u64,
    count: u64,
    (columns, is_turned): (usize, bool),
    order: [usize; 4],
) -> Result<Vec<Row>, Error> {
    let (long, short) = (rows(start, count), rows(0, columns as u64));
    let selections = if is_turned {
        vec![short, long]
    } else {
        vec![long, short]
    };
    let cells = dataset.read_slice::<Cell>(&SliceInfo { selections })?;
    let numbers: Vec<Option<Number>> = cells.into_iter().map(|Cell(number)| number).collect();
    let found = numbers.len() / columns.max(1);
    let (step, far) = if is_turned { (1, found) } else { (columns, 1) };
    let row = |index: usize| {
        order.map(|column| numbers.get(index * step + column * far).copied().flatten())
    };
    Ok((0..found).map(row).collect())
}

/// Reads t, x, y and p of `count` records from row `start` on of a dataset of compounds; the caller may have named
/// the fields.
pub fn read_records(
    dataset: &Dataset,
    start: u64,
    count: u64,
    given: Option<&[String; 4]>,
) -> Result<Vec<Row>, Error> {
    if given.is_none() {
        let records = read_rows::<Record>(dataset, start, count)?;
        return Ok(records.into_iter().map(|Record(row)| row).collect());
    }
    let (fields, _) = fields(dataset.dtype(), given).ok_or_else(no_number)?;
    let records = read_rows::<Bytes>(dataset, start, count)?;
    Ok(records
        .into_iter()
        .map(|Bytes(bytes)| Record::of(&bytes, &fields).0)
        .collect())
}

/// Reads `count` elements from row `start` on of a one-dimensional dataset.
pub fn read_rows<T: H5Type>(dataset: &Dataset, start: u64, count: u64) -> Result<Vec<T>, Error> {
    let selections = vec![rows(start, count)];
    let side = chunk_rows(dataset).unwrap_or(0);
    let chunk = usize::try_from(side)
        .unwrap_or(usize::MAX)
        .saturating_mul(T::element_size(dataset.dtype()))
        .min(filters::CHUNK_BYTES);
    let array = ecf::in_chunks_of(chunk, || dataset.read_slice::<T>(&SliceInfo { selections }))?;
    Ok(array.into_raw_vec_and_offset().0)
}

/// Returns the number of rows in a chunk; `None` if the dataset is not chunked.
pub fn chunk_rows(dataset: &Dataset) -> Option<u64> {
    dataset.chunks()?.first().copied().map(u64::from)
}

/// Returns the unpacked size of a dataset's chunks; 0 if it has none.
fn chunk_bytes(dataset: &Dataset) -> u64 {
    let size = match dataset.dtype() {
        Datatype::FixedPoint { size, .. } | Datatype::FloatingPoint { size, .. } => {
            u64::from(*size)
        }
        Datatype::Compound { size, .. } => u64::from(*size),
        _ => 8,
    };
    let sides = dataset.chunks().unwrap_or_default();
    if sides.is_empty() {
        return 0;
    }
    sides
        .iter()
        .fold(size, |bytes, side| bytes.saturating_mul(u64::from(*side)))
}
