//! General compressors: xz, and Zstandard if the program was built with it.

use std::io::{Read, Write};

use anyhow::{Context, Result};
use lzma_rust2::{XzOptions, XzReader, XzWriter};

/// Compression level of xz.
const PRESET: u32 = 9;
/// Smallest dictionary of LZMA2.
const DICTIONARY_MIN: usize = 4096;

/// Compresses as `xz -9`, with a CRC-64. The dictionary is no larger than needed for the bytes: a larger one would
/// take memory and find nothing more.
///
/// # Errors
/// Never fails for bytes in memory.
pub fn xz(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut options = XzOptions::with_preset(PRESET);
    let most = options.lzma_options.dict_size;
    let enough = bytes.len().next_power_of_two().max(DICTIONARY_MIN);
    options.lzma_options.dict_size = u32::try_from(enough).unwrap_or(most).min(most);
    let mut writer = XzWriter::new(Vec::new(), options).context("xz")?;
    writer.write_all(bytes).context("xz")?;
    writer.finish().context("xz")
}

/// Decompresses the output of [`xz`].
///
/// # Errors
/// Fails on other bytes.
pub fn unxz(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut found = Vec::new();
    let mut reader = XzReader::new(bytes, false);
    reader.read_to_end(&mut found).context("xz")?;
    Ok(found)
}

/// Compresses to one Zstandard frame; `level` is 1 to 22.
///
/// # Errors
/// Never fails for bytes in memory.
#[cfg(any(feature = "zstd", test))]
pub fn zstd(bytes: &[u8], level: i32) -> Result<Vec<u8>> {
    zstd::bulk::compress(bytes, level).context("zstd")
}

/// Decompresses the output of [`zstd`], with a decoder that shares no code with it.
///
/// # Errors
/// Fails on other bytes.
#[cfg(any(feature = "zstd", test))]
pub fn unzstd(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut found = Vec::new();
    let mut reader = ruzstd::decoding::StreamingDecoder::new(bytes).context("zstd")?;
    reader.read_to_end(&mut found).context("zstd")?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back() {
        let many: Vec<u8> = (0..300_000_u32)
            .map(|i| (i.wrapping_mul(i) >> 7) as u8)
            .collect();
        for bytes in [&[][..], &[7], &many] {
            assert_eq!(unxz(&xz(bytes).unwrap()).unwrap(), bytes);
            assert_eq!(unzstd(&zstd(bytes, 19).unwrap()).unwrap(), bytes);
        }
        assert!(unxz(&many).is_err() && unzstd(&many).is_err());
    }

    #[test]
    fn runs_take_next_to_nothing() {
        let zeros = vec![0; 1 << 20];
        assert!(xz(&zeros).unwrap().len() < 1000);
        assert!(zstd(&zeros, 19).unwrap().len() < 1000);
    }
}
