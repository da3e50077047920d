//! Undoes the byte and bit shuffles of Blosc and bitshuffle, which store each byte or bit of the elements in a
//! plane of its own.

/// Number of elements whose bits share one byte of a plane.
const EIGHT: usize = 8;

/// Undoes a byte shuffle: plane k holds byte k of each element. Bytes after the last whole element are copied as
/// they are. `out` must be as long as `shuffled`.
pub fn unshuffle_bytes(shuffled: &[u8], element: usize, out: &mut [u8]) {
    let count = shuffled.len().checked_div(element).unwrap_or(0);
    out.copy_from_slice(shuffled);
    if count == 0 || element == 1 {
        return;
    }
    let whole = count * element;
    let planes = shuffled.get(..whole).unwrap_or_default();
    let elements = out.get_mut(..whole).unwrap_or_default();
    for (byte, plane) in planes.chunks_exact(count).enumerate() {
        let places = elements.iter_mut().skip(byte).step_by(element);
        for (to, from) in places.zip(plane) {
            *to = *from;
        }
    }
}

/// Undoes a bit shuffle: like [`unshuffle_bytes`], with a plane for bit 0 of byte 0, one for bit 1, and so on. The
/// first byte of a plane holds the bits of elements 0 to 7, the lowest first. Elements after the last group of
/// eight are copied as they are.
pub fn unshuffle_bits(shuffled: &[u8], element: usize, out: &mut [u8]) {
    let count = shuffled.len().checked_div(element).unwrap_or(0) / EIGHT * EIGHT;
    out.copy_from_slice(shuffled);
    if count == 0 {
        return;
    }
    let whole = count * element;
    let planes = shuffled.get(..whole).unwrap_or_default();
    let elements = out.get_mut(..whole).unwrap_or_default();
    let plane = count / EIGHT;
    for (byte, planes) in planes.chunks_exact(EIGHT * plane).enumerate() {
        for (index, eight) in elements.chunks_exact_mut(EIGHT * element).enumerate() {
            let mut bits = [0; EIGHT];
            let column = planes.iter().skip(index).step_by(plane);
            for (bit, from) in bits.iter_mut().zip(column) {
                *bit = *from;
            }
            let bytes = turned(bits);
            let places = eight.iter_mut().skip(byte).step_by(element);
            for (to, from) in places.zip(bytes) {
                *to = from;
            }
        }
    }
}

/// Transposes an 8 x 8 bit matrix: bit i of byte j becomes bit j of byte i. Squares of 1, 2 and 4 bits are swapped
/// across the diagonal.
fn turned(bytes: [u8; EIGHT]) -> [u8; EIGHT] {
    let mut all = u64::from_le_bytes(bytes);
    for (mask, shift) in [
        (0x00aa_00aa_00aa_00aa, 7),
        (0x0000_cccc_0000_cccc, 14),
        (0x0000_0000_f0f0_f0f0, 28),
    ] {
        let other: u64 = (all ^ all >> shift) & mask;
        all ^= other ^ other << shift;
    }
    all.to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_bits_go_back() {
        let mut out = [0; 7];
        unshuffle_bytes(b"acebdf!", 2, &mut out);
        assert_eq!(&out, b"abcdef!");
        for (element, count) in [(1, 16), (2, 16), (3, 24), (16, 8), (4, 19), (5, 7)] {
            let elements: Vec<u8> = (0..element * count)
                .map(|i| (i as u8).wrapping_mul(37) ^ (i / 7) as u8)
                .collect();
            let whole = count / 8 * 8;
            let mut planes = elements.clone();
            planes[..whole * element].fill(0);
            for (i, bytes) in elements[..whole * element].chunks(element).enumerate() {
                for bit in 0..8 * element {
                    let set = bytes[bit / 8] >> (bit % 8) & 1;
                    planes[bit * (whole / 8) + i / 8] |= set << (i % 8);
                }
            }
            let mut out = vec![0; elements.len()];
            unshuffle_bits(&planes, element, &mut out);
            assert_eq!(out, elements, "{count} of {element} bytes");
        }
    }

    #[test]
    fn elements_of_no_bytes_stay() {
        let mut out = [0; 3];
        unshuffle_bits(b"abc", 0, &mut out);
        assert_eq!(&out, b"abc");
        unshuffle_bytes(b"def", 0, &mut out);
        assert_eq!(&out, b"def");
    }
}
