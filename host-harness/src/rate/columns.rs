//! Events as a structure of arrays, the input of general compressors.
//!
//! ```text
//! events          u64
//! first t, us     u64
//! width, height   u16 each
//! t               u32 each: us since the event before, 0 for the first
//! x               u16 each
//! y               u16 each
//! p               u8 each: 1 for ON
//! ```
//!
//! Little-endian. Columns of several bytes are shuffled: the lowest byte of every event, then the next byte of
//! every event, and so on, so that bytes that change little lie together.

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Polarity, Sensor};

const HEADER_BYTES: usize = 20;
/// Bytes per event of t, x, y and p.
const COLUMNS: [usize; 4] = [4, 2, 2, 1];

/// Serialises events in order of time.
///
/// # Errors
/// Fails if an event is earlier than the one before it, or 2^32 us or more later.
pub fn write(sensor: Sensor, events: &[Event]) -> Result<Vec<u8>> {
    let first_us = events.first().map_or(0, |event| event.t_us);
    let mut bytes = Vec::with_capacity(HEADER_BYTES + 9 * events.len());
    bytes.extend_from_slice(&(events.len() as u64).to_le_bytes());
    bytes.extend_from_slice(&first_us.to_le_bytes());
    bytes.extend_from_slice(&sensor.width.to_le_bytes());
    bytes.extend_from_slice(&sensor.height.to_le_bytes());
    let steps = steps(events)?;
    shuffle(&mut bytes, &steps.iter().map(|step| step.to_le_bytes()));
    shuffle(
        &mut bytes,
        &events.iter().map(|event| event.x.to_le_bytes()),
    );
    shuffle(
        &mut bytes,
        &events.iter().map(|event| event.y.to_le_bytes()),
    );
    bytes.extend(
        events
            .iter()
            .map(|event| u8::from(event.polarity == Polarity::On)),
    );
    Ok(bytes)
}

/// Returns us since the event before, 0 for the first.
///
/// # Errors
/// Fails if an event is earlier than the one before it, or 2^32 us or more later.
pub(super) fn steps(events: &[Event]) -> Result<Vec<u32>> {
    let mut before_us = events.first().map_or(0, |event| event.t_us);
    let step = |event: &Event| {
        let step = event.t_us.checked_sub(before_us);
        before_us = event.t_us;
        let step = step.and_then(|step| u32::try_from(step).ok());
        step.context("a time step that does not fit into 32 bits")
    };
    events.iter().map(step).collect()
}

/// Reads the sensor and the events that [`write()`] wrote.
///
/// # Errors
/// Fails if the bytes are not as [`write()`] writes them.
pub fn read(bytes: &[u8]) -> Result<(Sensor, Vec<Event>)> {
    let damaged = "not a structure of arrays";
    let word = |at: usize| -> Option<u64> {
        let word = bytes.get(at..at + 8)?;
        Some(u64::from_le_bytes(word.try_into().ok()?))
    };
    let side = |at: usize| -> Option<u16> {
        let side = bytes.get(at..at + 2)?;
        Some(u16::from_le_bytes(side.try_into().ok()?))
    };
    let count = usize::try_from(word(0).context(damaged)?)?;
    let mut t_us = word(8).context(damaged)?;
    let sensor = side(16).zip(side(18)).context(damaged)?;
    let sensor = Sensor::new(sensor.0, sensor.1).context(damaged)?;
    let total = count.checked_mul(COLUMNS.iter().sum());
    let mut rest = bytes.get(HEADER_BYTES..).context(damaged)?;
    ensure!(total == Some(rest.len()), damaged);
    let [steps, xs, ys, on] = COLUMNS.map(|width| {
        let (column, after) = rest.split_at_checked(width * count).unwrap_or_default();
        rest = after;
        column
    });
    let value = |column: &[u8], width: usize, index: usize| -> u32 {
        let byte = |place: usize| column.get(place * count + index).copied().unwrap_or(0);
        (0..width).fold(0, |value, place| {
            value | u32::from(byte(place)) << (8 * place)
        })
    };
    let mut events = Vec::with_capacity(count);
    for index in 0..count {
        let step = u64::from(value(steps, 4, index));
        t_us = t_us.checked_add(step).context(damaged)?;
        events.push(Event {
            t_us,
            x: value(xs, 2, index) as u16,
            y: value(ys, 2, index) as u16,
            polarity: Polarity::from_bool(value(on, 1, index) == 1),
        });
    }
    Ok((sensor, events))
}

/// Appends the first byte of every value, then the second byte of every value, and so on.
fn shuffle<const N: usize>(bytes: &mut Vec<u8>, values: &(impl Iterator<Item = [u8; N]> + Clone)) {
    for place in 0..N {
        bytes.extend(values.clone().filter_map(|value| value.get(place).copied()));
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 640,
        height: 480,
    };

    #[test]
    fn columns_are_shuffled_by_bytes() {
        let events = [event(7, 0x102, 3, true), event(0x20_0007, 4, 0x105, false)];
        let bytes = write(SENSOR, &events).unwrap();
        let expected = [
            &[2, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0][..],
            &[0x80, 2, 0xe0, 1],
            // Steps of 0 and 0x20_0000.
            &[0, 0, 0, 0, 0, 0x20, 0, 0],
            &[2, 4, 1, 0],
            &[3, 5, 0, 1],
            &[1, 0],
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(read(&bytes).unwrap(), (SENSOR, events.to_vec()));
    }

    #[test]
    fn whatever_is_written_reads_back() {
        assert_eq!(
            read(&write(SENSOR, &[]).unwrap()).unwrap(),
            (SENSOR, vec![])
        );
        let at = |t_us| event(t_us, 1, 1, true);
        assert!(write(SENSOR, &[at(5), at(4)]).is_err());
        assert!(write(SENSOR, &[at(0), at(1 << 32)]).is_err());
        let most = [at(u64::MAX - u64::from(u32::MAX)), at(u64::MAX)];
        assert_eq!(read(&write(SENSOR, &most).unwrap()).unwrap().1, most);
        let bytes = write(SENSOR, &most).unwrap();
        for len in 0..bytes.len() {
            assert!(read(&bytes[..len]).is_err());
        }
        // A last time beyond 64 bits, and more events than bytes.
        let mut beyond = bytes.clone();
        beyond[8..16].fill(0xff);
        assert!(read(&beyond).is_err());
        beyond[..8].fill(0xff);
        assert!(read(&beyond).is_err());
    }
}
