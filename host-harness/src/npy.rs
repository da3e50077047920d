//! Volumes as `.npy` files.

use std::io::Write;
use std::path::Path;

use anyhow::Result;

use crate::output::OutputFile;

/// Writes a float32 array of shape C x H x W, C order, a plane at a time.
///
/// `fill` gets a channel and its H x W plane. Memory is one plane, whatever C is.
///
/// # Errors
/// An output that cannot be written.
pub fn write_planes(
    path: &Path,
    [channels, height, width]: [usize; 3],
    fill: &mut dyn FnMut(usize, &mut [f32]),
) -> Result<()> {
    let mut out = OutputFile::create(path)?;
    write(&mut out, [channels, height, width], fill)?;
    out.finish()
}

fn write(
    out: &mut impl Write,
    [channels, height, width]: [usize; 3],
    fill: &mut dyn FnMut(usize, &mut [f32]),
) -> std::io::Result<()> {
    out.write_all(&header(&format!("({channels}, {height}, {width})")))?;
    let mut plane = vec![0.0; height * width];
    for channel in 0..channels {
        fill(channel, &mut plane);
        for value in &plane {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    out.flush()
}

/// Version 1.0 header: padded with spaces to a multiple of 64 bytes, ending in a newline.
fn header(shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let prefix = 10;
    while (prefix + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.into_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layout_is_that_of_numpy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.npy");
        write_planes(&path, [2, 1, 3], &mut |channel, plane| {
            for (i, value) in plane.iter_mut().enumerate() {
                *value = (10 * channel + i) as f32;
            }
        })
        .unwrap();
        let bytes = std::fs::read(path).unwrap();
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let header_bytes = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!((10 + header_bytes) % 64, 0);
        let values: Vec<f32> = bytes[10 + header_bytes..]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(values, [0.0, 1.0, 2.0, 10.0, 11.0, 12.0]);
    }
}
