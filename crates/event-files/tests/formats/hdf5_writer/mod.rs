//! Writes small HDF5 files like HDF5 1.6's library: superblock version 0, object headers version 1, symbol tables,
//! version 1 B-trees. It shares no code with the reader's crate.

pub mod ecf;

use std::io::Write;

/// Address that leads nowhere.
const UNDEFINED: u64 = u64::MAX;

/// Largest numbers of entries in a B-tree's node: of groups, of chunks.
const GROUP_ENTRIES: usize = 32;
const CHUNK_ENTRIES: usize = 64;

/// Largest number of members of a group: one symbol table node.
const MEMBERS: usize = 8;

/// The type of an element.
#[derive(Clone)]
pub enum Type {
    /// An integer: size in bytes, whether it is signed, whether it is big-endian.
    Integer(u8, bool, bool),
    /// A little-endian double.
    Double,
    /// Named fields with their offsets, and the size of the whole.
    Compound(Vec<(&'static str, u8, Type)>, u8),
}

impl Type {
    fn size(&self) -> usize {
        match self {
            Type::Integer(bytes, ..) => usize::from(*bytes),
            Type::Double => 8,
            Type::Compound(_, size) => usize::from(*size),
        }
    }

    fn message(&self) -> Vec<u8> {
        match self {
            Type::Integer(bytes, signed, big_endian) => {
                let bits = u8::from(*big_endian) | u8::from(*signed) << 3;
                let mut message = vec![0x10, bits, 0, 0, *bytes, 0, 0, 0];
                message.extend([0, 0, bytes * 8, 0]);
                message
            }
            Type::Double => {
                let mut message = vec![0x11, 0x20, 63, 0, 8, 0, 0, 0];
                message.extend([0, 0, 64, 0, 52, 11, 0, 52]);
                message.extend(1023_u32.to_le_bytes());
                message
            }
            Type::Compound(fields, size) => {
                let mut message = vec![0x36, fields.len() as u8, 0, 0, *size, 0, 0, 0];
                for (name, offset, of) in fields {
                    message.extend(name.bytes().chain([0, *offset]));
                    message.extend(of.message());
                }
                message
            }
        }
    }
}

/// The storage of a dataset.
#[derive(Clone)]
pub enum Storage {
    Contiguous,
    /// Chunks of this shape, packed by these filters in turn.
    Chunked(Vec<usize>, Vec<Filter>),
}

/// A filter that packs chunks.
#[derive(Clone, Copy, PartialEq)]
pub enum Filter {
    Shuffle,
    Deflate,
    /// Prophesee's filter for its compounds.
    Ecf(ecf::Form),
    /// Bitshuffle, with LZ4 (`true`) or without a codec.
    Bitshuffle(bool),
    /// Blosc 2: shuffled bytes packed by LZ4, in a frame.
    Blosc2,
    /// A filter that is only named, with this number.
    Other(u16),
}

/// A group or a dataset.
pub enum Node {
    Group(Vec<(&'static str, Node)>),
    Dataset {
        of: Type,
        shape: Vec<usize>,
        storage: Storage,
        data: Vec<u8>,
    },
}

/// Returns a file whose root has these members.
pub fn file(members: Vec<(&'static str, Node)>) -> Vec<u8> {
    let mut bytes = vec![0; 96];
    let root = write(&mut bytes, &Node::Group(members));
    let mut start = b"\x89HDF\r\n\x1a\n".to_vec();
    start.extend([0, 0, 0, 0, 0, 8, 8, 0]);
    start.extend([4, 0, 16, 0, 0, 0, 0, 0]);
    for address in [
        0,
        UNDEFINED,
        bytes.len() as u64,
        UNDEFINED,
        0,
        root,
        0,
        0,
        0,
    ] {
        start.extend(address.to_le_bytes());
    }
    bytes[..96].copy_from_slice(&start);
    bytes
}

/// Appends `part` and returns its address.
fn append(bytes: &mut Vec<u8>, part: &[u8]) -> u64 {
    bytes.resize(bytes.len().next_multiple_of(8), 0);
    let address = bytes.len() as u64;
    bytes.extend_from_slice(part);
    address
}

fn write(bytes: &mut Vec<u8>, node: &Node) -> u64 {
    match node {
        Node::Group(members) => write_group(bytes, members),
        Node::Dataset {
            of,
            shape,
            storage,
            data,
        } => write_dataset(bytes, of, shape, storage, data),
    }
}

fn header(bytes: &mut Vec<u8>, messages: &[(u16, Vec<u8>)]) -> u64 {
    let mut body = Vec::new();
    for (kind, message) in messages {
        let size = message.len().next_multiple_of(8);
        body.extend(kind.to_le_bytes());
        body.extend((size as u16).to_le_bytes());
        body.extend([0; 4]);
        body.extend(message);
        body.resize(body.len() + size - message.len(), 0);
    }
    let mut start = vec![1, 0];
    start.extend((messages.len() as u16).to_le_bytes());
    start.extend(1_u32.to_le_bytes());
    start.extend((body.len() as u32).to_le_bytes());
    start.extend([0; 4]);
    append(bytes, &[start, body].concat())
}

fn write_group(bytes: &mut Vec<u8>, members: &[(&'static str, Node)]) -> u64 {
    assert!(members.len() <= MEMBERS, "a group of one node");
    let mut members: Vec<_> = members.iter().collect();
    members.sort_by_key(|(name, _)| *name);
    let mut names = vec![0; 8];
    let mut symbols = b"SNOD\x01\0".to_vec();
    symbols.extend((members.len() as u16).to_le_bytes());
    let mut last = 0;
    for (name, node) in members {
        let address = write(bytes, node);
        last = names.len() as u64;
        names.extend(name.bytes());
        names.resize(names.len() / 8 * 8 + 8, 0);
        symbols.extend([last, address, 0, 0, 0].map(u64::to_le_bytes).concat());
    }
    symbols.resize(8 + 40 * MEMBERS, 0);
    let names_at = append(bytes, &names);
    let mut heap = b"HEAP\0\0\0\0".to_vec();
    // 1 means that the heap has no free space.
    heap.extend(
        [names.len() as u64, 1, names_at]
            .map(u64::to_le_bytes)
            .concat(),
    );
    let heap = append(bytes, &heap);
    let symbols = append(bytes, &symbols);
    let mut tree = b"TREE\0\0\x01\0".to_vec();
    let entry = [UNDEFINED, UNDEFINED, 0, symbols, last];
    tree.extend(entry.map(u64::to_le_bytes).concat());
    tree.resize(24 + 8 * (2 * GROUP_ENTRIES + 1), 0);
    let tree = append(bytes, &tree);
    let table = [tree, heap].map(u64::to_le_bytes).concat();
    header(bytes, &[(0x11, table)])
}

fn write_dataset(
    bytes: &mut Vec<u8>,
    of: &Type,
    shape: &[usize],
    storage: &Storage,
    data: &[u8],
) -> u64 {
    let mut space = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    space.extend(shape.iter().flat_map(|side| (*side as u64).to_le_bytes()));
    let mut messages = vec![(1, space), (3, of.message()), (5, vec![2, 2, 0, 0])];
    match storage {
        Storage::Contiguous => {
            let address = append(bytes, data);
            let mut layout = vec![3, 1];
            layout.extend([address, data.len() as u64].map(u64::to_le_bytes).concat());
            messages.push((8, layout));
        }
        Storage::Chunked(chunk, filters) => {
            let tree = write_chunks(bytes, of.size(), shape, chunk, filters, data);
            let mut layout = vec![3, 2, shape.len() as u8 + 1];
            layout.extend(tree.to_le_bytes());
            layout.extend(chunk.iter().flat_map(|side| (*side as u32).to_le_bytes()));
            layout.extend((of.size() as u32).to_le_bytes());
            messages.push((8, layout));
            if !filters.is_empty() {
                messages.push((11, pipeline(filters, of.size())));
            }
        }
    }
    header(bytes, &messages)
}

fn pipeline(filters: &[Filter], size: usize) -> Vec<u8> {
    let mut message = vec![1, filters.len() as u8, 0, 0, 0, 0, 0, 0];
    for filter in filters {
        let (number, value) = match filter {
            Filter::Deflate => (1, 6),
            Filter::Shuffle => (2, size as u32),
            Filter::Ecf(_) => (36559, 0),
            Filter::Blosc2 => (32026, 1),
            Filter::Bitshuffle(is_packed) => {
                message.extend([32008_u16, 0, 0, 5].map(u16::to_le_bytes).concat());
                let values = [0, 4, size as u32, 0, u32::from(*is_packed) * 2, 0];
                message.extend(values.map(u32::to_le_bytes).concat());
                continue;
            }
            Filter::Other(number) => (*number, 0),
        };
        message.extend([number, 0, 0, 1].map(u16::to_le_bytes).concat());
        // One value, padded to an even number of values.
        message.extend([value, 0].map(u32::to_le_bytes).concat());
    }
    message
}

/// Returns the key of a chunk's entry: stored bytes, mask of skipped filters, place in the dataset.
fn key(stored: u32, place: &[usize]) -> Vec<u8> {
    let mut key = [stored, 0].map(u32::to_le_bytes).concat();
    key.extend(place.iter().flat_map(|at| (*at as u64).to_le_bytes()));
    key.extend([0; 8]);
    key
}

fn write_chunks(
    bytes: &mut Vec<u8>,
    size: usize,
    shape: &[usize],
    chunk: &[usize],
    filters: &[Filter],
    data: &[u8],
) -> u64 {
    let columns: usize = shape.get(1).copied().unwrap_or(1);
    let [rows, wide] = [chunk[0], chunk.get(1).copied().unwrap_or(1)];
    let mut entries = Vec::new();
    for row in (0..shape[0]).step_by(rows) {
        for column in (0..columns).step_by(wide) {
            let mut raw = vec![0; rows * wide * size];
            for (i, element) in raw.chunks_exact_mut(size).enumerate() {
                let (r, c) = (row + i / wide, column + i % wide);
                if r < shape[0] && c < columns {
                    let at = (r * columns + c) * size;
                    element.copy_from_slice(&data[at..at + size]);
                }
            }
            for filter in filters {
                raw = match filter {
                    Filter::Shuffle => shuffle(&raw, size),
                    Filter::Deflate => deflate(&raw),
                    // The last chunk has only the events that exist.
                    Filter::Ecf(form) => pack_ecf(&raw[..size * rows.min(shape[0] - row)], *form),
                    Filter::Bitshuffle(false) => {
                        let block = size * bitshuffle_block(size);
                        raw.chunks(block)
                            .flat_map(|block| shuffle_bits(block, size))
                            .collect()
                    }
                    Filter::Bitshuffle(true) => bitshuffle(&raw, size),
                    Filter::Blosc2 => blosc2(&raw, size),
                    Filter::Other(_) => raw,
                };
            }
            let address = append(bytes, &raw);
            let place = [row, column];
            entries.push((key(raw.len() as u32, &place[..shape.len()]), address));
        }
    }
    if entries.is_empty() {
        return UNDEFINED;
    }
    let end = key(0, &shape.iter().map(|side| side + 1).collect::<Vec<_>>());
    let mut level = 0;
    loop {
        entries = entries
            .chunks(CHUNK_ENTRIES)
            .map(|part| {
                let mut node = b"TREE\x01".to_vec();
                node.push(level);
                node.extend((part.len() as u16).to_le_bytes());
                node.extend([UNDEFINED, UNDEFINED].map(u64::to_le_bytes).concat());
                for (key, child) in part {
                    node.extend(key);
                    node.extend(child.to_le_bytes());
                }
                node.extend(&end);
                node.resize(24 + CHUNK_ENTRIES * (8 + end.len()) + end.len(), 0);
                (part[0].0.clone(), append(bytes, &node))
            })
            .collect();
        level += 1;
        if let [(_, root)] = entries.as_slice() {
            return *root;
        }
    }
}

fn shuffle(raw: &[u8], size: usize) -> Vec<u8> {
    (0..size)
        .flat_map(|byte| raw.iter().skip(byte).step_by(size).copied())
        .collect()
}

fn deflate(raw: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(raw).expect("memory");
    encoder.finish().expect("memory")
}

/// Packs Prophesee's compounds: x, y (u16), p (i16), two unused bytes, t (i64).
fn pack_ecf(raw: &[u8], form: ecf::Form) -> Vec<u8> {
    let number = |bytes: &[u8]| u16::from_le_bytes([bytes[0], bytes[1]]);
    let event = |record: &[u8]| {
        let t = u64::from_le_bytes(record[8..].try_into().expect("16 bytes"));
        (t, number(record), number(&record[2..]), record[4])
    };
    let events: Vec<ecf::Numbers> = raw.chunks_exact(16).map(event).collect();
    ecf::pack(&events, form, usize::MAX)
}

/// Returns the number of elements in a block if the filter's values do not state it.
fn bitshuffle_block(size: usize) -> usize {
    (8192 / size / 8 * 8).max(128)
}

/// Shuffles the bits of eight elements at a time; the remaining elements are unchanged.
fn shuffle_bits(raw: &[u8], size: usize) -> Vec<u8> {
    let whole = raw.len() / size / 8 * 8;
    let mut planes = raw.to_vec();
    planes[..whole * size].fill(0);
    for (i, element) in raw[..whole * size].chunks_exact(size).enumerate() {
        for bit in 0..8 * size {
            let set = element[bit / 8] >> (bit % 8) & 1;
            planes[bit * (whole / 8) + i / 8] |= set << (i % 8);
        }
    }
    planes
}

fn bitshuffle(raw: &[u8], size: usize) -> Vec<u8> {
    let block = size * bitshuffle_block(size);
    let mut packed = (raw.len() as u64).to_be_bytes().to_vec();
    packed.extend((block as u32).to_be_bytes());
    let whole = raw.len() / (8 * size) * (8 * size);
    for block in raw[..whole].chunks(block) {
        let block = lz4_flex::block::compress(&shuffle_bits(block, size));
        packed.extend((block.len() as u32).to_be_bytes());
        packed.extend(block);
    }
    packed.extend(&raw[whole..]);
    packed
}

/// Returns a Blosc 2 buffer: a header of 32 bytes, the blocks' offsets, the blocks, each of one stream.
fn blosc2_buffer(raw: &[u8], size: usize, block: usize) -> Vec<u8> {
    let blocks: Vec<Vec<u8>> = raw
        .chunks(block)
        .map(|block| lz4_flex::block::compress(&shuffle(block, size)))
        .collect();
    let mut place = 32 + 4 * blocks.len();
    let mut places = Vec::new();
    let mut streams = Vec::new();
    for block in &blocks {
        places.extend((place as u32).to_le_bytes());
        streams.extend((block.len() as u32).to_le_bytes());
        streams.extend(block);
        place += 4 + block.len();
    }
    // Version 5, LZ4, not split, a header of 32 bytes.
    let mut buffer = vec![5, 1, 0x35, size as u8];
    let lengths = [raw.len(), block, place];
    buffer.extend(lengths.map(|length| (length as u32).to_le_bytes()).concat());
    buffer.extend([0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    [buffer, places, streams].concat()
}

/// Returns a frame of two buffers and their index; a buffer of zeros is only in the index.
fn blosc2(raw: &[u8], size: usize) -> Vec<u8> {
    let each = (raw.len() / 2).next_multiple_of(size);
    let (mut buffers, mut index) = (Vec::new(), Vec::new());
    for part in raw.chunks(each) {
        if part.iter().all(|byte| *byte == 0) {
            index.extend((0x81_u64 << 56).to_le_bytes());
        } else {
            index.extend((buffers.len() as u64).to_le_bytes());
            buffers.extend(blosc2_buffer(part, size, 1000 * size));
        }
    }
    let mut frame = b"\x9e\xa8b2frame\0\xd2\0\0\0\x61\xcf".to_vec();
    let end = 0x61 + buffers.len();
    frame.extend((end as u64).to_be_bytes());
    frame.extend(b"\xa4\x12\0\x51\x03");
    for length in [raw.len(), buffers.len()] {
        frame.push(0xd3);
        frame.extend((length as u64).to_be_bytes());
    }
    for length in [size, 1000 * size, each] {
        frame.push(0xd2);
        frame.extend((length as u32).to_be_bytes());
    }
    frame.extend(b"\xd1\0\x01\xd1\0\x01\xc2\xd8\x06");
    frame.extend([0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    // No named metadata.
    frame.extend(b"\x93\xcd\0\x07\xde\0\0\xdc\0\0");
    [frame, buffers, blosc2_buffer(&index, 8, index.len())].concat()
}
