//! Bytes and bits of elements put together again that stand in a plane for each, as Blosc and bitshuffle have
//! them.

/// Elements whose bits are in one byte of a plane.
const EIGHT: usize = 8;

/// Puts the bytes of elements together: plane 0 has the first byte of each, and so on; what is left stays behind.
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

/// As [`unshuffle_bytes`] for bits: a plane for bit 0 of byte 0, for bit 1 and so on; the bits of elements 0 to 7
/// are in its first byte, the lowest first. Elements beyond the last eight stay behind as they are.
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

/// Bit i of byte j where bit j of byte i was: squares of 1, 2 and 4 bits change places across the diagonal.
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
