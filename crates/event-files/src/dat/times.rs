//! Times of sampled records of a DAT file, which are used for seeking.
//!
//! A record's time has 32 bits and wraps after 71.6 minutes, and only the records before it show how often it has
//! wrapped. Therefore every 4,096th record is read, or in larger files about 16,384 records at equal distances,
//! and the wraps are counted from one of them to the next. This is sound as long as the events of an interval span
//! less than 35 minutes: for 4,096 events, from two events per second on. A file of fewer than two such intervals
//! is read through instead.

use event_types::stream::Result;

use crate::dat::RECORD_BYTES;
use crate::input::Input;
use crate::wrapping::Wrapping;

/// Smallest distance between two sampled records.
const STRIDE_MIN: u64 = 1 << 12;

/// Approximate largest number of sampled records; in files of more than 2^26 records the distance grows.
const MARKS: u64 = 1 << 14;

/// Times of the sampled records, with the wraps counted.
pub struct Times {
    /// Offset of the first record.
    start: u64,
    records: u64,
    stride: u64,
    marks: Vec<u64>,
}

impl Times {
    /// Samples a file whose records begin at byte `start`. Changes the input's position.
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

    /// Returns the number of the first record at or after `target`, in a file whose times ascend, and the time
    /// counter before it; `None` if the file is too short for seeking. Changes the input's position.
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
        // The last record known to be before the target, with its time, and the first record known not to be.
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

    /// Returns the time of a record as stored in the file.
    fn low(&self, input: &mut Input, index: u64) -> Result<u32> {
        let mut bytes = [0; 4];
        let offset = self.start + index * RECORD_BYTES;
        if input.fill_at(offset, &mut bytes)? < bytes.len() {
            // The file has become shorter since it was opened.
            return Err(input.error_at(offset, "the file ends within a record: truncated"));
        }
        Ok(u32::from_le_bytes(bytes))
    }
}

/// Returns the time with these lower bits that is nearest to `to`.
const fn nearest(to: u64, low: u32) -> u64 {
    // As a signed number, a step of less than half a period has its sign.
    let step = low.wrapping_sub(to as u32).cast_signed();
    to.saturating_add_signed(step as i64)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    /// Returns a file with records of these times from byte 3 on.
    fn file(times: &[u64]) -> Input {
        let mut bytes = vec![0; 3];
        for time in times {
            bytes.extend((*time & 0xffff_ffff).to_le_bytes());
        }
        Input::new(Box::new(Cursor::new(bytes)), "test").unwrap()
    }

    #[test]
    fn every_time_is_found_across_wraps() {
        // 3 hours, with several events at each time.
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
