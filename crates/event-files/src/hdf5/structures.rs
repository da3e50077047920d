//! The few structures that an HDF5 file of columns has: superblock and object headers of versions 0 and 1,
//! symbol tables, B-trees of version 1, which every release of HDF5's library reads (HDF5 File Format
//! Specification, version 3). Columns grow by chunks, so that they can be written side by side.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};

use flate2::Compression;
use flate2::write::ZlibEncoder;

use super::file::MAGIC;

/// An address that leads nowhere.
const UNDEFINED: u64 = u64::MAX;

/// Bytes of the superblock, with the root's entry.
const SUPERBLOCK_BYTES: usize = 96;

/// Entries of nodes: of a group's tree, of a tree of chunks, where the superblock says nothing else.
const GROUP_ENTRIES: usize = 32;
const CHUNK_ENTRIES: usize = 64;

/// Members of a group, at the most: one node of symbols.
const MEMBERS_MAX: usize = 8;

/// Rows of a chunk: 512 kB of times, half of what HDF5 keeps of a dataset by default.
const CHUNK_ROWS: usize = 1 << 16;

/// Fast, and close to what h5py's default makes of event columns.
const DEFLATE_LEVEL: u32 = 3;

/// Kinds of messages in object headers.
const DATASPACE: u16 = 1;
const DATATYPE: u16 = 3;
const FILL_VALUE: u16 = 5;
const LAYOUT: u16 = 8;
const PIPELINE: u16 = 11;
const ATTRIBUTE: u16 = 12;
const SYMBOL_TABLE: u16 = 17;

/// Numbers of filters.
const DEFLATE: u16 = 1;
const SHUFFLE: u16 = 2;

/// Type of a column's numbers, little-endian.
#[derive(Debug, Clone, Copy)]
pub struct Integer {
    /// 1, 2, 4 or 8.
    pub bytes: u8,
    /// Whether there are numbers below 0.
    pub signed: bool,
}

impl Integer {
    fn message(self) -> Vec<u8> {
        let mut message = vec![0x10, u8::from(self.signed) << 3, 0, 0];
        message.extend(u32::from(self.bytes).to_le_bytes());
        // Offset and number of bits.
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
    /// Leaves room for the superblock.
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

    /// An object header of these messages: kind, content.
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
        // One reference to it.
        header.extend([1, body.len() as u32].map(u32::to_le_bytes).concat());
        header.extend([0; 4]);
        header.extend(body);
        self.append(&header)
    }

    /// A group of these members, at most [`MEMBERS_MAX`], with attributes; returns its address.
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
        // 1: the heap has no free place.
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

    /// A dataset of one number of 8 bytes; returns its address.
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

    /// Writes the superblock, which leads to the group at `root`.
    pub fn finish(mut self, root: u64) -> std::io::Result<()> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        // Half of the entries of a node of symbols and of a group's tree.
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

/// The dataspace of one number.
const SCALAR: [u8; 8] = [1, 0, 0, 0, 0, 0, 0, 0];

/// Zero; space is had late (2) or by chunks (3).
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

/// A dataset of one dimension being written, shuffled and deflated. It holds one chunk, and 12 bytes for
/// every chunk written.
pub struct Column {
    of: Integer,
    rows: u64,
    pending: Vec<u8>,
    /// Address and bytes of the chunks.
    chunks: Vec<(u64, u32)>,
}

impl Column {
    /// An empty column.
    pub fn new(of: Integer) -> Self {
        Self {
            of,
            rows: 0,
            pending: Vec::with_capacity(CHUNK_ROWS * usize::from(of.bytes)),
            chunks: Vec::new(),
        }
    }

    /// Appends a number: the bytes of its type.
    pub fn push(&mut self, file: &mut Growing, number: &[u8]) -> std::io::Result<()> {
        debug_assert_eq!(number.len(), usize::from(self.of.bytes));
        self.pending.extend_from_slice(number);
        self.rows += 1;
        if self.rows.is_multiple_of(CHUNK_ROWS as u64) {
            self.write_chunk(file)?;
        }
        Ok(())
    }

    fn write_chunk(&mut self, file: &mut Growing) -> std::io::Result<()> {
        let size = usize::from(self.of.bytes);
        // Chunks are whole: what is behind the last row is not part of the dataset.
        self.pending.resize(CHUNK_ROWS * size, 0);
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(DEFLATE_LEVEL));
        let mut plane = Vec::with_capacity(CHUNK_ROWS);
        for byte in 0..size {
            plane.clear();
            plane.extend(self.pending.iter().skip(byte).step_by(size));
            encoder.write_all(&plane)?;
        }
        let packed = encoder.finish()?;
        let address = file.append(&packed)?;
        self.chunks.push((address, packed.len() as u32));
        self.pending.clear();
        Ok(())
    }

    /// Writes the last chunk, the index and the header; returns the dataset's address.
    pub fn finish(mut self, file: &mut Growing) -> std::io::Result<u64> {
        if !self.pending.is_empty() {
            self.write_chunk(file)?;
        }
        let size = u16::from(self.of.bytes);
        // One dimension without limit.
        let mut space = vec![1, 1, 1, 0, 0, 0, 0, 0];
        space.extend([self.rows, UNDEFINED].map(u64::to_le_bytes).concat());
        let mut layout = vec![3, 2, 2];
        layout.extend(self.write_tree(file)?.to_le_bytes());
        let sides = [CHUNK_ROWS as u32, u32::from(size)];
        layout.extend(sides.map(u32::to_le_bytes).concat());
        let mut pipeline = vec![1, 2, 0, 0, 0, 0, 0, 0];
        for (filter, value) in [(SHUFFLE, size), (DEFLATE, DEFLATE_LEVEL as u16)] {
            // Number, no name, optional, one value and two bytes that make it even.
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

    /// The tree of the chunks, its leaves first; returns the root's address.
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
            // Where the first node will stand; the others of the level stand side by side behind it.
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
