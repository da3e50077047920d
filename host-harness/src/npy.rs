//! Arrays of NumPy, written as streams.

use std::io::{self, Read, Write};

/// Writes an array of shape `sides`, whose bytes in C order are `values`.
///
/// # Errors
/// Reading or writing fails.
pub fn write_array(
    out: &mut impl Write,
    dtype: &str,
    sides: &[u64],
    mut values: impl Read,
) -> io::Result<()> {
    out.write_all(&header(dtype, sides))?;
    io::copy(&mut values, out)?;
    Ok(())
}

/// Returns the version 1.0 header of an array in C order, padded with spaces to a multiple of 64 bytes and ended by
/// a newline.
#[must_use]
pub fn header(dtype: &str, sides: &[u64]) -> Vec<u8> {
    // Written like a tuple in Python: (), (1,), (1, 2).
    let sides: Vec<String> = sides.iter().map(ToString::to_string).collect();
    let comma = if sides.len() == 1 { "," } else { "" };
    let shape = sides.join(", ");
    let mut text =
        format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({shape}{comma}), }}");
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
    fn headers_are_numpy_s() {
        for (sides, shape) in [
            (&[][..], "()"),
            (&[3], "(3,)"),
            (&[4, 2], "(4, 2)"),
            (&[7, 5, 260, 346], "(7, 5, 260, 346)"),
        ] {
            let bytes = header("<f4", sides);
            assert_eq!(bytes.len() % 64, 0);
            assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
            assert_eq!(
                usize::from(u16::from_le_bytes([bytes[8], bytes[9]])),
                bytes.len() - 10
            );
            let text = std::str::from_utf8(&bytes[10..]).unwrap();
            let wanted = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
            assert!(text.starts_with(&wanted) && text.ends_with('\n'), "{text}");
        }
    }
}
