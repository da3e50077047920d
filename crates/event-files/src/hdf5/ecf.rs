//! Unpacks chunks of events packed by Prophesee's codec ECF (filter 0x8ECF), as in Prophesee's `.hdf5` files.
//!
//! A chunk has at most 65,535 events, stored column by column. All numbers are little-endian; bit 0 is the lowest.
//!
//! | part | content |
//! |---|---|
//! | header | u32: bits 2.. number of events, bit 1 set: y, x and p are packed, bit 0 set: x and p are packed |
//! | t | u64, the start time; then bytes: bits 4..7 a time step, bits 0..3 the number of events after it |
//! | y, x, p packed | 3 u32 for every 4 events, the upper bits first: y of 12 bits (the highest 0), x of 11, p of 1 |
//! | y | u16: bits 5..15 y, bits 0..4 the number of events |
//! | x, p packed | 3 u16 for every 4 events, the upper bits first: x of 11 bits, p of 1 |
//! | x | u16: bits 5..15 x; bit 4 set: an event at x + 1 follows, bit 3: one at x + 2, and so on to x + 5 |
//! | p | bytes: bit 7 p, bits 0..6 the number of events |
//!
//! A number of events with all its bits set is replaced by the u16 that follows. A step of 15 marks a part of a
//! longer step: each byte of a run with this step contributes its four lower bits, the lowest first. Bits of x
//! after the last event, and packed events after it, have no meaning.

use std::cell::{Cell, RefCell};
use std::ops::Range;

use event_types::{Event, Polarity, Sensor};

/// Largest number of events in a chunk.
pub const EVENTS_MAX: usize = 65_535;

/// Size in bytes of an unpacked event: x and y (u16), p (i16), two unused bytes, t (i64).
pub const RECORD_BYTES: usize = 16;

/// Record that stands for an event missing from a short chunk; no event has these numbers.
pub const NO_EVENT: [u8; RECORD_BYTES] = [0xff; RECORD_BYTES];

const PACKED_YXP: u32 = 2;
const PACKED_XP: u32 = 1;

/// Step that marks four bits of a longer step, and the largest number of bits of a longer step.
const LONG_STEP: u8 = 15;
const LONG_STEP_BITS: u32 = 64;

/// Number of values written at once, whether or not all are needed, so that short runs take no loop.
const RUN: usize = 8;

/// Number of values that each column has after its last event, so that [`RUN`] values can be written there.
const SLACK: usize = 8;

/// For each value of the five lower bits of an x: its events' distances from x, and the number of these events.
const MASKS: [([u16; 8], u8); 32] = masks();

const fn masks() -> [([u16; 8], u8); 32] {
    let mut masks = [([0; 8], 1); 32];
    let mut mask = 0;
    while mask < 32 {
        let (mut distance, mut count) = (1, 1);
        while distance <= 5 {
            if mask >> (5 - distance) & 1 == 1 {
                masks[mask].0[count] = distance as u16;
                count += 1;
            }
            distance += 1;
        }
        masks[mask].1 = count as u8;
        mask += 1;
    }
    masks
}

thread_local! {
    static CHUNK_BYTES: Cell<usize> = const { Cell::new(0) };
    static COLUMNS: RefCell<Columns> = RefCell::new(Columns::default());
}

/// Calls `read`, which unpacks chunks of `bytes` bytes. Shorter chunks, such as the last of a file, are filled up
/// with [`NO_EVENT`].
pub fn in_chunks_of<T>(bytes: usize, read: impl FnOnce() -> T) -> T {
    let before = CHUNK_BYTES.replace(bytes);
    let result = read();
    CHUNK_BYTES.set(before);
    result
}

/// Unpacks a chunk to records of [`RECORD_BYTES`].
///
/// # Errors
/// The chunk is damaged; the error states the byte and the cause.
pub fn unpack(packed: &[u8]) -> Result<Vec<u8>, String> {
    COLUMNS.with_borrow_mut(|columns| {
        let count = columns.read(packed)?;
        Ok(columns.records(count, CHUNK_BYTES.get()))
    })
}

/// The columns of a chunk.
#[derive(Default)]
pub struct Columns {
    t: Vec<u64>,
    x: Vec<u16>,
    y: Vec<u16>,
    p: Vec<u8>,
}

impl Columns {
    /// Reads a chunk and returns its number of events.
    ///
    /// # Errors
    /// The chunk is damaged; the error states the byte and the cause.
    pub fn read(&mut self, packed: &[u8]) -> Result<usize, String> {
        let mut rest = Rest {
            bytes: packed,
            all: packed.len(),
        };
        let header = u32::from_le_bytes(rest.array()?);
        let count = usize::try_from(header >> 2).unwrap_or(usize::MAX);
        // Two bytes of x hold at most six events.
        if count > EVENTS_MAX || count.div_ceil(6) > packed.len() / 2 {
            return Err(rest.damage(&format!(
                "it does not hold the {count} events that it claims"
            )));
        }
        self.t.resize(count + SLACK, 0);
        self.x.resize(count + SLACK, 0);
        self.y.resize(count + SLACK, 0);
        self.p.resize(count + SLACK, 0);
        self.read_times(&mut rest, count)?;
        if header & PACKED_YXP != 0 {
            self.read_yxp(&mut rest, count)?;
        } else {
            self.read_rows(&mut rest, count)?;
            if header & PACKED_XP != 0 {
                self.read_xp(&mut rest, count)?;
            } else {
                self.read_columns(&mut rest, count)?;
                self.read_polarities(&mut rest, count)?;
            }
        }
        match rest.bytes.len() {
            0 => Ok(count),
            more => Err(rest.damage(&format!("{more} bytes after the last event"))),
        }
    }

    fn read_times(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        if let Some(used) = self.read_plain_times(rest.bytes, count) {
            rest.take(used)?;
            return Ok(());
        }
        // Read again with checks, to report the cause and its place.
        self.read_each_time(rest, count)
    }

    fn read_each_time(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let mut time = u64::from_le_bytes(rest.array()?);
        let mut at = 0;
        while at < count {
            let [byte] = rest.array()?;
            let (step, run) = (byte >> 4, usize::from(byte & 15));
            if step == LONG_STEP {
                let long = rest.long_step(byte)?;
                let after = time.checked_add(long);
                time = after.ok_or_else(|| rest.damage("a time above 2^64"))?;
                continue;
            }
            let after = time.checked_add(u64::from(step));
            time = after.ok_or_else(|| rest.damage("a time above 2^64"))?;
            let run = if run == 15 { rest.run()? } else { run };
            at = fill(&mut self.t, at, run, count, time).ok_or_else(|| rest.too_many("times"))?;
        }
        Ok(())
    }

    /// Reads times like [`Columns::read_each_time`], but a longer step together with the byte after it: the
    /// processor cannot predict which bytes belong to one, and mispredicted branches would take most of the time.
    /// Returns the number of bytes read; `None` if the data is damaged, a longer step has more than 28 bits, or too
    /// few bytes follow.
    fn read_plain_times(&mut self, packed: &[u8], count: usize) -> Option<usize> {
        const STEPS: u64 = 0xf0f0_f0f0_f0f0_f0f0;
        let (start, mut rest) = packed.split_first_chunk()?;
        let mut time = u64::from_le_bytes(*start);
        let mut at = 0;
        while at < count {
            let eight = u64::from_le_bytes(*rest.first_chunk()?);
            // Number of bytes of a longer step: all bits of their upper halves are set.
            let bytes = (!eight & STEPS).trailing_zeros() / 8;
            let byte = eight.checked_shr(8 * bytes)?;
            // Their lower halves, joined.
            let mut long = eight & !STEPS & !(u64::MAX << (8 * bytes));
            long = (long | long >> 4) & 0x00ff_00ff_00ff_00ff;
            long = (long | long >> 8) & 0x0000_ffff_0000_ffff;
            long = (long | long >> 16) & 0xffff_ffff;
            time = time.checked_add(long + (byte >> 4 & 15))?;
            rest = rest.get(bytes as usize + 1..)?;
            let mut run = (byte & 15) as usize;
            if run == 15 {
                let (more, behind) = rest.split_first_chunk()?;
                rest = behind;
                run = usize::from(u16::from_le_bytes(*more));
            }
            at = fill(&mut self.t, at, run, count, time)?;
        }
        Some(packed.len() - rest.len())
    }

    fn read_rows(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let mut at = 0;
        while at < count {
            let word = u16::from_le_bytes(rest.array()?);
            let (y, run) = (word >> 5, usize::from(word & 31));
            let run = if run == 31 { rest.run()? } else { run };
            at = fill(&mut self.y, at, run, count, y).ok_or_else(|| rest.too_many("rows"))?;
        }
        Ok(())
    }

    fn read_polarities(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let mut at = 0;
        while at < count {
            let [byte] = rest.array()?;
            let (p, run) = (byte >> 7, usize::from(byte & 127));
            let run = if run == 127 { rest.run()? } else { run };
            at = fill(&mut self.p, at, run, count, p).ok_or_else(|| rest.too_many("polarities"))?;
        }
        Ok(())
    }

    fn read_columns(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let mut at = 0;
        while at < count {
            let word = u16::from_le_bytes(rest.array()?);
            let x = word >> 5;
            let (distances, events) = &MASKS[usize::from(word & 31)];
            let places = self.x.get_mut(at..).and_then(<[u16]>::first_chunk_mut);
            let places: &mut [u16; RUN] = places.ok_or_else(|| rest.too_many("columns"))?;
            for (place, distance) in places.iter_mut().zip(distances) {
                *place = x + distance;
            }
            at += usize::from(*events);
        }
        Ok(())
    }

    fn read_xp(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let bytes = rest.take(count.div_ceil(4) * 6)?;
        let (fours, _) = bytes.as_chunks::<6>();
        let places = self.x.chunks_exact_mut(4).zip(self.p.chunks_exact_mut(4));
        for (four, (x, p)) in fours.iter().zip(places) {
            let [a, b, c] = [0, 2, 4].map(|at| u16::from_le_bytes([four[at], four[at + 1]]));
            let events = [
                a >> 4,
                a & 0xf | b >> 8 << 4,
                b & 0xff | c >> 12 << 8,
                c & 0xfff,
            ];
            for ((x, p), event) in x.iter_mut().zip(p).zip(events) {
                *x = event >> 1;
                *p = (event & 1) as u8;
            }
        }
        Ok(())
    }

    fn read_yxp(&mut self, rest: &mut Rest<'_>, count: usize) -> Result<(), String> {
        let bytes = rest.take(count.div_ceil(4) * 12)?;
        let (fours, _) = bytes.as_chunks::<12>();
        let places = self.x.chunks_exact_mut(4).zip(self.y.chunks_exact_mut(4));
        let places = places.zip(self.p.chunks_exact_mut(4));
        for (four, ((x, y), p)) in fours.iter().zip(places) {
            let (words, _) = four.as_chunks::<4>();
            let &[a, b, c] = words else { break };
            let [a, b, c] = [a, b, c].map(u32::from_le_bytes);
            let events = [
                a >> 8,
                a & 0xff | b >> 16 << 8,
                b & 0xffff | c >> 24 << 16,
                c & 0xff_ffff,
            ];
            for (((x, y), p), event) in x.iter_mut().zip(y).zip(p).zip(events) {
                *y = (event >> 12) as u16;
                *x = (event >> 1 & 0x7ff) as u16;
                *p = (event & 1) as u8;
            }
        }
        let rows = self.y.get(..count).unwrap_or_default();
        if rows.iter().fold(0, |all, y| all | y) > 0x7ff {
            return Err(rest.damage("a row above 2,047"));
        }
        Ok(())
    }

    /// Returns whether the events in this range are on the sensor and their times are not negative as signed
    /// numbers.
    pub fn are_events(&self, places: Range<usize>, sensor: Sensor) -> bool {
        // All events are checked without a branch, which is faster than to stop at the first bad one.
        let most = |numbers: &[u16]| {
            let numbers = numbers.get(places.clone()).unwrap_or_default();
            numbers.iter().fold(0, |most, number| most.max(*number))
        };
        // Times ascend, so the last is the largest.
        let last = self.t.get(places.clone()).and_then(<[u64]>::last);
        last.is_none_or(|last| i64::try_from(*last).is_ok())
            && sensor.contains(most(&self.x), most(&self.y))
    }

    /// Returns the events in this range.
    pub fn events(&self, places: Range<usize>) -> impl ExactSizeIterator<Item = Event> {
        let t = self.t.get(places.clone()).unwrap_or_default();
        let x = self.x.get(places.clone()).unwrap_or_default();
        let y = self.y.get(places.clone()).unwrap_or_default();
        let p = self.p.get(places).unwrap_or_default();
        let columns = t.iter().zip(x).zip(y.iter().zip(p));
        columns.map(|((t, x), (y, p))| Event {
            t_us: *t,
            x: *x,
            y: *y,
            polarity: Polarity::from_bool(*p != 0),
        })
    }

    /// Returns the records of `count` events, filled up with [`NO_EVENT`] to `bytes` bytes.
    fn records(&self, count: usize, bytes: usize) -> Vec<u8> {
        let mut records = Vec::with_capacity(bytes.max(count * RECORD_BYTES));
        let places = self.t.iter().zip(&self.x).zip(self.y.iter().zip(&self.p));
        for ((t, x), (y, p)) in places.take(count) {
            let mut record = [0; RECORD_BYTES];
            record[..2].copy_from_slice(&x.to_le_bytes());
            record[2..4].copy_from_slice(&y.to_le_bytes());
            record[4..6].copy_from_slice(&u16::from(*p).to_le_bytes());
            record[8..].copy_from_slice(&t.to_le_bytes());
            records.extend_from_slice(&record);
        }
        while records.len() + RECORD_BYTES <= bytes {
            records.extend_from_slice(&NO_EVENT);
        }
        records
    }
}

/// Writes `value` for `run` events from `at` on, and returns the position after them; `None` if it is above `count`.
#[inline]
fn fill<T: Copy>(column: &mut [T], at: usize, run: usize, count: usize, value: T) -> Option<usize> {
    let end = at + run;
    if end > count {
        return None;
    }
    if run <= RUN {
        let places: &mut [T; RUN] = column.get_mut(at..)?.first_chunk_mut()?;
        *places = [value; RUN];
    } else {
        column.get_mut(at..end)?.fill(value);
    }
    Some(end)
}

/// The rest of a chunk.
struct Rest<'a> {
    bytes: &'a [u8],
    all: usize,
}

impl<'a> Rest<'a> {
    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        match self.bytes.split_first_chunk() {
            Some((first, rest)) => {
                self.bytes = rest;
                Ok(*first)
            }
            None => Err(self.damage("it ends before its last event")),
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        match self.bytes.split_at_checked(count) {
            Some((taken, rest)) => {
                self.bytes = rest;
                Ok(taken)
            }
            None => Err(self.damage("it ends before its last event")),
        }
    }

    /// Reads a number of events that did not fit into its bits.
    fn run(&mut self) -> Result<usize, String> {
        Ok(usize::from(u16::from_le_bytes(self.array()?)))
    }

    /// Reads the rest of the longer step that begins with the byte `first`.
    fn long_step(&mut self, first: u8) -> Result<u64, String> {
        let mut long = u64::from(first & 15);
        let mut bits = 4;
        while let Some((byte, rest)) = self.bytes.split_first() {
            if byte >> 4 != LONG_STEP {
                break;
            }
            if bits == LONG_STEP_BITS {
                return Err(self.damage("a time step of more than 64 bits"));
            }
            long |= u64::from(byte & 15) << bits;
            bits += 4;
            self.bytes = rest;
        }
        Ok(long)
    }

    #[cold]
    fn damage(&self, what: &str) -> String {
        let at = self.all - self.bytes.len();
        format!("damaged at byte {at} of the chunk: {what}")
    }

    #[cold]
    fn too_many(&self, what: &str) -> String {
        self.damage(&format!("more {what} than events"))
    }
}

#[cfg(test)]
#[path = "../../tests/formats/hdf5_writer/ecf.rs"]
mod twin;

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::twin::{Form, Numbers, pack};
    use super::*;

    fn records(events: &[Numbers]) -> Vec<u8> {
        let record = |(t, x, y, p): &Numbers| {
            let mut record = [*x, *y, u16::from(*p), 0].map(u16::to_le_bytes).concat();
            record.extend(t.to_le_bytes());
            record
        };
        events.iter().flat_map(record).collect()
    }

    const FORMS: [Form; 3] = [Form::Yxp, Form::Xp, Form::Runs];

    /// Generates runs of equal numbers of any length, neighbouring pixels, and steps of every size.
    fn events() -> impl Strategy<Value = Vec<Numbers>> {
        let step = prop_oneof![
            4 => Just(0_u64), 4 => 1..20_u64, 1 => 14..17_u64, 1 => 0..1_u64 << 40
        ];
        let place = (0..2048_u16, 0..2048_u16, 0..2_u8);
        let count = prop_oneof![3 => 1..4_usize, 2 => 4..40_usize, 1 => 120..400_usize];
        let part = (step, place, count, 0..4_u16);
        let parts = prop::collection::vec(part, 0..40);
        (any::<u32>(), parts).prop_map(|(start, parts)| {
            let mut t = u64::from(start) << 20;
            let mut events = Vec::new();
            for (step, (x, y, p), count, right) in parts {
                t += step;
                let x = |i| ((usize::from(x) + i * usize::from(right)) % 2048) as u16;
                events.extend((0..count).map(|i| (t, x(i), y, p)));
            }
            events
        })
    }

    #[test]
    fn longest_runs_and_steps() {
        let all = |t, x, count| vec![(t, x, 5, 1); count];
        for events in [
            all(u64::MAX, 2047, EVENTS_MAX),
            all(0, 0, 127),
            [all(0, 9, 14), all(u64::MAX, 10, 15), all(u64::MAX, 9, 31)].concat(),
            Vec::new(),
        ] {
            for form in FORMS {
                let packed = pack(&events, form, usize::MAX);
                assert_eq!(unpack(&packed), Ok(records(&events)), "{form:?}");
            }
        }
    }

    #[test]
    fn bytes_as_the_format_has_them() {
        // 3 events: t = 10, 10, 42; y = 3; x = 7, 8, 11; p = 1, 1, 0.
        let times = [10, 0, 0, 0, 0, 0, 0, 0, 0x02, 0xf0, 0xf2, 0x01];
        let runs = [0x63, 0, 0xf2, 0, 0x82, 0x01];
        let packed = [&[12, 0, 0, 0][..], &times, &runs].concat();
        let events = [(10, 7, 3, 1), (10, 8, 3, 1), (42, 11, 3, 0)];
        assert_eq!(unpack(&packed), Ok(records(&events)));
        // A bit of x after the last event has no meaning.
        let mut more = packed.clone();
        more[18] |= 1;
        assert_eq!(unpack(&more), Ok(records(&events)));
        let padded = in_chunks_of(4 * RECORD_BYTES, || unpack(&packed));
        let want = [records(&events), NO_EVENT.to_vec()].concat();
        assert_eq!(padded, Ok(want));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let events = [(10, 7, 3, 1), (10, 8, 3, 1), (42, 11, 3, 0)];
        let good = pack(&events, Form::Runs, 9);
        let changed = |at: usize, to: u8| {
            let mut bytes = good.clone();
            bytes[at] = to;
            bytes
        };
        let times = |bytes: &[u8]| [&[4, 0, 0, 0][..], &[0xff; 8], bytes].concat();
        for (chunk, want) in [
            (vec![1, 0], "byte 0 of the chunk: it ends"),
            (good[..good.len() - 1].to_vec(), "it ends before"),
            ([&good[..], &[0]].concat(), "1 bytes after the last event"),
            (changed(3, 1), "it does not hold the 4194307 events"),
            (changed(1, 1), "it does not hold the 67 events"),
            (changed(12, 4), "byte 13 of the chunk: more times"),
            (times(&[0x11, 0, 0, 0, 0]), "a time above 2^64"),
            (times(&[0xf1, 0x01, 0, 0]), "a time above 2^64"),
            (times(&[0xf0; 17]), "more than 64 bits"),
            (
                [&[6, 0, 0, 0][..], &[0; 8], &[1], &[0, 0, 0, 0x80], &[0; 8]].concat(),
                "a row above 2,047",
            ),
        ] {
            let error = unpack(&chunk).expect_err(want);
            assert!(error.contains(want), "{error} is not {want}");
        }
    }

    proptest! {
        #[test]
        fn events_of_every_form_come_back(
            events in events(), run in prop_oneof![Just(usize::MAX), 1..200_usize],
        ) {
            for form in FORMS {
                let packed = pack(&events, form, run);
                prop_assert_eq!(unpack(&packed), Ok(records(&events)), "{:?}", form);
            }
        }

        /// The fast path reads the same times as the checked one.
        #[test]
        fn plain_times_are_times(
            start in any::<u64>(), count in 0..60_usize,
            bytes in prop::collection::vec(prop_oneof![any::<u8>(), Just(0xf3), Just(0x1f)], 0..80),
        ) {
            let packed = [&start.to_le_bytes()[..], &bytes].concat();
            let [mut quick, mut careful] = [Columns::default(), Columns::default()];
            quick.t.resize(count + SLACK, 0);
            careful.t.resize(count + SLACK, 0);
            let used = quick.read_plain_times(&packed, count);
            let mut rest = Rest { bytes: &packed, all: packed.len() };
            let is_read = careful.read_each_time(&mut rest, count).is_ok();
            if used.is_some() {
                prop_assert!(is_read);
                prop_assert_eq!(used, Some(packed.len() - rest.bytes.len()));
                prop_assert_eq!(&quick.t[..count], &careful.t[..count]);
            }
        }

        /// Damaged bytes give an error or at most as many events as they can hold.
        #[test]
        fn any_bytes_are_an_error_or_events(
            events in events(), run in 1..200_usize, random in prop::collection::vec(any::<u8>(), 0..200),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..5),
            cut in any::<prop::sample::Index>(),
        ) {
            let good = FORMS.map(|form| pack(&events, form, run));
            let changed = good.clone().map(|mut bytes| {
                for (at, to) in &changes {
                    let at = at.index(bytes.len());
                    bytes[at] = *to;
                }
                bytes
            });
            for bytes in changed.iter().chain([&random]) {
                if let Ok(records) = unpack(bytes) {
                    prop_assert!(records.len() <= RECORD_BYTES * bytes.len() * 3);
                }
            }
            for bytes in &good {
                let end = cut.index(bytes.len());
                prop_assert!(unpack(&bytes[..end]).is_err());
            }
        }
    }
}
