//! What every reader's fuzz target does with its reader.

use std::io::Cursor;

use eecvs_nostd::{Event, Sensor};
use event_files::input::ReadSeek;
use event_files::{BATCH_EVENTS, EventReader};

/// Size for files that name none; the first bit of the input's length decides whether it is known.
pub fn size(data: &[u8]) -> Option<Sensor> {
    (data.len() % 2 == 1).then_some(Sensor {
        width: 640,
        height: 480,
    })
}

/// The input as a file.
pub fn source(data: &[u8]) -> Box<dyn ReadSeek> {
    Box::new(Cursor::new(data.to_vec()))
}

/// Reads to the end or to an error, and checks what a reader promises; from a place on where the format can seek
/// it, if a time is told. The time of the last event, if there is one.
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
