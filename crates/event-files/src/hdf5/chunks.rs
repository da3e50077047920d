//! Finds all chunks of a dataset at once. The library looks up each chunk from the root of the index, and collects
//! a whole version 1 B-tree for each; in long recordings that takes longer than reading the events.

use std::sync::Arc;

use hdf5_reader::{
    Dataset, Hdf5File, Storage,
    btree_v1::{BTreeV1Key, collect_btree_v1_leaves_storage},
    chunk_index::{ChunkEntry, collect_v2_chunk_entries_storage, single_chunk_entry},
    error::Error,
    extensible_array::collect_extensible_array_chunk_entries_storage,
    fixed_array::collect_fixed_array_chunk_entries_storage,
    messages::HdfMessage,
    messages::layout::{ChunkIndexing, DataLayout},
};

use super::file::Source;
use super::filters;

/// A chunk: its first row, and the place of its bytes in the file.
struct Chunk {
    first: u64,
    address: u64,
    bytes: usize,
}

/// The chunks of a one-dimensional dataset that a single filter packs, in order.
pub struct Chunks {
    source: Arc<Source>,
    chunks: Vec<Chunk>,
}

impl Chunks {
    /// Finds the chunks of a dataset that only the filter with this number packs. Returns `None` if the dataset is
    /// not of this kind or its index is damaged; reading with the library then reports the damage.
    pub fn find(
        file: &Hdf5File,
        source: &Arc<Source>,
        dataset: &Dataset,
        filter: u16,
    ) -> Option<Self> {
        let header = file.get_or_parse_header(dataset.address()).ok()?;
        let filters = header.messages.iter().find_map(|message| match message {
            HdfMessage::FilterPipeline(pipeline) => Some(&pipeline.filters),
            _ => None,
        })?;
        let ([only], [rows], [_]) = (filters.as_slice(), &*dataset.chunks()?, dataset.shape())
        else {
            return None;
        };
        let layout = header.messages.iter().find_map(|message| match message {
            HdfMessage::DataLayout(message) => Some(&message.layout),
            _ => None,
        });
        if only.id != filter || *rows == 0 {
            return None;
        }
        let mut chunks = Vec::new();
        for entry in entries(file, dataset, layout?, *rows).ok()? {
            let first = *entry.offsets.first()?;
            let bytes = usize::try_from(entry.size).ok()?;
            // The filter has left this chunk unpacked, or its size is not stated.
            if entry.filter_mask != 0 || !(1..=filters::CHUNK_BYTES).contains(&bytes) {
                continue;
            }
            chunks.push(Chunk {
                first,
                // Addresses count from the end of a user block.
                address: file.superblock().base_address.checked_add(entry.address)?,
                bytes,
            });
        }
        chunks.sort_by_key(|chunk| chunk.first);
        let are_apart = chunks.is_sorted_by(|a, b| a.first < b.first);
        are_apart.then(|| Self {
            source: source.clone(),
            chunks,
        })
    }

    /// Reads the chunk that begins at this row into `bytes`, still packed; `None` if there is no such chunk or it
    /// cannot be read.
    pub fn read(&self, first: u64, bytes: &mut Vec<u8>) -> Option<()> {
        let found = self
            .chunks
            .binary_search_by_key(&first, |chunk| chunk.first);
        let chunk = self.chunks.get(found.ok()?)?;
        self.source.read(chunk.address, chunk.bytes, bytes).ok()
    }
}

/// Returns the entries of the index of a dataset's chunks, which have `rows` rows each.
fn entries(
    file: &Hdf5File,
    dataset: &Dataset,
    layout: &DataLayout,
    rows: u32,
) -> Result<Vec<ChunkEntry>, Error> {
    let DataLayout::Chunked {
        address,
        chunk_indexing,
        ..
    } = layout
    else {
        return Ok(Vec::new());
    };
    let (storage, shape, sides) = (file.storage(), dataset.shape(), [rows]);
    let superblock = file.superblock();
    let (offset, length) = (superblock.offset_size, superblock.length_size);
    match chunk_indexing {
        None => tree(storage, *address, (offset, length), &sides),
        Some(ChunkIndexing::SingleChunk {
            filtered_size,
            filters,
        }) => Ok(vec![single_chunk_entry(
            *address,
            *filtered_size,
            *filters,
            1,
        )]),
        Some(ChunkIndexing::BTreeV2) => {
            collect_v2_chunk_entries_storage(storage, *address, offset, length, 1, &sides, None)
        }
        Some(ChunkIndexing::FixedArray { .. }) => collect_fixed_array_chunk_entries_storage(
            storage, *address, offset, length, shape, &sides, None,
        ),
        Some(ChunkIndexing::ExtensibleArray { .. }) => {
            collect_extensible_array_chunk_entries_storage(
                storage,
                *address,
                offset,
                length,
                shape,
                dataset.max_dims(),
                &sides,
                None,
            )
        }
        // Used only for chunks without filters.
        Some(ChunkIndexing::Implicit) => Ok(Vec::new()),
    }
}

/// Returns the leaves of a version 1 B-tree.
fn tree(
    storage: &dyn Storage,
    root: u64,
    (offset, length): (u8, u8),
    sides: &[u32],
) -> Result<Vec<ChunkEntry>, Error> {
    let leaves =
        collect_btree_v1_leaves_storage(storage, root, offset, length, Some(1), sides, None)?;
    let entry = |(key, address)| match key {
        BTreeV1Key::RawData {
            chunk_size,
            filter_mask,
            offsets,
        } => Ok(ChunkEntry {
            address,
            size: u64::from(chunk_size),
            filter_mask,
            offsets,
        }),
        BTreeV1Key::Group { .. } => Err(Error::InvalidBTreeSignature),
    };
    leaves.into_iter().map(entry).collect()
}
