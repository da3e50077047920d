//! Packed rows as they were.

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::window_limit::WindowLimit;
use event_types::Event;

use super::{AS_THEY_ARE, CHECKSUM_BYTES, EQUAL, EQUAL_BYTES_MAX, EVENTS, EVENTS_SIGNED, VERSION};
use crate::Error;
use crate::layout::{Layout, Off};

/// Unpacks the rows of a chunk, of at most `bytes_max` bytes.
///
/// # Errors
/// [`Error::Damaged`]; [`Error::Rows`]; [`Error::TooLarge`].
pub fn unpack(packed: &[u8], layout: &Layout, bytes_max: usize) -> Result<Vec<u8>, Error> {
    let row_bytes = layout.row_bytes();
    let mut rows = Vec::new();
    let pieces = packed.len().checked_sub(CHECKSUM_BYTES);
    let (content, checksum) = packed.split_at(pieces.ok_or(Error::Damaged)?);
    if checksum != crc32fast::hash(content).to_le_bytes() {
        return Err(Error::Damaged);
    }
    let (version, mut rest) = content.split_first().ok_or(Error::Damaged)?;
    if *version != VERSION {
        return Err(Error::Damaged);
    }
    let chunk_bytes = layout.chunk_bytes();
    let bytes_max = chunk_bytes.map_or(bytes_max, |bytes| bytes.min(bytes_max));
    let mut equal_left = EQUAL_BYTES_MAX;
    while !rest.is_empty() {
        let (kind, count) = (take(&mut rest, 1)?[0], number(&mut rest)?);
        let bytes = (count as usize).checked_mul(row_bytes);
        let bytes = bytes.filter(|bytes| *bytes <= bytes_max - rows.len());
        let bytes = bytes.ok_or(Error::TooLarge)?;
        match kind {
            _ if count == 0 => return Err(Error::Damaged),
            AS_THEY_ARE => append(&mut rows, take(&mut rest, bytes)?)?,
            EQUAL => {
                let row = take(&mut rest, row_bytes)?;
                equal_left = equal_left.checked_sub(bytes).ok_or(Error::TooLarge)?;
                reserve(&mut rows, bytes)?;
                (0..count).for_each(|_| rows.extend(row));
            }
            EVENTS | EVENTS_SIGNED => {
                let off = if kind == EVENTS {
                    Off::Zero
                } else {
                    Off::MinusOne
                };
                let length = number(&mut rest)? as usize;
                let frames = take(&mut rest, length)?;
                let mut outcome = Ok(());
                let decoded = decode_events(frames, count, |events| {
                    outcome = outcome.and_then(|()| append_events(&mut rows, events, layout, off));
                });
                outcome?;
                decoded.ok_or(Error::Damaged)?;
            }
            _ => return Err(Error::Damaged),
        }
    }
    if chunk_bytes.is_some_and(|bytes| bytes != rows.len()) {
        return Err(Error::Rows);
    }
    Ok(rows)
}

/// Decodes `count` events from frames, and calls `each` for the events of every window. `None` if the frames are
/// damaged or are of another number of events.
fn decode_events(frames: &[u8], count: u32, mut each: impl FnMut(&[Event])) -> Option<()> {
    let limit = WindowLimit::Events(count);
    let mut windows = WindowReader::new(FrameReader::new(frames)).with_limit(limit);
    let mut left = count as usize;
    while let Some(window) = windows.next_window().ok()? {
        left = left.checked_sub(window.events.len())?;
        each(&window.events);
        windows.reuse(window);
    }
    (left == 0).then_some(())
}

fn append_events(
    rows: &mut Vec<u8>,
    events: &[Event],
    layout: &Layout,
    off: Off,
) -> Result<(), Error> {
    let begin = rows.len();
    let bytes = events.len() * layout.row_bytes();
    reserve(rows, bytes)?;
    rows.resize(begin + bytes, 0);
    let places = rows[begin..].chunks_exact_mut(layout.row_bytes());
    for (row, event) in places.zip(events) {
        layout.set(row, event, off);
    }
    Ok(())
}

fn append(rows: &mut Vec<u8>, bytes: &[u8]) -> Result<(), Error> {
    reserve(rows, bytes.len())?;
    rows.extend(bytes);
    Ok(())
}

fn reserve(rows: &mut Vec<u8>, bytes: usize) -> Result<(), Error> {
    rows.try_reserve(bytes).map_err(|_| Error::TooLarge)
}

fn take<'b>(rest: &mut &'b [u8], bytes: usize) -> Result<&'b [u8], Error> {
    let (taken, behind) = rest.split_at_checked(bytes).ok_or(Error::Damaged)?;
    *rest = behind;
    Ok(taken)
}

fn number(rest: &mut &[u8]) -> Result<u32, Error> {
    let bytes = take(rest, 4)?;
    Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}
