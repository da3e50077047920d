//! Reads a recording that is still being written: at the end of its file it waits for more.

use std::fs::File;
use std::io::{Read, Result as IoResult, Seek, SeekFrom};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use event_types::stream::{Context, Result};
use event_types::{bail, ensure};

use crate::format::has_size;
use crate::input::piped::is_stream;
use crate::{EventReader, FORMATS, Reading, open, open_source};

/// Time between two checks of a file that had no more bytes.
const LOOK: Duration = Duration::from_millis(20);

/// How long to follow a growing file.
#[derive(Debug, Clone)]
pub struct Follow {
    /// The file is considered complete when it has not grown for this long; `None` waits for ever.
    pub idle: Option<Duration>,
    /// Set to true by another thread to end the reading here.
    pub stop: Arc<AtomicBool>,
}

impl Follow {
    /// Waits before the next check of a file that last grew at `grown`; returns false if following is to end.
    fn wait(&self, grown: Instant) -> bool {
        let idle = self.idle.is_some_and(|idle| grown.elapsed() >= idle);
        if idle || self.stop.load(Ordering::Relaxed) {
            return false;
        }
        sleep(LOOK);
        true
    }
}

/// Opens a recording as [`open`] does, and also returns what is appended to it, until `follow` ends.
///
/// Until then, events are returned in whole batches of [`crate::BATCH_EVENTS`]. If the file does not state the
/// sensor's size, `reading` must.
///
/// # Errors
/// Those of [`open`], if the file does not become a recording in time; the format's files can be read only when
/// they are complete; `path` is not a plain file; the sensor's size is unknown.
pub fn open_growing(
    path: &Path,
    reading: &Reading,
    follow: &Follow,
) -> Result<Box<dyn EventReader>> {
    // A pipe blocks until more arrives, and ends when it is closed.
    if is_stream(path) {
        return open(path, reading);
    }
    let name = path.display().to_string();
    let grown = Instant::now();
    // The header may still be incomplete.
    let reader = loop {
        match open(path, reading) {
            Ok(reader) => break reader,
            Err(error) if !follow.wait(grown) => return Err(error),
            Err(_) => {}
        }
    };
    let format = FORMATS
        .iter()
        .find(|format| format.name == reader.format())
        .with_context(|| format!("{name}: cannot be followed"))?;
    ensure!(
        format.grows,
        Refused,
        "{name}: {} files can be read only when they are complete: wait until this one is",
        format.title
    );
    ensure!(
        path.is_file(),
        Refused,
        "{name}: only a file can be followed, not a folder or a place in a file: name the bag's \
         last file"
    );
    // Without a stated size, the whole file would be searched for its largest pixel.
    let sensor = reader.sensor();
    if reading.size.is_none() && !has_size(|reading| open(path, reading), reading, sensor) {
        bail!(
            Undecided,
            "{name}: states no sensor size and is still growing: give --width W --height H"
        );
    }
    drop(reader);
    let file = File::open(path).with_context(|| format!("{name}: cannot be opened"))?;
    let growing = Growing {
        file,
        follow: follow.clone(),
        grown: Instant::now(),
    };
    let reading = Reading {
        size: Some(sensor),
        ..reading.clone()
    };
    open_source(Box::new(growing), &name, reading)
}

/// A file that ends only where it has not grown for long enough.
struct Growing {
    file: File,
    follow: Follow,
    grown: Instant,
}

impl Read for Growing {
    fn read(&mut self, bytes: &mut [u8]) -> IoResult<usize> {
        loop {
            let read = self.file.read(bytes)?;
            if read > 0 || bytes.is_empty() {
                self.grown = Instant::now();
                return Ok(read);
            }
            if !self.follow.wait(self.grown) {
                return Ok(0);
            }
        }
    }
}

impl Seek for Growing {
    fn seek(&mut self, to: SeekFrom) -> IoResult<u64> {
        self.file.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::thread;

    use event_types::{Event, Polarity, Sensor};

    use super::*;
    use crate::create;

    const SENSOR: Sensor = Sensor {
        width: 128,
        height: 128,
    };

    fn follow(idle_ms: u64) -> Follow {
        Follow {
            idle: Some(Duration::from_millis(idle_ms)),
            stop: Arc::default(),
        }
    }

    fn some_events() -> Vec<Event> {
        (0..40_000_u64)
            .map(|i| Event {
                t_us: i * 3,
                x: (i % 64) as u16,
                y: (i / 64 % 48) as u16,
                polarity: Polarity::from_bool(i % 3 == 0),
            })
            .collect()
    }

    /// A recording's bytes.
    fn bytes(name: &str) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let mut writer = create(&path, SENSOR).unwrap();
        writer.write(&some_events()).unwrap();
        writer.finish().unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn what_is_appended_comes_too() {
        for name in [
            "a.raw", "a.evt2", "a.dat", "a.aedat", "a.aedat4", "a.mcap", "a.bag",
        ] {
            let bytes = bytes(name);
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(name);
            let mut file = File::create(&path).unwrap();
            let written = path.clone();
            let writing = thread::spawn(move || {
                // The first piece ends within the header, the others within words and packets.
                let mut rest = bytes.as_slice();
                for piece in [20, 7000, 33_333, usize::MAX] {
                    let (now, later) = rest.split_at(piece.min(rest.len()));
                    file.write_all(now).unwrap();
                    sleep(Duration::from_millis(60));
                    rest = later;
                }
            });
            let mut reader = open_growing(&written, &Reading::default(), &follow(1500)).unwrap();
            let mut events = Vec::new();
            while reader.read(&mut events).unwrap() > 0 {}
            writing.join().unwrap();
            assert!(events == some_events(), "{name}: {} events", events.len());
        }
    }

    #[test]
    fn an_aedat4_file_ends_with_its_table_or_where_it_stops() {
        let mut bytes = bytes("a.aedat4");
        // The table's offset is -1 until the file's writer closes it.
        bytes[54..62].copy_from_slice(&(-1_i64).to_le_bytes());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.aedat4");
        let writing = |until: usize| {
            let (path, bytes) = (path.clone(), bytes[..until].to_vec());
            std::fs::write(&path, &bytes[..900]).unwrap();
            thread::spawn(move || {
                let mut file = File::options().append(true).open(path).unwrap();
                // Pieces end between packets and within them.
                for piece in bytes[900..].chunks(30_011) {
                    sleep(Duration::from_millis(20));
                    file.write_all(piece).unwrap();
                }
            })
        };
        // No time limit: reading ends at the table.
        let endless = Follow {
            idle: None,
            stop: Arc::default(),
        };
        let writer = writing(bytes.len());
        let mut reader = open_growing(&path, &Reading::default(), &endless).unwrap();
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        writer.join().unwrap();
        assert!(events == some_events());
        // A file cut within its last packet.
        let writer = writing(bytes.len() - 5000);
        let mut reader = open_growing(&path, &Reading::default(), &follow(300)).unwrap();
        events.clear();
        let error = loop {
            match reader.read(&mut events) {
                Ok(read) => assert!(read > 0),
                Err(error) => break error.to_string(),
            }
        };
        writer.join().unwrap();
        assert!(error.contains("truncated"), "{error}");
        assert!(!events.is_empty() && some_events().starts_with(&events));
    }

    #[test]
    fn a_wish_to_stop_ends_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.raw");
        std::fs::write(&path, bytes("a.raw")).unwrap();
        let follow = Follow {
            idle: None,
            stop: Arc::default(),
        };
        let mut reader = open_growing(&path, &Reading::default(), &follow).unwrap();
        let mut events = Vec::new();
        assert!(reader.read(&mut events).unwrap() > 0);
        follow.stop.store(true, Ordering::Relaxed);
        while reader.read(&mut events).unwrap() > 0 {}
        assert_eq!(events.len(), some_events().len());
    }

    #[test]
    fn what_cannot_be_followed_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["a.npz", "a.csv"] {
            std::fs::write(at(name), bytes(name)).unwrap();
        }
        let refused = |name: &str, size: Option<Sensor>| {
            let result = open_growing(&at(name), &size.into(), &follow(50));
            format!("{:#}", result.err().unwrap())
        };
        assert!(refused("a.npz", None).contains("npz files"));
        assert!(refused("a.csv", None).contains("--width"));
        assert!(refused("none.raw", None).contains("none.raw"));
        std::fs::write(at("a.bag"), bytes("a.bag")).unwrap();
        let topic = "a.bag/event_camera/events";
        assert!(refused(topic, None).contains("only a file"));
        assert!(open_growing(&at("a.csv"), &Some(SENSOR).into(), &follow(50)).is_ok());
    }
}
