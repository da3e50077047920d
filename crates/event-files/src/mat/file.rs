//! Finds the variables of a MAT-file of level 5 and reads their numbers from front to back.

use std::io::{self, BufReader, Read};
use std::sync::{Arc, Mutex};

use event_types::error;
use event_types::stream::Result;
use flate2::bufread::ZlibDecoder;

use crate::input::ReadSeek;
use crate::input::section::{Section, Shared};
use crate::numpy::npy_header::{Dtype, Number};

/// Size in bytes of the header; the first variable follows it.
pub const HEADER_BYTES: usize = 128;

/// Number of bytes read from the source at once.
const BUFFER_BYTES: usize = 1 << 15;

/// Largest numbers of variables of a file, fields of a structure and bytes of a name; MATLAB's own names have at
/// most 63.
const VARIABLES_MAX: usize = 1 << 12;
const FIELDS_MAX: u64 = 1 << 8;
const NAME_BYTES_MAX: u64 = 1 << 6;
const DIMENSIONS_MAX: u64 = 32;

/// Greatest depth of structures inside structures.
const DEPTH_MAX: usize = 8;

// Types of elements; `dtype` maps those of numbers.
const INT8: u32 = 1;
const INT32: u32 = 5;
const UINT32: u32 = 6;
pub const MATRIX: u32 = 14;
pub const COMPRESSED: u32 = 15;

// Classes of arrays.
pub const STRUCTURE: u8 = 2;
const DOUBLE: u8 = 6;
const SINGLE: u8 = 7;
const UINT64: u8 = 15;

/// Flag of an array that has an imaginary part.
const COMPLEX: u32 = 0x800;

/// Returns whether the file's numbers are big-endian; `None` if this is no header of level 5. The header ends with
/// the version, 0x0100, and the letters `MI`, each stored as a 16-bit number.
pub fn byte_order(header: &[u8]) -> Option<bool> {
    match header.get(HEADER_BYTES - 4..HEADER_BYTES)? {
        [0, 1, b'I', b'M'] => Some(false),
        [1, 0, b'M', b'I'] => Some(true),
        _ => None,
    }
}

/// A variable of the file.
pub struct Variable {
    /// The variable's name.
    pub name: String,
    /// The variable's content.
    pub content: Content,
}

/// The content of a variable.
pub enum Content {
    /// An array of real numbers.
    Numbers(Array),
    /// A single structure, with those of its fields that are numbers.
    Structure(Vec<(String, Array)>),
    /// Text, cells, complex or sparse numbers, objects, or several structures.
    Other,
}

/// The place and type of an array's numbers.
#[derive(Debug, Clone, Copy)]
pub struct Array {
    place: Place,
    /// Offset of the first number within the unpacked place.
    start: u64,
    /// Length of the first dimension, and product of all others; the numbers are stored column by column.
    pub rows: u64,
    pub columns: u64,
    /// The type in which the numbers are stored: MATLAB stores floats that are whole as integers.
    pub dtype: Dtype,
    /// Whether the numbers are floats in MATLAB.
    pub is_float: bool,
}

impl Array {
    /// Returns the number of elements.
    pub const fn count(&self) -> u64 {
        self.rows * self.columns
    }

    /// Returns one of the columns.
    pub const fn column(&self, column: u64) -> Self {
        Self {
            start: self.start + column * self.rows * self.dtype.bytes as u64,
            columns: 1,
            ..*self
        }
    }
}

/// The place of an element in the file.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: u64,
    bytes: u64,
    packed: bool,
}

/// A MAT-file and its variables.
pub struct MatFile {
    name: String,
    source: Shared,
    big_endian: bool,
    variables: Vec<Variable>,
    /// Where and why the list of variables breaks off before the end of the file.
    damage: Option<(u64, String)>,
}

impl MatFile {
    /// Opens a file and finds all of its variables.
    ///
    /// # Errors
    /// The file is not a MAT-file of level 5, or it cannot be read. Later damage is reported by [`MatFile::damage`].
    pub fn open(mut source: Box<dyn ReadSeek>, name: &str) -> Result<Self> {
        let length = source
            .seek(io::SeekFrom::End(0))
            .map_err(|error| error!(Damaged, "{name}: cannot seek to its end: {error}"))?;
        let mut file = Self {
            name: name.to_owned(),
            source: Arc::new(Mutex::new(source)),
            big_endian: false,
            variables: Vec::new(),
            damage: None,
        };
        let mut header = [0; HEADER_BYTES];
        let read = Section::new(&file.source, 0, length).read_exact(&mut header);
        let order = read.ok().and_then(|()| byte_order(&header));
        file.big_endian =
            order.ok_or_else(|| file.error(0, "not a level 5 MAT-file: save it with -v7"))?;
        let mut at = HEADER_BYTES as u64;
        while at < length {
            match file.variable(at, length) {
                Ok((variable, nested, end)) => {
                    file.variables.push(variable);
                    file.variables.extend(nested);
                    at = end;
                }
                Err(what) => {
                    file.damage = Some((at, what));
                    break;
                }
            }
            if file.variables.len() > VARIABLES_MAX {
                file.damage = Some((at, format!("more than {VARIABLES_MAX} variables")));
                break;
            }
        }
        Ok(file)
    }

    /// Returns the name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns all variables, up to the first damage.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Returns where and why the list of variables breaks off before the end of the file, if it does.
    pub fn damage(&self) -> Option<event_types::stream::Error> {
        let (at, what) = self.damage.as_ref()?;
        Some(self.error(*at, what))
    }

    /// Returns an error at byte `at`.
    pub fn error(&self, at: u64, what: impl std::fmt::Display) -> event_types::stream::Error {
        error!(Damaged, "{}: byte {at}: {what}", self.name)
    }

    /// Returns an error about an array.
    pub fn error_in(
        &self,
        array: &Array,
        what: impl std::fmt::Display,
    ) -> event_types::stream::Error {
        self.error(array.place.at, what)
    }

    /// Reads the variable whose element begins at `at`; returns it, the structures inside it, and its end.
    fn variable(&self, at: u64, length: u64) -> Result<(Variable, Vec<Variable>, u64), String> {
        let whole = Place {
            at,
            bytes: length - at,
            packed: false,
        };
        let mut elements = Elements::new(self, whole);
        let tag = elements.tag()?;
        let end = at + tag.end();
        if end > length {
            let there = length - at;
            return Err(format!(
                "truncated: the variable has {} bytes, of which {there} are present",
                tag.end()
            ));
        }
        let mut nested = Vec::new();
        let (name, content) = match tag.kind {
            MATRIX => elements.matrix(&tag, &mut nested)?,
            COMPRESSED => {
                let packed = Place {
                    at: at + elements.at,
                    bytes: tag.bytes,
                    packed: true,
                };
                let mut elements = Elements::new(self, packed);
                match elements.tag()? {
                    tag if tag.kind == MATRIX => elements.matrix(&tag, &mut nested)?,
                    _ => (String::new(), Content::Other),
                }
            }
            _ => (String::new(), Content::Other),
        };
        Ok((Variable { name, content }, nested, end))
    }

    /// Opens an array for reading from number `first` on.
    ///
    /// # Errors
    /// The file cannot be read or is damaged.
    pub fn read(&self, array: &Array, first: u64) -> Result<Numbers, String> {
        let mut elements = Elements::new(self, array.place);
        elements.skip_to(array.start + first * array.dtype.bytes as u64)?;
        Ok(Numbers {
            data: elements.data,
            dtype: array.dtype,
            is_float: array.is_float,
            bytes: Vec::new(),
        })
    }
}

/// The numbers of an array, read from front to back.
pub struct Numbers {
    data: Data,
    dtype: Dtype,
    is_float: bool,
    bytes: Vec<u8>,
}

impl Numbers {
    /// Reads up to `count` numbers; returns how many were read and, if fewer, why.
    pub fn fill(&mut self, count: usize) -> (usize, Option<String>) {
        let size = self.dtype.bytes.max(1);
        self.bytes.resize(count * size, 0);
        let mut filled = 0;
        while let Some(rest) = self.bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            match self.data.read(rest) {
                Ok(0) => return (filled / size, Some("the array is truncated".to_owned())),
                Ok(n) => filled += n,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return (filled / size, Some(format!("damaged array: {error}"))),
            }
        }
        (count, None)
    }

    /// Returns one of the numbers that [`Numbers::fill`] read last, as a float if it is one in MATLAB.
    pub fn get(&self, index: usize) -> Option<Number> {
        let bytes = self.bytes.get(index * self.dtype.bytes..)?;
        let number = self.dtype.number(bytes)?;
        Some(if self.is_float {
            Number::Float(number.float())
        } else {
            number
        })
    }
}

/// The bytes of an element.
enum Data {
    Plain(BufReader<Section>),
    Packed(Box<ZlibDecoder<BufReader<Section>>>),
}

impl Read for Data {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(data) => data.read(bytes),
            Self::Packed(data) => data.read(bytes),
        }
    }
}

/// The tag at the start of an element.
struct Tag {
    kind: u32,
    bytes: u64,
    /// Offset of the tag's first byte.
    at: u64,
    /// Whether the data, at most 4 bytes, lies within the tag's own 8 bytes.
    small: bool,
}

impl Tag {
    /// Returns the offset of the next element.
    const fn end(&self) -> u64 {
        let bytes = if self.small {
            0
        } else if self.kind == COMPRESSED {
            self.bytes
        } else {
            self.bytes.next_multiple_of(8)
        };
        self.at + 8 + bytes
    }
}

/// The attributes of an array.
struct Head {
    name: String,
    class: u8,
    is_complex: bool,
    /// As in [`Array`]; their product fits into 64 bits.
    rows: u64,
    columns: u64,
}

/// The elements at a place, one after another.
struct Elements<'f> {
    file: &'f MatFile,
    place: Place,
    data: Data,
    at: u64,
}

impl<'f> Elements<'f> {
    fn new(file: &'f MatFile, place: Place) -> Self {
        let data = data(file, place, 0);
        Self {
            file,
            place,
            data,
            at: 0,
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), String> {
        let read = self.data.read_exact(bytes);
        read.map_err(|error| format!("damaged or truncated variable: {error}"))?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    fn word(&mut self) -> Result<u32, String> {
        let bytes = self.take()?;
        Ok(if self.file.big_endian {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    /// Continues at byte `at` of the place, which must not lie before the current one.
    fn skip_to(&mut self, at: u64) -> Result<(), String> {
        let skipped = at
            .checked_sub(self.at)
            .ok_or("damaged variable: an element is longer than the element that contains it")?;
        match &mut self.data {
            // Within the buffer's size, reading on is cheaper than seeking.
            Data::Plain(_) if skipped > BUFFER_BYTES as u64 => {
                self.data = data(self.file, self.place, at);
            }
            data => {
                let read = io::copy(&mut data.take(skipped), &mut io::sink());
                match read {
                    Ok(read) if read == skipped => {}
                    Ok(_) => return Err("truncated variable".to_owned()),
                    Err(error) => return Err(format!("damaged variable: {error}")),
                }
            }
        }
        self.at = at;
        Ok(())
    }

    fn tag(&mut self) -> Result<Tag, String> {
        let at = self.at;
        let word = self.word()?;
        let small = word >> 16 != 0;
        let (kind, bytes) = if small {
            (word & 0xffff, word >> 16)
        } else {
            (word, self.word()?)
        };
        if small && bytes > 4 {
            return Err(format!(
                "damaged variable: {word:#x} is not the tag of an element"
            ));
        }
        let bytes = u64::from(bytes);
        Ok(Tag {
            kind,
            bytes,
            at,
            small,
        })
    }

    /// Reads an element of type `kind` and at most `most` bytes; messages call it `what`.
    fn element(&mut self, kind: u32, most: u64, what: &str) -> Result<Vec<u8>, String> {
        let tag = self.tag()?;
        if tag.kind != kind || tag.bytes > most {
            let (found, bytes) = (tag.kind, tag.bytes);
            return Err(format!(
                "damaged variable: {what} are of type {found} and {bytes} bytes"
            ));
        }
        let mut bytes = vec![0; usize::try_from(tag.bytes).unwrap_or(0)];
        self.fill(&mut bytes)?;
        self.skip_to(tag.end())?;
        Ok(bytes)
    }

    fn words(&mut self, kind: u32, most: u64, what: &str) -> Result<Vec<u32>, String> {
        let bytes = self.element(kind, 4 * most, what)?;
        let word = if self.file.big_endian {
            u32::from_be_bytes
        } else {
            u32::from_le_bytes
        };
        Ok(bytes
            .as_chunks()
            .0
            .iter()
            .map(|bytes| word(*bytes))
            .collect())
    }

    /// Reads the name and content of the array that `tag` begins. Structures inside it are added to `nested`, each
    /// named by its place.
    fn matrix(
        &mut self,
        tag: &Tag,
        nested: &mut Vec<Variable>,
    ) -> Result<(String, Content), String> {
        let Some(head) = self.head(tag)? else {
            return Ok((String::new(), Content::Other));
        };
        let content = if head.class == STRUCTURE && head.rows * head.columns == 1 {
            Content::Structure(self.fields(&head.name, nested, DEPTH_MAX)?)
        } else {
            self.numbers(&head)?
                .map_or(Content::Other, Content::Numbers)
        };
        Ok((head.name, content))
    }

    /// Reads the attributes of the array that `tag` begins; `None` if it is empty.
    fn head(&mut self, tag: &Tag) -> Result<Option<Head>, String> {
        if tag.bytes == 0 {
            return Ok(None);
        }
        let flags = self.words(UINT32, 2, "flags")?;
        let flags = flags.first().copied().unwrap_or(0);
        let sides = self.words(INT32, DIMENSIONS_MAX, "dimensions")?;
        let name = self.element(INT8, NAME_BYTES_MAX, "the letters of the name")?;
        let name = String::from_utf8_lossy(&name).into_owned();
        let rows = sides.first().copied().map_or(0, u64::from);
        let mut others = sides.iter().skip(1).map(|side| u64::from(*side));
        let columns = others.try_fold(1_u64, u64::checked_mul);
        let bounded = columns.filter(|columns| columns.checked_mul(rows).is_some());
        let columns =
            bounded.ok_or_else(|| format!("damaged variable: {name} has too many elements"))?;
        Ok(Some(Head {
            name,
            class: flags as u8,
            is_complex: flags & COMPLEX != 0,
            rows,
            columns,
        }))
    }

    /// Returns the place of the numbers of an array whose attributes have been read; `None` if they are not real
    /// numbers.
    fn numbers(&mut self, head: &Head) -> Result<Option<Array>, String> {
        let Head { rows, columns, .. } = *head;
        if head.is_complex || !(DOUBLE..=UINT64).contains(&head.class) {
            return Ok(None);
        }
        let tag = self.tag()?;
        let count = rows * columns;
        let dtype = dtype(tag.kind, self.file.big_endian)
            .filter(|dtype| count.checked_mul(dtype.bytes as u64) == Some(tag.bytes));
        let dtype = dtype.ok_or_else(|| {
            let (name, kind, bytes) = (&head.name, tag.kind, tag.bytes);
            format!("damaged variable: {name}: {count} numbers in {bytes} bytes of type {kind}")
        })?;
        Ok(Some(Array {
            place: self.place,
            start: self.at,
            rows,
            columns,
            dtype,
            is_float: matches!(head.class, DOUBLE | SINGLE),
        }))
    }

    /// Returns the fields of a structure that are numbers.
    fn fields(
        &mut self,
        place: &str,
        nested: &mut Vec<Variable>,
        depth: usize,
    ) -> Result<Vec<(String, Array)>, String> {
        let length = self.words(INT32, 1, "lengths of names")?;
        let length = length.first().copied().map_or(0, u64::from);
        if !(1..=NAME_BYTES_MAX).contains(&length) {
            return Err(format!("damaged variable: names of {length} bytes"));
        }
        let names = self.element(
            INT8,
            FIELDS_MAX * length,
            "the letters of the fields' names",
        )?;
        let mut fields = Vec::new();
        for name in names.chunks_exact(usize::try_from(length).unwrap_or(1)) {
            let name = name.split(|byte| *byte == 0).next().unwrap_or_default();
            let name = String::from_utf8_lossy(name).into_owned();
            let tag = self.tag()?;
            if tag.kind != MATRIX {
                return Err(format!("damaged variable: field {name} is not an array"));
            }
            match self.head(&tag)? {
                Some(head)
                    if head.class == STRUCTURE
                        && head.rows * head.columns == 1
                        && depth > 0
                        && nested.len() < VARIABLES_MAX =>
                {
                    let name = format!("{place}/{name}");
                    let fields = self.fields(&name, nested, depth - 1)?;
                    let content = Content::Structure(fields);
                    nested.push(Variable { name, content });
                }
                Some(head) => {
                    let array = self.numbers(&head)?;
                    fields.extend(array.map(|array| (name, array)));
                }
                None => {}
            }
            self.skip_to(tag.end())?;
        }
        Ok(fields)
    }
}

/// Opens the data of a place: from its byte `at` on, or from its start if it is compressed.
fn data(file: &MatFile, place: Place, at: u64) -> Data {
    if place.packed {
        let section = Section::new(&file.source, place.at, place.bytes);
        let section = BufReader::with_capacity(BUFFER_BYTES, section);
        return Data::Packed(Box::new(ZlibDecoder::new(section)));
    }
    let section = Section::new(
        &file.source,
        place.at.saturating_add(at),
        place.bytes.saturating_sub(at),
    );
    Data::Plain(BufReader::with_capacity(BUFFER_BYTES, section))
}

/// Returns the type of the numbers of an element of this type.
fn dtype(kind: u32, big_endian: bool) -> Option<Dtype> {
    let (kind, bytes) = match kind {
        1 => (b'i', 1),
        2 => (b'u', 1),
        3 => (b'i', 2),
        4 => (b'u', 2),
        5 => (b'i', 4),
        6 => (b'u', 4),
        7 => (b'f', 4),
        9 => (b'f', 8),
        12 => (b'i', 8),
        13 => (b'u', 8),
        _ => return None,
    };
    Dtype::new(kind, big_endian, bytes)
}
