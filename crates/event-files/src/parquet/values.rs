//! Decodes the values of a Parquet page one after another (plain, dictionary, delta, byte stream split, runs) and
//! encodes deltas and runs (Encodings.md of Apache Parquet's format).

use super::thrift::{Compact, put_integer, put_varint};
use crate::numpy::npy_header::{Dtype, Number};
use crate::table::columns::Stored;

/// Largest number of values in a miniblock of a delta block, and largest number of miniblocks.
const PART_VALUES_MAX: usize = 1 << 16;
const PARTS_MAX: usize = 512;

/// Numbers of values in a delta block and in a miniblock, as every known writer has them.
const BLOCK_VALUES: usize = 128;
const PART_VALUES: usize = 32;

// Numbers of encodings.
pub const PLAIN: i64 = 0;
const PLAIN_DICTIONARY: i64 = 2;
pub const RLE: i64 = 3;
pub const DELTA: i64 = 5;
pub const DICTIONARY: i64 = 8;
const SPLIT: i64 = 9;

/// Returns the `width` bits from bit `at` on, the lowest first.
#[inline]
fn bits(bytes: &[u8], at: usize, width: usize) -> Option<u64> {
    let first = at / 8;
    // The most frequent case.
    if at % 8 + width < 64
        && let Some(eight) = bytes.get(first..).and_then(<[u8]>::first_chunk)
    {
        return Some(u64::from_le_bytes(*eight) >> (at % 8) & ((1 << width) - 1));
    }
    bits_at_end(bytes, at, width)
}

/// As [`bits`], of any width, anywhere.
#[inline(never)]
fn bits_at_end(bytes: &[u8], at: usize, width: usize) -> Option<u64> {
    let mut value = 0_u128;
    let first = at / 8;
    let last = (at + width).div_ceil(8);
    for (index, byte) in bytes.get(first..last)?.iter().enumerate() {
        value |= u128::from(*byte) << (8 * index);
    }
    let mask = (1_u128 << width) - 1;
    Some((value >> (at % 8) & mask) as u64)
}

/// Bits of four numbers that are taken from one word, wherever in a byte they begin.
const QUAD_BITS: usize = 57;

/// Puts numbers of `width` bits from bit `at` on into `out`, and returns how many there are.
#[inline]
fn unpack(bytes: &[u8], at: usize, width: usize, out: &mut [u64]) -> usize {
    let left = (8 * bytes.len()).checked_sub(at);
    let there = match left {
        Some(left) => left.checked_div(width).unwrap_or(out.len()),
        None => 0,
    };
    let there = there.min(out.len());
    let mut done = 0;
    if 4 * width <= QUAD_BITS {
        let mask = (1 << width) - 1;
        for quad in out[..there].as_chunks_mut::<4>().0 {
            let at = at + done * width;
            let Some(word) = bytes.get(at / 8..).and_then(<[u8]>::first_chunk) else {
                break;
            };
            let word = u64::from_le_bytes(*word) >> (at % 8);
            *quad = std::array::from_fn(|i| word >> (i * width) & mask);
            done += 4;
        }
    }
    for (i, number) in out[..there].iter_mut().enumerate().skip(done) {
        *number = bits(bytes, at + i * width, width).unwrap_or_default();
    }
    there
}

/// A decoder of runs of one value, and of packed values in groups of eight.
pub struct Runs {
    bytes: Vec<u8>,
    width: usize,
    /// Offset of the byte after the current run.
    at: usize,
    /// Number of values left in the current run.
    left: u64,
    /// The run's value, or the position in bits of the next packed value.
    run: Run,
}

enum Run {
    Of(u64),
    Packed(usize),
}

impl Runs {
    /// Reads values of `width` bits; `None` if that is above 32.
    pub fn new(bytes: Vec<u8>, width: u8) -> Option<Self> {
        (width <= 32).then_some(Self {
            bytes,
            width: width.into(),
            at: 0,
            left: 0,
            run: Run::Of(0),
        })
    }

    /// Returns the next value; `None` at the end or if the data is damaged.
    pub fn next(&mut self) -> Option<u64> {
        self.open_run()?;
        self.left -= 1;
        match &mut self.run {
            Run::Of(value) => Some(*value),
            Run::Packed(at) => {
                let value = bits(&self.bytes, *at, self.width)?;
                *at += self.width;
                Some(value)
            }
        }
    }

    /// Appends up to `count` of the next values as `each` makes them to `out`; fewer at the end, if the data is damaged,
    /// or if `each` refuses one.
    fn take<T>(
        &mut self,
        count: usize,
        out: &mut Vec<T>,
        each: impl Fn(u64) -> Option<T>,
    ) -> Option<()>
    where
        T: Copy,
    {
        let mut wanted = count;
        while wanted > 0 {
            self.open_run()?;
            let now = usize::try_from(self.left).unwrap_or(usize::MAX).min(wanted);
            wanted -= now;
            self.left -= now as u64;
            match &mut self.run {
                Run::Of(value) => {
                    let value = each(*value)?;
                    out.extend(std::iter::repeat_n(value, now));
                }
                Run::Packed(at) => {
                    let mut left = now;
                    while left > 0 {
                        let mut part = [0; PART_VALUES];
                        let part = &mut part[..left.min(PART_VALUES)];
                        let there = unpack(&self.bytes, *at, self.width, part);
                        for value in &part[..there] {
                            out.push(each(*value)?);
                        }
                        *at += there * self.width;
                        if there < part.len() {
                            return None;
                        }
                        left -= there;
                    }
                }
            }
        }
        Some(())
    }

    /// Returns how many of the next values are 1, if they are a run of one value.
    pub fn ones(&mut self) -> Option<u64> {
        self.open_run()?;
        matches!(self.run, Run::Of(1)).then_some(self.left)
    }

    /// Leaves out the next `count` values, which [`Runs::ones`] has counted.
    pub fn skip_ones(&mut self, count: usize) {
        self.left = self.left.saturating_sub(count as u64);
    }

    /// Moves to the next run that is not empty, if the current one has ended.
    fn open_run(&mut self) -> Option<()> {
        while self.left == 0 {
            let mut rest = self.bytes.get(self.at..)?;
            let length = rest.len();
            let header = Compact::new(&mut rest).varint()?;
            self.at += length - rest.len();
            let count = header >> 1;
            if header & 1 == 1 {
                self.left = count.checked_mul(8)?;
                self.run = Run::Packed(self.at.checked_mul(8)?);
                let bytes = usize::try_from(count).ok()?.checked_mul(self.width)?;
                self.at = self.at.checked_add(bytes)?;
            } else {
                let size = self.width.div_ceil(8);
                let value = bits(&self.bytes, 8 * self.at, 8 * size)?;
                self.at += size;
                self.left = count;
                self.run = Run::Of(value);
            }
        }
        Some(())
    }
}

/// A decoder of differences in blocks; the least difference of each block is stored apart.
pub struct Deltas {
    bytes: Vec<u8>,
    at: usize,
    part_values: usize,
    parts: usize,
    left: u64,
    last: i64,
    is_first: bool,
    least: i64,
    /// Bit widths of the block's miniblocks, and how many have been opened.
    widths: Vec<u8>,
    opened: usize,
    /// Of the current miniblock: bit position of the next difference, its width, and how many are left.
    part: (usize, usize, usize),
}

impl Deltas {
    fn new(bytes: Vec<u8>) -> Option<Self> {
        let mut rest = bytes.as_slice();
        let mut thrift = Compact::new(&mut rest);
        let block = usize::try_from(thrift.varint()?).ok()?;
        let parts = usize::try_from(thrift.varint()?).ok()?;
        let left = thrift.varint()?;
        let last = thrift.integer()?;
        let part_values = block.checked_div(parts)?;
        if parts > PARTS_MAX || part_values > PART_VALUES_MAX || part_values == 0 {
            return None;
        }
        let at = bytes.len() - rest.len();
        Some(Self {
            bytes,
            at,
            part_values,
            parts,
            left,
            last,
            is_first: true,
            least: 0,
            widths: Vec::new(),
            opened: 0,
            part: (0, 0, 0),
        })
    }

    fn next(&mut self) -> Option<i64> {
        self.left = self.left.checked_sub(1)?;
        if self.is_first {
            self.is_first = false;
            return Some(self.last);
        }
        if self.part.2 == 0 {
            self.open_part()?;
        }
        let (at, width, left) = &mut self.part;
        let delta = bits(&self.bytes, *at, *width)?;
        *at += *width;
        *left -= 1;
        let step = self.least.wrapping_add(delta as i64);
        self.last = self.last.wrapping_add(step);
        Some(self.last)
    }

    /// Appends up to `count` of the next values as `each` makes them to `out`; fewer at the end, or if the data is damaged.
    fn take<T>(&mut self, count: usize, out: &mut Vec<T>, each: impl Fn(i64) -> T) -> Option<()> {
        let mut wanted = count;
        while wanted > 0 {
            if self.is_first || self.part.2 == 0 {
                out.push(each(self.next()?));
                wanted -= 1;
                continue;
            }
            let (at, width, left) = &mut self.part;
            let now = wanted
                .min(*left)
                .min(usize::try_from(self.left).unwrap_or(usize::MAX));
            if now == 0 {
                return None;
            }
            let mut part = [0; PART_VALUES];
            let now = now.min(PART_VALUES);
            let there = unpack(&self.bytes, *at, *width, &mut part[..now]);
            *at += there * *width;
            let (mut last, least) = (self.last, self.least);
            out.extend(part[..there].iter().map(|delta| {
                last = last.wrapping_add(least.wrapping_add(*delta as i64));
                each(last)
            }));
            self.last = last;
            if there < now {
                return None;
            }
            *left -= now;
            self.left -= now as u64;
            wanted -= now;
        }
        Some(())
    }

    fn open_part(&mut self) -> Option<()> {
        if self.opened == self.widths.len() {
            let mut rest = self.bytes.get(self.at..)?;
            let length = rest.len();
            self.least = Compact::new(&mut rest).integer()?;
            let widths = rest.get(..self.parts)?;
            self.at += length - rest.len() + self.parts;
            self.widths.clear();
            self.widths.extend_from_slice(widths);
            self.opened = 0;
        }
        let width = *self.widths.get(self.opened)?;
        self.opened += 1;
        let width = usize::from(width);
        if width > 64 {
            return None;
        }
        self.part = (self.at.checked_mul(8)?, width, self.part_values);
        self.at += (self.part_values * width).div_ceil(8);
        Some(())
    }
}

/// The values of a page and the position of the next one.
pub enum Values {
    /// Numbers, their type, and the offset of the next.
    Plain(Vec<u8>, Dtype, usize),
    /// Bits, and the position of the next.
    Bits(Vec<u8>, usize),
    /// Bits in runs.
    Runs(Runs),
    /// Positions in the dictionary.
    Dictionary(Runs),
    /// Differences of integers.
    Deltas(Deltas, Dtype),
    /// The first bytes of all numbers, then all second bytes, and so on; and the index of the next number.
    Split(Vec<u8>, Dtype, usize),
}

/// What whole numbers are taken as.
pub trait Whole: Copy {
    /// Returns a whole number as such a value.
    fn whole(value: i64) -> Self;

    /// Appends all numbers of `bytes`, which are of this type.
    fn plain(dtype: Dtype, bytes: &[u8], out: &mut Vec<Self>);
}

impl Whole for i64 {
    fn whole(value: i64) -> Self {
        value
    }

    fn plain(dtype: Dtype, bytes: &[u8], out: &mut Vec<Self>) {
        dtype.whole_numbers(bytes, out);
    }
}

impl Whole for Option<Number> {
    fn whole(value: i64) -> Self {
        Some(Number::Whole(value))
    }

    fn plain(dtype: Dtype, bytes: &[u8], out: &mut Vec<Self>) {
        dtype.numbers(bytes, out);
    }
}

/// Returns the bits of a type of integers whose differences add up to whole numbers of 64 bits with a sign, and whether it
/// is signed.
fn whole_bits(dtype: Dtype) -> Option<(u32, bool)> {
    let fits = |(bits, is_signed): &(u32, bool)| *is_signed || *bits < 64;
    dtype.whole_bits().filter(fits)
}

impl Values {
    /// Prepares to decode the values in `bytes`.
    ///
    /// # Errors
    /// The encoding is not supported, or the page is damaged.
    pub fn new(bytes: Vec<u8>, encoding: i64, stored: Stored) -> Result<Self, String> {
        let damaged = || "a damaged page".to_owned();
        Ok(match (encoding, stored) {
            (PLAIN, Stored::Number(dtype)) => Self::Plain(bytes, dtype, 0),
            (PLAIN, Stored::Bool) => Self::Bits(bytes, 0),
            (RLE, Stored::Bool) => {
                // Preceded by their size in bytes.
                let runs = bytes.get(4..).map(<[u8]>::to_vec);
                Self::Runs(
                    runs.and_then(|runs| Runs::new(runs, 1))
                        .ok_or_else(damaged)?,
                )
            }
            (DICTIONARY | PLAIN_DICTIONARY, _) => {
                let (width, runs) = bytes.split_first().ok_or_else(damaged)?;
                Self::Dictionary(Runs::new(runs.to_vec(), *width).ok_or_else(damaged)?)
            }
            (DELTA, Stored::Number(dtype)) => {
                Self::Deltas(Deltas::new(bytes).ok_or_else(damaged)?, dtype)
            }
            (SPLIT, Stored::Number(dtype)) => Self::Split(bytes, dtype, 0),
            (other, _) => {
                return Err(format!(
                    "values in encoding {other} are not supported: write the file again with the \
                     default encodings"
                ));
            }
        })
    }

    /// Appends up to `count` of the next values to `out`, each as [`Values::next`] returns it; fewer mean damage or the end.
    pub fn take(
        &mut self,
        count: usize,
        dictionary: &[Option<Number>],
        out: &mut Vec<Option<Number>>,
    ) {
        match self {
            Self::Deltas(deltas, dtype) if whole_bits(*dtype).is_none() => {
                let _ = deltas.take(count, out, |value| dtype.number(&value.to_le_bytes()));
            }
            Self::Split(..) => {
                out.extend((0..count).map_while(|_| self.next(dictionary)));
            }
            _ => self.take_whole(count, dictionary, out),
        }
    }

    /// Returns whether [`Values::take_whole`] gives all values as whole numbers.
    pub fn is_whole(&self, dictionary: Option<&[i64]>) -> bool {
        match self {
            Self::Plain(_, dtype, _) => dtype.is_whole(),
            Self::Bits(..) | Self::Runs(_) => true,
            Self::Dictionary(_) => dictionary.is_some(),
            Self::Deltas(_, dtype) => whole_bits(*dtype).is_some(),
            Self::Split(..) => false,
        }
    }

    /// As [`Values::take`], of whole numbers, where [`Values::is_whole`].
    pub fn take_whole<V: Whole>(&mut self, count: usize, dictionary: &[V], out: &mut Vec<V>) {
        match self {
            Self::Plain(bytes, dtype, at) => {
                let rest = bytes.get(*at..).unwrap_or_default();
                let count = count.min(rest.len() / dtype.bytes.max(1));
                let taken = count * dtype.bytes;
                V::plain(*dtype, rest.get(..taken).unwrap_or_default(), out);
                *at += taken;
            }
            Self::Runs(runs) => {
                let _ = runs.take(count, out, |value| Some(V::whole(value as i64)));
            }
            Self::Dictionary(runs) => {
                let _ = runs.take(count, out, |place| {
                    dictionary.get(usize::try_from(place).ok()?).copied()
                });
            }
            Self::Deltas(deltas, dtype) => {
                let _ = match whole_bits(*dtype) {
                    Some((64, _)) => deltas.take(count, out, V::whole),
                    Some((bits, true)) => deltas.take(count, out, |value| {
                        let unused = 64 - bits;
                        V::whole(value << unused >> unused)
                    }),
                    Some((bits, false)) => {
                        deltas.take(count, out, |value| V::whole(value & ((1 << bits) - 1)))
                    }
                    None => None,
                };
            }
            Self::Bits(bytes, at) => {
                let mut left = count;
                while left > 0 {
                    let mut part = [0; PART_VALUES];
                    let part = &mut part[..left.min(PART_VALUES)];
                    let there = unpack(bytes, *at, 1, part);
                    out.extend(part[..there].iter().map(|bit| V::whole(*bit as i64)));
                    *at += there;
                    left -= there;
                    if there < part.len() {
                        break;
                    }
                }
            }
            Self::Split(..) => {}
        }
    }

    /// Returns the next value; `Some(None)` is a number above 2^63 - 1, `None` means damage or the end.
    pub fn next(&mut self, dictionary: &[Option<Number>]) -> Option<Option<Number>> {
        match self {
            Self::Plain(bytes, dtype, at) => {
                let number = bytes.get(*at..*at + dtype.bytes)?;
                *at += dtype.bytes;
                Some(dtype.number(number))
            }
            Self::Bits(bytes, at) => {
                let bit = bits(bytes, *at, 1)?;
                *at += 1;
                Some(Some(Number::Whole(bit as i64)))
            }
            Self::Runs(runs) => Some(Some(Number::Whole(runs.next()? as i64))),
            Self::Dictionary(runs) => {
                let place = usize::try_from(runs.next()?).ok()?;
                dictionary.get(place).copied()
            }
            Self::Deltas(deltas, dtype) => Some(dtype.number(&deltas.next()?.to_le_bytes())),
            Self::Split(bytes, dtype, at) => {
                let count = bytes.len() / dtype.bytes;
                if *at >= count {
                    return None;
                }
                let number: Vec<u8> = bytes.iter().skip(*at).step_by(count).copied().collect();
                *at += 1;
                Some(dtype.number(&number))
            }
        }
    }
}

/// Encodes integers as differences.
pub fn deltas(values: &[i64]) -> Vec<u8> {
    let mut out = Vec::new();
    put_varint(&mut out, BLOCK_VALUES as u64);
    put_varint(&mut out, (BLOCK_VALUES / PART_VALUES) as u64);
    put_varint(&mut out, values.len() as u64);
    put_integer(&mut out, values.first().copied().unwrap_or(0));
    let steps: Vec<i64> = values
        .windows(2)
        .map(|pair| match pair {
            [before, after] => after.wrapping_sub(*before),
            _ => 0,
        })
        .collect();
    for block in steps.chunks(BLOCK_VALUES) {
        let least = block.iter().min().copied().unwrap_or(0);
        put_integer(&mut out, least);
        let over: Vec<u64> = block
            .iter()
            .map(|step| step.wrapping_sub(least) as u64)
            .collect();
        let width = |part: &[u64]| {
            let all = part.iter().fold(0, |all, value| all | value);
            64 - all.leading_zeros()
        };
        let parts: Vec<&[u64]> = over.chunks(PART_VALUES).collect();
        let widths = (0..BLOCK_VALUES / PART_VALUES)
            .map(|index| parts.get(index).map_or(0, |part| width(part)));
        out.extend(widths.map(|width| width as u8));
        for part in parts {
            let width = width(part);
            let (mut word, mut filled) = (0_u128, 0);
            // Miniblocks have full length.
            let padding = std::iter::repeat_n(&0, PART_VALUES - part.len());
            for value in part.iter().chain(padding) {
                word |= u128::from(*value) << filled;
                filled += width;
                while filled >= 8 {
                    out.push(word as u8);
                    word >>= 8;
                    filled -= 8;
                }
            }
        }
    }
    out
}

/// Encodes values of `width` bits as runs of equal values.
pub fn runs(values: impl IntoIterator<Item = u32>, width: u8) -> Vec<u8> {
    let bytes = usize::from(width.div_ceil(8));
    let mut out = Vec::new();
    let mut put = |(value, count): (u32, u64)| {
        put_varint(&mut out, count << 1);
        out.extend(value.to_le_bytes().iter().take(bytes));
    };
    let mut run: Option<(u32, u64)> = None;
    for value in values {
        match &mut run {
            Some((of, count)) if *of == value => *count += 1,
            other => {
                other.take().into_iter().for_each(&mut put);
                *other = Some((value, 1));
            }
        }
    }
    run.into_iter().for_each(put);
    out
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn stored() -> impl Strategy<Value = Stored> {
        let number =
            |(kind, bytes)| Stored::Number(Dtype::new(kind, false, bytes).expect("a type"));
        prop_oneof![
            1 => Just(Stored::Bool),
            6 => prop::sample::select(vec![(b'i', 8), (b'i', 4), (b'u', 2), (b'u', 8), (b'f', 4), (b'i', 1)]).prop_map(number),
        ]
    }

    proptest! {
        /// Also of damaged pages.
        #[test]
        fn values_together_are_values_one_by_one(
            steps in proptest::collection::vec(prop_oneof![20 => -3..300_i64, 1 => any::<i64>()], 0..400),
            noise in proptest::collection::vec((0..1000_usize, any::<u8>()), 0..3),
            cut in 0..20_usize, encoding in prop::sample::select(vec![PLAIN, RLE, DELTA, DICTIONARY, SPLIT]),
            stored in stored(), width in 0..12_u8, counts in proptest::collection::vec(1..200_usize, 1..6),
        ) {
            let mut bytes = match encoding {
                DELTA => deltas(&steps),
                RLE => [vec![0; 4], runs(steps.iter().map(|step| u32::from(*step > 7)), 1)].concat(),
                DICTIONARY => {
                    let places = steps.iter().map(|step| *step as u32 & ((1 << width) - 1));
                    let packed = steps.iter().flat_map(|step| step.to_le_bytes());
                    let packed: Vec<u8> = packed.take(11 * usize::from(width)).collect();
                    [vec![width], runs(places, width), vec![11 << 1 | 1], packed].concat()
                }
                _ => steps.iter().flat_map(|step| step.to_le_bytes()).collect(),
            };
            for (at, with) in noise {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= with;
                }
            }
            bytes.truncate(bytes.len().saturating_sub(cut));
            let dictionary: Vec<Option<Number>> = (0..900)
                .map(|place| (place % 50 > 0).then_some(Number::Whole(place)))
                .collect();
            let new = || Values::new(bytes.clone(), encoding, stored);
            let (Ok(mut together), Ok(mut each)) = (new(), new()) else {
                return Ok(());
            };
            for count in counts {
                let mut got = Vec::new();
                together.take(count, &dictionary, &mut got);
                let want: Vec<_> = (0..count).map_while(|_| each.next(&dictionary)).collect();
                // A float may be no number, which equals none.
                prop_assert_eq!(format!("{got:?}"), format!("{want:?}"));
                if got.len() < count {
                    break;
                }
            }
        }
    }

    #[test]
    fn differences_go_back() {
        let far = [5, i64::MAX, i64::MIN, 0, -1];
        let long: Vec<i64> = (0..1000).map(|i| i * i % 977 - 300).collect();
        for values in [&far[..], &long, &long[..129], &long[..1], &[]] {
            let mut deltas = Deltas::new(deltas(values)).unwrap();
            let got: Vec<i64> = std::iter::from_fn(|| deltas.next()).collect();
            assert_eq!(got, values);
        }
    }

    #[test]
    fn runs_go_back() {
        for (values, width) in [(&[1, 1, 0, 1][..], 1), (&[300, 7, 7], 9), (&[0; 1000], 1)] {
            let mut read = Runs::new(runs(values.iter().copied(), width), width).unwrap();
            let got: Vec<u64> = std::iter::from_fn(|| read.next()).collect();
            let want: Vec<u64> = values.iter().map(|value| u64::from(*value)).collect();
            assert_eq!(got, want);
        }
    }

    #[test]
    fn runs_and_packed_values() {
        // Three times 5, then eight values packed in 3 bits, 0 to 7: the example in the format's description.
        let mut runs = Runs::new(vec![6, 5, 3, 0x88, 0xc6, 0xfa], 3).unwrap();
        let got: Vec<u64> = std::iter::from_fn(|| runs.next()).collect();
        assert_eq!(got, [5, 5, 5, 0, 1, 2, 3, 4, 5, 6, 7]);
        // A sequence of empty runs ends.
        assert_eq!(Runs::new(vec![0; 9], 1).unwrap().next(), None);
        assert!(Runs::new(Vec::new(), 33).is_none());
    }

    #[test]
    fn hostile_blocks_are_refused() {
        for bytes in [
            &[0x80, 1, 0, 9, 0][..],
            &[0xff, 0xff, 0xff, 0xff, 0x7f, 1, 9, 0],
            &[8, 16, 9, 0],
        ] {
            assert!(Deltas::new(bytes.to_vec()).is_none(), "{bytes:?}");
        }
        let mut wide = Deltas::new(vec![32, 1, 3, 0, 0, 65, 0, 0]).unwrap();
        assert_eq!((wide.next(), wide.next()), (Some(0), None));
    }
}
