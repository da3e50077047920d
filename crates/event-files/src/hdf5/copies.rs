//! Unpacks byte strings that consist of literals and copies of earlier output: blosclz, Blosc's own codec, and LZF,
//! which comes with h5py.

/// Largest near distance of blosclz; larger distances take two more bytes.
const BLOSCLZ_NEAR_MAX: usize = 8191;

/// The bytes that are still to be read.
struct Packed<'a>(&'a [u8]);

impl<'a> Packed<'a> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.0.split_first()?;
        self.0 = rest;
        Some(*first)
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }
}

/// Appends `count` bytes, copied from `distance` bytes back; the copy may overlap its own output. `None` if the
/// distance is invalid or the result would be longer than `most`.
fn copy(out: &mut Vec<u8>, distance: usize, count: usize, most: usize) -> Option<()> {
    let start = out.len().checked_sub(distance)?;
    if distance == 0 || count > most.checked_sub(out.len())? {
        return None;
    }
    let mut left = count;
    while left > 0 {
        // Each round doubles the number of bytes that the next one may copy.
        let part = left.min(out.len() - start);
        out.extend_from_within(start..start + part);
        left -= part;
    }
    Some(())
}

/// Unpacks blosclz to exactly `size` bytes; `None` if the bytes are damaged.
///
/// A control byte c below 32 is followed by c + 1 literals. Any other control byte is a copy: its upper 3 bits are
/// the length, to which, if it is 7, further bytes are added up to and including the first that is not 255. Its
/// lower 5 bits and the next byte are the distance less 1; if all 13 bits are set, a big-endian u16 follows that is
/// added to 8,191. The number of bytes copied is the length plus 2.
pub fn blosclz(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut packed = Packed(packed);
    let mut out = Vec::with_capacity(size);
    // The upper bits of the first byte identify the codec.
    let mut next = packed.byte().map(|control| control & 31);
    while let Some(control) = next {
        let control = usize::from(control);
        if control < 32 {
            let literals = packed.take(control + 1)?;
            if literals.len() > size - out.len() {
                return None;
            }
            out.extend_from_slice(literals);
        } else {
            let mut count = (control >> 5) + 2;
            if control >> 5 == 7 {
                loop {
                    let more = packed.byte()?;
                    count += usize::from(more);
                    if more != u8::MAX {
                        break;
                    }
                }
            }
            let mut distance = (control & 31) << 8 | usize::from(packed.byte()?);
            if distance == BLOSCLZ_NEAR_MAX {
                let far = [packed.byte()?, packed.byte()?];
                distance += usize::from(u16::from_be_bytes(far));
            }
            copy(&mut out, distance + 1, count, size)?;
        }
        next = packed.byte();
    }
    (out.len() == size).then_some(out)
}

/// Unpacks LZF to at most `most` bytes; `None` if the bytes are damaged.
///
/// A control byte c below 32 is followed by c + 1 literals. Any other control byte is a copy: its upper 3 bits are
/// the length, to which, if it is 7, the next byte is added. Its lower 5 bits and one more byte are the distance
/// less 1. The number of bytes copied is the length plus 2.
pub fn lzf(packed: &[u8], most: usize) -> Option<Vec<u8>> {
    let mut packed = Packed(packed);
    let mut out = Vec::new();
    while let Some(control) = packed.byte() {
        let control = usize::from(control);
        if control < 32 {
            let literals = packed.take(control + 1)?;
            if literals.len() > most - out.len() {
                return None;
            }
            out.extend_from_slice(literals);
            continue;
        }
        let mut count = (control >> 5) + 2;
        if control >> 5 == 7 {
            count += usize::from(packed.byte()?);
        }
        let distance = ((control & 31) << 8 | usize::from(packed.byte()?)) + 1;
        copy(&mut out, distance, count, most)?;
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_reach_into_themselves() {
        // Two literals, then a copy of 5 bytes from distance 2.
        let packed = [1, b'a', b'b', 3 << 5, 1];
        assert_eq!(lzf(&packed, 7).as_deref(), Some(&b"abababa"[..]));
        assert_eq!(blosclz(&packed, 7).as_deref(), Some(&b"abababa"[..]));
        // One byte too many for the room, one byte too few, and a distance beyond the start.
        assert_eq!(lzf(&packed, 6), None);
        assert_eq!(blosclz(&packed, 8), None);
        assert_eq!(lzf(&[0, b'a', 3 << 5, 1], 9), None);
    }

    #[test]
    fn long_and_far_copies() {
        let mut packed: Vec<u8> = Vec::new();
        let mut want: Vec<u8> = Vec::new();
        for i in 0..300_u16 {
            let part: Vec<u8> = (0..32).map(|j| (i * 7 + i / 9 * j) as u8).collect();
            packed.push(31);
            packed.extend(&part);
            want.extend(part);
        }
        // A copy of 9 + 255 + 3 bytes from distance 8,192 + 258.
        packed.extend([0xff, 255, 3, 255, 1, 2]);
        let start = want.len() - (8191 + 258 + 1);
        want.extend_from_within(start..start + 9 + 255 + 3);
        assert_eq!(blosclz(&packed, want.len()), Some(want));
    }
}
