//! Registers the functions that unpack chunks of HDF5 files, in addition to the library's own filters. The filters'
//! numbers are those of HDF5's list of registered plugins.

use hdf5_reader::{FilterRegistry, error::Error};

use super::{bitshuffle, blosc, blosc2, copies, ecf};
use crate::unpack;

/// Largest unpacked size of a chunk; HDF5's library writes at most a few MB unless configured otherwise.
pub const CHUNK_BYTES: usize = 64 << 20;

const LZF: u16 = 32000;
const BLOSC: u16 = 32001;
const LZ4: u16 = 32004;
const BITSHUFFLE: u16 = 32008;
const ZSTANDARD: u16 = 32015;
const BLOSC2: u16 = 32026;
pub const ECF: u16 = 36559;

/// Compression filters that are not supported: number and name.
const NOT_READ: [(&str, &str); 3] = [("307", "bzip2"), ("32013", "ZFP"), ("32022", "SZ3")];

/// Returns what the user can do about a filter that is not supported.
pub fn advice(what: &str) -> String {
    let known = NOT_READ.iter().find(|(number, _)| what.ends_with(number));
    let called = known.map_or(String::new(), |(_, name)| format!(" ({name})"));
    format!("{called}: rewrite it with gzip: h5repack -f GZIP=4 IN OUT")
}

/// Returns the registry of all supported filters.
pub fn registry() -> FilterRegistry {
    let mut registry = FilterRegistry::new();
    let mut add = |number, name: &'static str, unpack: fn(&[u8]) -> Result<Vec<u8>, String>| {
        let filter = move |bytes: &[u8]| {
            unpack(bytes).map_err(|what| Error::DecompressionError(format!("{name}: {what}")))
        };
        registry.register(number, Box::new(move |_, bytes, _| filter(bytes)));
    };
    add(LZF, "LZF", |bytes| damaged(copies::lzf(bytes, CHUNK_BYTES)));
    add(BLOSC, "Blosc", |bytes| blosc::unpack(bytes, CHUNK_BYTES));
    add(BLOSC2, "Blosc 2", |bytes| {
        blosc2::unpack(bytes, CHUNK_BYTES)
    });
    add(LZ4, "LZ4", |bytes| damaged(lz4(bytes)));
    add(ZSTANDARD, "Zstandard", |bytes| {
        damaged(unpack::zstandard(bytes, CHUNK_BYTES))
    });
    add(ECF, "ECF", ecf::unpack);
    let bitshuffle = |bytes: &[u8], values: &[u32]| {
        let unpacked = bitshuffle::unpack(bytes, values);
        unpacked.map_err(|what| Error::DecompressionError(format!("bitshuffle: {what}")))
    };
    registry.register(
        BITSHUFFLE,
        Box::new(move |filter, bytes, _| bitshuffle(bytes, &filter.client_data)),
    );
    #[cfg(feature = "eecvs")]
    registry.register(
        eecvs_hdf5::NUMBER,
        Box::new(|filter, bytes, _| {
            let layout = eecvs_hdf5::Layout::from_values(&filter.client_data);
            let rows = layout.and_then(|layout| eecvs_hdf5::unpack(bytes, &layout, CHUNK_BYTES));
            rows.map_err(|what| Error::DecompressionError(format!("EECVS: {what}")))
        }),
    );
    registry
}

fn damaged(unpacked: Option<Vec<u8>>) -> Result<Vec<u8>, String> {
    unpacked.ok_or_else(|| "damaged data".to_owned())
}

/// Unpacks HDF5's framing of LZ4. Its big-endian numbers are the unpacked size in bytes (u64) and the block size in
/// bytes (u32); each block follows its packed size in bytes (u32) and is stored if that equals its unpacked size.
fn lz4(bytes: &[u8]) -> Option<Vec<u8>> {
    let (size, rest) = bytes.split_first_chunk()?;
    let (block, mut rest) = rest.split_first_chunk()?;
    let size = usize::try_from(u64::from_be_bytes(*size)).ok()?;
    let block = usize::try_from(u32::from_be_bytes(*block)).ok()?;
    if size > CHUNK_BYTES || (block == 0 && size > 0) {
        return None;
    }
    let mut out = Vec::new();
    while out.len() < size {
        let (length, behind) = rest.split_first_chunk()?;
        let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
        let (packed, behind) = behind.split_at_checked(length)?;
        let unpacked = block.min(size - out.len());
        if length == unpacked {
            out.extend_from_slice(packed);
        } else {
            let bytes = lz4_flex::block::decompress(packed, unpacked).ok()?;
            if bytes.len() != unpacked {
                return None;
            }
            out.extend(bytes);
        }
        rest = behind;
    }
    Some(out)
}
