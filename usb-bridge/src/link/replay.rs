//! Replays a stream file as a link, byte for byte.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use super::raw_file::{Header, RawFileError, RawReader, Record};
use super::{Link, LinkError, Received, until};

/// Pace of a replay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pace {
    /// This many times the captured speed; must be positive.
    Times(f64),
    /// As fast as the receiver takes it.
    Max,
}

/// A link that replays a stream file. It cannot send.
pub struct ReplayLink {
    reader: RawReader<BufReader<File>>,
    name: String,
    pace: Pace,
    /// When the first record was delivered, and its time in the file.
    started: Option<(Instant, Duration)>,
    /// A record that has been read but is not due yet.
    next: Option<Record>,
    bytes: Vec<u8>,
}

impl ReplayLink {
    /// Opens a stream file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a stream file.
    pub fn open(path: &Path, pace: Pace) -> Result<Self, RawFileError> {
        Ok(Self {
            reader: RawReader::open(path)?,
            name: path.display().to_string(),
            pace,
            started: None,
            next: None,
            bytes: Vec::new(),
        })
    }

    /// Returns the file's header, which describes its stream.
    #[must_use]
    pub const fn header(&self) -> &Header {
        self.reader.header()
    }

    /// Returns the offset at which the file is cut off; known only once its end was reached.
    #[must_use]
    pub const fn cut(&self) -> Option<u64> {
        self.reader.cut()
    }

    /// Returns when a record with this time is due.
    fn due(&mut self, time: Duration) -> Instant {
        let now = Instant::now();
        let Pace::Times(times) = self.pace else {
            return now;
        };
        let (started, first) = *self.started.get_or_insert((now, time));
        // Keeps a pace of zero or NaN from dividing by zero.
        let since = time.saturating_sub(first).as_secs_f64() / times.max(1e-6);
        let since = Duration::try_from_secs_f64(since).unwrap_or(Duration::MAX);
        started.checked_add(since).unwrap_or_else(|| until(since))
    }
}

impl Link for ReplayLink {
    fn name(&self) -> &str {
        &self.name
    }

    /// Returns the next record once it is due; `at` is the time at which its bytes were due.
    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let deadline = until(timeout);
        let record = match self.next.take() {
            Some(record) => record,
            None => match self.reader.next(&mut self.bytes) {
                Ok(Some(record)) => record,
                Ok(None) => return Ok(Received::Ended),
                Err(error) => {
                    return Err(LinkError::Failed {
                        link: self.name.clone(),
                        cause: error.to_string(),
                    });
                }
            },
        };
        let time = match record {
            Record::Bytes { time } => time,
            // A loss is returned at once; the record that follows carries the time.
            Record::Lost { bytes, cause, .. } => return Ok(Received::Lost { bytes, cause }),
        };
        let due = self.due(time);
        thread::sleep(due.min(deadline).saturating_duration_since(Instant::now()));
        if due > deadline {
            self.next = Some(record);
            return Ok(Received::Nothing);
        }
        Ok(Received::Bytes {
            bytes: &self.bytes,
            at: due,
        })
    }

    fn send(&mut self, _bytes: &[u8]) -> Result<(), LinkError> {
        Err(LinkError::Failed {
            link: self.name.clone(),
            cause: "is a file and accepts no bytes".to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::Loss;
    use crate::link::raw_file::RawWriter;
    use crate::link::raw_file::tests::header;

    #[test]
    fn a_file_is_replayed_at_its_pace() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("some.stream");
        let mut writer = RawWriter::new(File::create(&path).unwrap(), &header()).unwrap();
        writer.bytes(Duration::from_secs(5), &[1; 3]).unwrap();
        let time = Duration::from_millis(5050);
        writer.lost(time, Some(9), Loss::Overflow).unwrap();
        writer.bytes(Duration::from_millis(5100), &[2]).unwrap();
        writer.finish().unwrap();
        for (pace, least, most) in [
            (Pace::Times(1.0), 100, 60_000),
            (Pace::Times(4.0), 25, 60_000),
            (Pace::Max, 0, 60_000),
        ] {
            let mut link = ReplayLink::open(&path, pace).unwrap();
            assert_eq!(link.header().model, "davis346");
            let started = Instant::now();
            let mut told = Vec::new();
            loop {
                match link.receive(Duration::from_millis(7)).unwrap() {
                    Received::Bytes { bytes, .. } => told.extend_from_slice(bytes),
                    Received::Lost { bytes, .. } => told.push(bytes.unwrap() as u8),
                    Received::Nothing => assert_ne!(pace, Pace::Max),
                    Received::Ended => break,
                }
            }
            assert_eq!(told, [1, 1, 1, 9, 2]);
            let took = started.elapsed().as_millis();
            assert!((least..most).contains(&took), "{took}");
            assert_eq!(link.cut(), None);
        }
    }
}
