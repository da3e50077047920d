//! Writes the few structures of an HDF5 file of columns: superblock version 0, object headers version 1, symbol
//! tables, and version 1 B-trees, which every release of HDF5's library reads (HDF5 File Format Specification,
//! version 3). Columns grow by chunks, so that several can be written side by side.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::file::MAGIC;

/// Address that leads nowhere.
const UNDEFINED: u64 = u64::MAX;

/// Size in bytes of the superblock, including the root's entry.
const SUPERBLOCK_BYTES: usize = 96;

/// Largest numbers of entries in a node of a group's tree, which the superblock states, and in a node of a chunk
/// tree, where this default holds.
const GROUP_ENTRIES: usize = 32;
const CHUNK_ENTRIES: usize = 64;

/// Largest number of members of a group: one node of symbols.
const MEMBERS_MAX: usize = 8;

/// Rows of a chunk: 512 kB of times, half of the cache that HDF5 has by default for a dataset.
const CHUNK_ROWS: usize = 1 << 16;

/// Fast; event columns become about as small as with h5py's default level.
const DEFLATE_LEVEL: u32 = 3;

// Kinds of messages in object headers.
const DATASPACE: u16 = 1;
const DATATYPE: u16 = 3;
const FILL_VALUE: u16 = 5;
const LAYOUT: u16 = 8;
const PIPELINE: u16 = 11;
const ATTRIBUTE: u16 = 12;
const SYMBOL_TABLE: u16 = 17;

// Numbers of filters.
const DEFLATE: u16 = 1;
const SHUFFLE: u16 = 2;

/// The type of a column's numbers, little-endian.
#[derive(Debug, Clone, Copy)]
pub struct Integer {
    /// Size in bytes: 1, 2, 4 or 8.
    pub bytes: u8,
    /// Whether numbers may be negative.
    pub signed: bool,
}

impl Integer {
    fn message(self) -> Vec<u8> {
        let mut message = vec![0x10, u8::from(self.signed) << 3, 0, 0];
        message.extend(u32::from(self.bytes).to_le_bytes());
        // Bit offset and number of bits.
        message.extend([0, 0, self.bytes * 8, 0]);
        message
    }
}

/// A file that grows at its end; its superblock is written last.
pub struct Growing {
    file: BufWriter<File>,
    position: u64,
}

impl Growing {
    /// Creates the file with room for the superblock.
    pub fn new(mut file: BufWriter<File>) -> std::io::Result<Self> {
        file.write_all(&[0; SUPERBLOCK_BYTES])?;
        let position = SUPERBLOCK_BYTES as u64;
        Ok(Self { file, position })
    }

    /// Appends a structure, aligned to 8 bytes, and returns its address.
    fn append(&mut self, bytes: &[u8]) -> std::io::Result<u64> {
        let address = self.position.next_multiple_of(8);
        let gap = [0; 8];
        let gap = gap.get(..(address - self.position) as usize);
        self.file.write_all(gap.unwrap_or_default())?;
        self.file.write_all(bytes)?;
        self.position = address + bytes.len() as u64;
        Ok(address)
    }

    /// Writes an object header with these messages, each a kind and a content; returns its address.
    fn header(&mut self, messages: &[(u16, Vec<u8>)]) -> std::io::Result<u64> {
        let mut body = Vec::new();
        for (kind, message) in messages {
            let size = message.len().next_multiple_of(8);
            body.extend([*kind, size as u16].map(u16::to_le_bytes).concat());
            body.extend([0; 4]);
            body.extend(message);
            body.resize(body.len() + size - message.len(), 0);
        }
        let mut header = vec![1, 0];
        header.extend((messages.len() as u16).to_le_bytes());
        // The reference count is 1.
        header.extend([1, body.len() as u32].map(u32::to_le_bytes).concat());
        header.extend([0; 4]);
        header.extend(body);
        self.append(&header)
    }

    /// Writes a group with these members, at most [`MEMBERS_MAX`], and attributes; returns its address.
    pub fn group(
        &mut self,
        members: &[(&str, u64)],
        attributes: &[(&str, i64)],
    ) -> std::io::Result<u64> {
        debug_assert!(members.len() <= MEMBERS_MAX, "one node of symbols");
        let mut members = members.to_vec();
        members.sort_unstable();
        // The empty name comes first.
        let mut names = vec![0; 8];
        let mut symbols = b"SNOD\x01\0".to_vec();
        symbols.extend((members.len() as u16).to_le_bytes());
        let mut last = 0;
        for (name, address) in members {
            last = names.len() as u64;
            names.extend(name.bytes());
            names.resize((names.len() + 1).next_multiple_of(8), 0);
            symbols.extend([last, address, 0, 0, 0].map(u64::to_le_bytes).concat());
        }
        symbols.resize(8 + 40 * MEMBERS_MAX, 0);
        let names_at = self.append(&names)?;
        let mut heap = b"HEAP\0\0\0\0".to_vec();
        // The offset of the heap's free list; 1 if there is none.
        let fields = [names.len() as u64, 1, names_at];
        heap.extend(fields.map(u64::to_le_bytes).concat());
        let heap = self.append(&heap)?;
        let symbols = self.append(&symbols)?;
        let mut tree = b"TREE\0\0\x01\0".to_vec();
        let entry = [UNDEFINED, UNDEFINED, 0, symbols, last];
        tree.extend(entry.map(u64::to_le_bytes).concat());
        tree.resize(24 + 8 * (2 * GROUP_ENTRIES + 1), 0);
        let tree = self.append(&tree)?;
        let mut messages = vec![(SYMBOL_TABLE, [tree, heap].map(u64::to_le_bytes).concat())];
        messages.extend(attributes.iter().map(|(name, value)| {
            let message = attribute(name, *value);
            (ATTRIBUTE, message)
        }));
        self.header(&messages)
    }

    /// Writes a dataset of a single i64; returns its address.
    pub fn scalar(&mut self, value: i64) -> std::io::Result<u64> {
        let data = self.append(&value.to_le_bytes())?;
        let mut layout = vec![3, 1];
        layout.extend([data, 8].map(u64::to_le_bytes).concat());
        self.header(&[
            (DATASPACE, SCALAR.to_vec()),
            (DATATYPE, I64.message()),
            (FILL_VALUE, fill_value(2)),
            (LAYOUT, layout),
        ])
    }

    /// Writes the superblock, whose root is the group at `root`, and flushes the file.
    pub fn finish(mut self, root: u64) -> std::io::Result<()> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        // Half of the largest numbers of entries in a node of symbols and in a node of a group's tree.
        bytes.extend([4, 0, GROUP_ENTRIES as u8 / 2, 0, 0, 0, 0, 0]);
        let end = self.position;
        let fields = [0, UNDEFINED, end, UNDEFINED, 0, root, 0, 0, 0];
        bytes.extend(fields.map(u64::to_le_bytes).concat());
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&bytes)?;
        self.file.flush()
    }
}

const I64: Integer = Integer {
    bytes: 8,
    signed: true,
};

/// Dataspace of a single number.
const SCALAR: [u8; 8] = [1, 0, 0, 0, 0, 0, 0, 0];

/// Returns the message of a fill value of zero; `allocation` is when space is allocated: late (2) or chunk by chunk
/// (3).
fn fill_value(allocation: u8) -> Vec<u8> {
    vec![2, allocation, 2, 1, 0, 0, 0, 0]
}

fn attribute(name: &str, value: i64) -> Vec<u8> {
    let of = I64.message();
    let lengths = [name.len() + 1, of.len(), SCALAR.len()];
    let mut message = vec![1, 0];
    message.extend(lengths.map(|length| (length as u16).to_le_bytes()).concat());
    for part in [&[name.as_bytes(), &[0]].concat(), &of, &SCALAR.to_vec()] {
        message.extend(part);
        message.resize(message.len().next_multiple_of(8), 0);
    }
    message.extend(value.to_le_bytes());
    message
}

/// A one-dimensional dataset that is being written, shuffled and deflated. It holds one chunk, and 12 bytes for
/// every chunk written.
pub struct Column {
    of: Integer,
    rows: u64,
    pending: Vec<u8>,
    /// Address and stored size in bytes of each chunk.
    chunks: Vec<(u64, u32)>,
}

/// A chunk of a column, as it is stored.
pub type Packed = std::io::Result<Vec<u8>>;

impl Column {
    /// Creates an empty column.
    pub fn new(of: Integer) -> Self {
        Self {
            of,
            rows: 0,
            pending: Vec::with_capacity(CHUNK_ROWS * usize::from(of.bytes)),
            chunks: Vec::new(),
        }
    }

    /// Returns how many numbers fit into the chunk.
    pub fn room(&self) -> usize {
        CHUNK_ROWS - self.pending.len() / usize::from(self.of.bytes)
    }

    /// Appends numbers, given as the bytes of its type, for which the chunk has room.
    pub fn extend<const N: usize>(&mut self, numbers: impl ExactSizeIterator<Item = [u8; N]>) {
        debug_assert_eq!(N, usize::from(self.of.bytes));
        self.rows += numbers.len() as u64;
        let begin = self.pending.len();
        self.pending.resize(begin + N * numbers.len(), 0);
        let places = self.pending[begin..].as_chunks_mut().0;
        for (place, number) in places.iter_mut().zip(numbers) {
            *place = number;
        }
    }

    /// Returns what packs the chunk, if it is full, or if it `ends` the column and is not empty.
    pub fn chunk(&mut self, ends: bool) -> Option<impl FnOnce() -> Packed + Send + 'static> {
        let size = usize::from(self.of.bytes);
        let bytes = CHUNK_ROWS * size;
        if self.pending.len() < bytes && (!ends || self.pending.is_empty()) {
            return None;
        }
        let mut rows = std::mem::replace(&mut self.pending, Vec::with_capacity(bytes));
        // Chunks have full length; rows after the last are not part of the dataset.
        rows.resize(bytes, 0);
        Some(move || deflated(&rows, size))
    }

    /// Writes the next chunk.
    pub fn place(&mut self, packed: Packed, file: &mut Growing) -> std::io::Result<()> {
        let packed = packed?;
        let address = file.append(&packed)?;
        self.chunks.push((address, packed.len() as u32));
        Ok(())
    }

    /// Writes the chunk index and the header, behind the last chunk; returns the dataset's address.
    pub fn finish(self, file: &mut Growing) -> std::io::Result<u64> {
        let size = u16::from(self.of.bytes);
        // One dimension of unlimited size.
        let mut space = vec![1, 1, 1, 0, 0, 0, 0, 0];
        space.extend([self.rows, UNDEFINED].map(u64::to_le_bytes).concat());
        let mut layout = vec![3, 2, 2];
        layout.extend(self.write_tree(file)?.to_le_bytes());
        let sides = [CHUNK_ROWS as u32, u32::from(size)];
        layout.extend(sides.map(u32::to_le_bytes).concat());
        let mut pipeline = vec![1, 2, 0, 0, 0, 0, 0, 0];
        for (filter, value) in [(SHUFFLE, size), (DEFLATE, DEFLATE_LEVEL as u16)] {
            // Number, no name, optional, one value of 32 bits, and 32 bits of padding after an odd number of values.
            let fields = [filter, 0, 1, 1, value, 0, 0, 0];
            pipeline.extend(fields.map(u16::to_le_bytes).concat());
        }
        file.header(&[
            (DATASPACE, space),
            (DATATYPE, self.of.message()),
            (FILL_VALUE, fill_value(3)),
            (LAYOUT, layout),
            (PIPELINE, pipeline),
        ])
    }

    /// Writes the tree of the chunks, leaves first; returns the root's address.
    fn write_tree(&self, file: &mut Growing) -> std::io::Result<u64> {
        let key = |chunk: usize, stored: u32| {
            let row = (chunk * CHUNK_ROWS) as u64;
            let mut key = [stored, 0].map(u32::to_le_bytes).concat();
            key.extend([row, 0].map(u64::to_le_bytes).concat());
            key
        };
        let keys = self.chunks.iter().enumerate();
        let mut entries: Vec<(Vec<u8>, u64)> = keys
            .map(|(chunk, (address, stored))| (key(chunk, *stored), *address))
            .collect();
        let end = key(self.chunks.len(), 0);
        let node_bytes = 24 + CHUNK_ENTRIES * (8 + end.len()) + end.len();
        let mut level = 0;
        loop {
            // Address of the level's first node; the others follow side by side.
            let first = file.position.next_multiple_of(8);
            let nodes = entries.len().div_ceil(CHUNK_ENTRIES);
            let at = |node: usize| first + (node * node_bytes) as u64;
            let mut above = Vec::with_capacity(nodes);
            let mut parts = entries.chunks(CHUNK_ENTRIES).enumerate().peekable();
            while let Some((index, part)) = parts.next() {
                let next = parts.peek().and_then(|(_, part)| part.first());
                let left = index.checked_sub(1).map_or(UNDEFINED, at);
                let right = next.map_or(UNDEFINED, |_| at(index + 1));
                let mut node = b"TREE\x01".to_vec();
                node.push(level);
                node.extend((part.len() as u16).to_le_bytes());
                node.extend([left, right].map(u64::to_le_bytes).concat());
                for (key, child) in part {
                    node.extend(key);
                    node.extend(child.to_le_bytes());
                }
                node.extend(next.map_or(&end, |(key, _)| key));
                node.resize(node_bytes, 0);
                let address = file.append(&node)?;
                above.extend(part.first().map(|(key, _)| (key.clone(), address)));
            }
            match above.as_slice() {
                [] => return Ok(UNDEFINED),
                [(_, root)] => return Ok(*root),
                _ => entries = above,
            }
            level += 1;
        }
    }
}

/// Shuffles and deflates the numbers of a chunk, of `size` bytes each.
fn deflated(numbers: &[u8], size: usize) -> Packed {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(DEFLATE_LEVEL));
    let mut plane = Vec::with_capacity(CHUNK_ROWS);
    for byte in 0..size {
        plane.clear();
        match size {
            2 => pick::<2>(numbers, byte, &mut plane),
            8 => pick::<8>(numbers, byte, &mut plane),
            _ => plane.extend(numbers.iter().skip(byte).step_by(size)),
        }
        encoder.write_all(&plane)?;
    }
    encoder.finish()
}

/// Appends a byte of every number.
fn pick<const N: usize>(numbers: &[u8], byte: usize, plane: &mut Vec<u8>) {
    let numbers: &[[u8; N]] = numbers.as_chunks().0;
    plane.extend(numbers.iter().map(|number| number[byte]));
}
