//! Shared code of the readers' fuzz targets.

use std::io::Cursor;

use eecvs_nostd::{Event, Sensor};
use event_files::input::ReadSeek;
use event_files::{BATCH_EVENTS, EventReader};

/// Returns the sensor size for files that do not state one, or `None`; the lowest bit of the input's length
/// decides.
pub fn size(data: &[u8]) -> Option<Sensor> {
    (data.len() % 2 == 1).then_some(Sensor {
        width: 640,
        height: 480,
    })
}

/// Wraps the input as a file.
pub fn source(data: &[u8]) -> Box<dyn ReadSeek> {
    Box::new(Cursor::new(data.to_vec()))
}

/// Reads to the end or to an error, and checks a reader's promises; seeks to `from_us` first, if given. Returns the
/// time of the last event read, if there is one; `None` if opening or seeking fails.
pub fn drain(
    opened: event_files::Result<Box<dyn EventReader>>,
    from_us: Option<u64>,
) -> Option<u64> {
    let Ok(mut reader) = opened else { return None };
    if let Some(t_us) = from_us
        && reader.seek(t_us).is_err()
    {
        return None;
    }
    let sensor = reader.sensor();
    let mut last_us = None;
    let mut events: Vec<Event> = Vec::new();
    loop {
        events.clear();
        match reader.read(&mut events) {
            Ok(0) => break,
            Ok(read) => {
                assert_eq!(read, events.len());
                assert!(read <= BATCH_EVENTS);
                assert!(events.iter().all(|event| sensor.contains(event.x, event.y)));
                last_us = events.last().map(|event| event.t_us);
            }
            Err(error) => {
                assert!(events.is_empty());
                assert!(error.to_string().contains("byte "));
                assert!(matches!(reader.read(&mut events), Ok(0)));
                break;
            }
        }
    }
    last_us
}
