//! Byte strings packed as literals and copies of what was unpacked before: blosclz, which is Blosc's own
//! codec, and LZF, which h5py brings.

/// Largest near distance of blosclz; farther copies carry two more bytes.
const BLOSCLZ_NEAR_MAX: usize = 8191;

/// Bytes that are still to be read.
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

/// Appends `count` bytes that stand `distance` back, which may reach into what is being appended.
fn copy(out: &mut Vec<u8>, distance: usize, count: usize, most: usize) -> Option<()> {
    let start = out.len().checked_sub(distance)?;
    if distance == 0 || count > most.checked_sub(out.len())? {
        return None;
    }
    let mut left = count;
    while left > 0 {
        // What a round appends doubles what the next may take.
        let part = left.min(out.len() - start);
        out.extend_from_within(start..start + part);
        left -= part;
    }
    Some(())
}

/// Unpacks blosclz to exactly `size` bytes; `None` where the bytes are damaged.
///
/// A byte below 32 is followed by so many literals and one. Else its upper 3 bits are a length, of which 7
/// goes on in further bytes up to the first that is not 255, and its lower 5 bits with the byte behind are
/// the distance less one; if all 13 bits are set, two bytes, big-endian, follow that are added to 8,191.
/// A copy has 2 bytes more than its length says.
pub fn blosclz(packed: &[u8], size: usize) -> Option<Vec<u8>> {
    let mut packed = Packed(packed);
    let mut out = Vec::with_capacity(size);
    // The upper bits of the first byte are the codec's mark.
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

/// Unpacks LZF to at most `most` bytes; `None` where the bytes are damaged.
///
/// A byte below 32 is followed by so many literals and one. Else its upper 3 bits are a length, to which 7
/// adds the byte behind, and its lower 5 bits with one more byte are the distance less one. A copy has 2
/// bytes more than its length says.
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
        // Two literals, a copy of 5 from a distance of 2.
        let packed = [1, b'a', b'b', 3 << 5, 1];
        assert_eq!(lzf(&packed, 7).as_deref(), Some(&b"abababa"[..]));
        assert_eq!(blosclz(&packed, 7).as_deref(), Some(&b"abababa"[..]));
        // One byte more than there is room for, and a distance beyond the start.
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
        // 9 + 255 + 3 bytes from a distance of 8,192 + 258.
        packed.extend([0xff, 255, 3, 255, 1, 2]);
        let start = want.len() - (8191 + 258 + 1);
        want.extend_from_within(start..start + 9 + 255 + 3);
        assert_eq!(blosclz(&packed, want.len()), Some(want));
    }
}
