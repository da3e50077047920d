//! Rows in packed form.

use std::num::NonZeroUsize;

use eecvs::encode::{Limits, WINDOW_EVENTS, encode};
use eecvs_nostd::coder::{Coder, Fidelity, Hybrid};
use eecvs_nostd::{Config, Mode, OUTPUT_BYTES_MIN, Sensor, Thresholds, WindowConfig};
use event_types::Event;
use event_types::stream::MemoryReader;

use super::{AS_THEY_ARE, EQUAL, EQUAL_BYTES_MAX, EVENTS, EVENTS_SIGNED, VERSION};
use crate::Error;
use crate::layout::{Effort, Layout, Off};

/// Fewest rows that are coded as events: fewer are not worth an encoder.
const EVENTS_MIN: usize = 512;
/// Fewest rows that are packed as equal.
const EQUAL_MIN: usize = 16;

/// Events of a window, if time passes evenly: below it, headers cost more.
const EVENTS_PER_WINDOW: u64 = 1 << 15;
/// Fewest events of a window, in the mean: of fewer, frames take as many bytes as the rows.
const EVENTS_PER_WINDOW_MIN: usize = 16;
/// Shortest and longest windows in microseconds.
const WINDOW_US: [u64; 2] = [1 << 12, 1 << 21];

/// Packs the rows of a chunk.
///
/// Rows that are not events are kept as they are, so that the largest size is that of the rows and ten bytes.
///
/// # Errors
/// [`Error::PartOfRow`]; [`Error::Rows`]; [`Error::TooLarge`] from 4 GiB on, as for HDF5.
pub fn pack(rows: &[u8], layout: &Layout) -> Result<Vec<u8>, Error> {
    let row_bytes = layout.row_bytes();
    if !rows.len().is_multiple_of(row_bytes) {
        return Err(Error::PartOfRow);
    }
    if layout
        .chunk_bytes()
        .is_some_and(|bytes| bytes != rows.len())
    {
        return Err(Error::Rows);
    }
    if u32::try_from(rows.len()).is_err() {
        return Err(Error::TooLarge);
    }
    let mut packed = vec![VERSION];
    let mut equal_left = EQUAL_BYTES_MAX;
    let mut rest = rows;
    // Rows in front of `rest` that wait to be packed as they are.
    let mut waiting = 0;
    while !rest.is_empty() {
        let before = &rows[..rows.len() - rest.len()];
        let equal = rest.chunks_exact(row_bytes);
        let equal = equal.take_while(|row| *row == &rest[..row_bytes]).count();
        let (count, piece) = if equal >= EQUAL_MIN {
            let is_few = equal * row_bytes <= equal_left;
            let piece = is_few.then(|| (EQUAL, rest[..row_bytes].to_vec()));
            equal_left -= if is_few { equal * row_bytes } else { 0 };
            (equal, piece)
        } else {
            events(rest, layout)
        };
        let bytes = count * row_bytes;
        match piece {
            // Its head, and that of rows as they are in front of it.
            Some((kind, content)) if content.len() + 14 < bytes => {
                as_they_are(&mut packed, &before[before.len() - waiting..], row_bytes);
                waiting = 0;
                head(&mut packed, kind, count);
                if kind != EQUAL {
                    packed.extend((content.len() as u32).to_le_bytes());
                }
                packed.extend(content);
            }
            _ => waiting += bytes,
        }
        rest = &rest[bytes..];
    }
    as_they_are(&mut packed, &rows[rows.len() - waiting..], row_bytes);
    let checksum = crc32fast::hash(&packed);
    packed.extend(checksum.to_le_bytes());
    Ok(packed)
}

fn head(packed: &mut Vec<u8>, kind: u8, rows: usize) {
    packed.push(kind);
    packed.extend((rows as u32).to_le_bytes());
}

fn as_they_are(packed: &mut Vec<u8>, rows: &[u8], row_bytes: usize) {
    if !rows.is_empty() {
        head(packed, AS_THEY_ARE, rows.len() / row_bytes);
        packed.extend(rows);
    }
}

/// Returns how many of the first rows are alike, events in order of time or none, and the events' frames, if they are
/// worth it.
fn events(rows: &[u8], layout: &Layout) -> (usize, Option<(u8, Vec<u8>)>) {
    let row_bytes = layout.row_bytes();
    let ascending = |off| {
        let mut last_us = 0;
        let mut equal = 1;
        let mut before: &[u8] = &[];
        let mut found = Vec::new();
        for row in rows.chunks_exact(row_bytes) {
            equal = if row == before { equal + 1 } else { 1 };
            before = row;
            match layout.event(row, off) {
                Some(event) if event.t_us >= last_us && equal < EQUAL_MIN => {
                    last_us = event.t_us;
                    found.push(event);
                }
                // The equal rows are a piece of their own.
                Some(_) if equal >= EQUAL_MIN => {
                    found.truncate((found.len() + 1).saturating_sub(equal));
                    break;
                }
                _ => break,
            }
        }
        found
    };
    let unsigned = ascending(Off::Zero);
    // Rows of ON events alone are either; all of a chunk, mostly, are of one kind.
    let is_all = unsigned.len() * row_bytes == rows.len();
    let signed = if is_all || unsigned.len() >= EVENTS_MIN {
        Vec::new()
    } else {
        ascending(Off::MinusOne)
    };
    let (kind, found) = if signed.len() > unsigned.len() {
        (EVENTS_SIGNED, signed)
    } else {
        (EVENTS, unsigned)
    };
    let count = found.len().max(1);
    if found.len() < EVENTS_MIN {
        return (count, None);
    }
    let frames = encode_events(found, layout.effort);
    (count, frames.map(|frames| (kind, frames)))
}

/// Codes events, which are in order of time, as frames. `None` if so few lie in a window that frames are not worth their
/// time, or if there is not the memory for it.
fn encode_events(events: Vec<Event>, effort: Effort) -> Option<Vec<u8>> {
    let (first, last) = (events.first()?, events.last()?);
    let sensor = Sensor {
        width: events.iter().map(|event| event.x).max()? + 1,
        height: events.iter().map(|event| event.y).max()? + 1,
    };
    let span_us = last.t_us - first.t_us;
    let window_us = u128::from(span_us) * u128::from(EVENTS_PER_WINDOW) / events.len() as u128;
    let window_us = u64::try_from(window_us).unwrap_or(u64::MAX);
    let [shortest_us, longest_us] = WINDOW_US;
    let window_us = window_us.clamp(shortest_us, longest_us).next_power_of_two();
    let window = |event: &Event| (event.t_us - first.t_us) / window_us;
    let starts = events
        .windows(2)
        .filter(|pair| window(&pair[0]) < window(&pair[1]));
    if (starts.count() * EVENTS_PER_WINDOW_MIN) > events.len() {
        return None;
    }
    let mode = Mode::Hybrid(Hybrid {
        coder: match effort {
            Effort::Quick => Coder::Quick,
            Effort::Tree(effort) => Coder::Tree(effort),
        },
        fidelity: Fidelity::Lossless,
    });
    let windows = WindowConfig::new(sensor, window_us as u32);
    // No frame has a transform, and no volume is asked for.
    let mut config = Config::new(windows, Thresholds::new(0, 0)?, mode);
    config.keep_order = true;
    let window_events = events.len().min(WINDOW_EVENTS);
    let limits = Limits {
        window_events,
        frame_bytes: (window_events * 16).max(OUTPUT_BYTES_MIN).max(1 << 16),
        reorder_us: Some(0),
        ..Limits::default()
    };
    let count = events.len() as u64;
    let mut frames = Vec::new();
    let summary = encode(
        &mut MemoryReader::new(sensor, events),
        config,
        limits,
        NonZeroUsize::MIN,
        &mut frames,
        &mut |_| (),
    );
    let summary = summary.ok()?;
    let is_exact =
        summary.events_encoded == count && summary.events_approximate == 0 && summary.runs == 1;
    is_exact.then_some(frames)
}
