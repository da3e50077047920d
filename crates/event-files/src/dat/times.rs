//! Times at places of a DAT file, by which it is sought.
//!
//! A record's time has 32 bits and wraps after 71.6 minutes, and nothing tells how often it has wrapped
//! but all the records before. So every 4,096th record is looked at, 16,384 of them at the most, and the
//! wraps are carried from one to the next: sound while so many events come within 35 minutes, which is two
//! a second. A file of fewer than two such parts is not sought, it is read through.

use event_types::stream::Result;

use crate::dat::RECORD_BYTES;
use crate::input::Input;
use crate::wrapping::Wrapping;

/// Records from one mark to the next, at the least.
const STRIDE_MIN: u64 = 1 << 12;

/// Marks of a file, about; more records than 2^26 are further apart.
const MARKS: u64 = 1 << 14;

/// Times of marks, wraps carried.
pub struct Times {
    /// Byte of the first record.
    start: u64,
    records: u64,
    stride: u64,
    marks: Vec<u64>,
}

impl Times {
    /// Looks at the marks of a file whose records begin at byte `start`; the input's position is lost.
    ///
    /// # Errors
    /// I/O.
    pub fn of(input: &mut Input, start: u64) -> Result<Self> {
        let records = input.length().saturating_sub(start) / RECORD_BYTES;
        let stride = STRIDE_MIN.max(records / MARKS);
        let mut times = Self {
            start,
            records,
            stride,
            marks: Vec::new(),
        };
        let mut time = Wrapping::new(32, 0);
        let mut index = 0;
        while index < records {
            let low = times.low(input, index)?;
            times.marks.push(time.extend(u64::from(low)));
            index += stride;
        }
        Ok(times)
    }

    /// The first record of `target` or later, in a file whose times ascend, and the time's counter before
    /// it; none where the file is too short to be sought. The input's position is lost.
    ///
    /// # Errors
    /// I/O.
    pub fn place(&self, input: &mut Input, target: u64) -> Result<Option<(u64, Wrapping)>> {
        if self.records < 2 * self.stride {
            return Ok(None);
        }
        let after = self.marks.partition_point(|time| *time < target);
        let Some((before, mark)) = after
            .checked_sub(1)
            .and_then(|before| Some((before, *self.marks.get(before)?)))
        else {
            return Ok(Some((0, Wrapping::new(32, 0))));
        };
        // The last record known to be before the target and its time, and the first known not to be.
        let (mut low, mut time) = (before as u64 * self.stride, mark);
        let mut high = (low + self.stride).min(self.records);
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            let middle_time = nearest(mark, self.low(input, middle)?);
            if middle_time < target {
                (low, time) = (middle, middle_time);
            } else {
                high = middle;
            }
        }
        let mut counter = Wrapping::new(32, time);
        counter.extend(counter.low(time));
        Ok(Some((high, counter)))
    }

    /// Time of a record as the file holds it.
    fn low(&self, input: &mut Input, index: u64) -> Result<u32> {
        let mut bytes = [0; 4];
        let offset = self.start + index * RECORD_BYTES;
        if input.fill_at(offset, &mut bytes)? < bytes.len() {
            // The file has got shorter since it was opened.
            return Err(input.error_at(offset, "the file ends within a record: truncated"));
        }
        Ok(u32::from_le_bytes(bytes))
    }
}

/// The time with these lower bits that is nearest to `to`.
const fn nearest(to: u64, low: u32) -> u64 {
    // The sign of a step below half a period.
    let step = low.wrapping_sub(to as u32).cast_signed();
    to.saturating_add_signed(step as i64)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    /// Records of these times, from byte 3 on.
    fn file(times: &[u64]) -> Input {
        let mut bytes = vec![0; 3];
        for time in times {
            bytes.extend((*time & 0xffff_ffff).to_le_bytes());
        }
        Input::new(Box::new(Cursor::new(bytes)), "test").unwrap()
    }

    #[test]
    fn every_time_is_found_across_wraps() {
        // 3 hours, several events of one time.
        let times: Vec<u64> = (0..30_000).map(|i| 7 + i / 3 * 3 * 400_000).collect();
        let mut input = file(&times);
        let index = Times::of(&mut input, 3).unwrap();
        assert!(times.last().unwrap() >> 32 == 2);
        for target in (0..12_100_000_000)
            .step_by(9_999_991)
            .chain(times.iter().copied().step_by(97))
        {
            let (place, mut counter) = index.place(&mut input, target).unwrap().unwrap();
            let want = times.partition_point(|time| *time < target);
            assert_eq!(place, want as u64, "{target}");
            for time in times[want..].iter().take(5) {
                assert_eq!(counter.extend(time & 0xffff_ffff), *time);
            }
        }
    }

    #[test]
    fn short_files_are_read_through() {
        let times: Vec<u64> = (0..8191).map(|i| i * 60_000_000).collect();
        let mut input = file(&times);
        let index = Times::of(&mut input, 3).unwrap();
        assert!(index.place(&mut input, 5).unwrap().is_none());
        let mut empty = file(&[]);
        let index = Times::of(&mut empty, 3).unwrap();
        assert!(index.place(&mut empty, 0).unwrap().is_none());
    }

    #[test]
    fn the_nearest_time() {
        let wrap = 1 << 32;
        for (to, low, time) in [
            (wrap, u32::MAX, wrap - 1),
            (wrap - 1, 0, wrap),
            (5, 3, 3),
            (3, u32::MAX, 0),
            (2 * wrap + 9, 10, 2 * wrap + 10),
        ] {
            assert_eq!(nearest(to, low), time);
        }
    }
}
