//! Puts any payloads into frames that are whole, with headers of every kind: they decode to events or are refused.
//! Their checksums keep a fuzzer out of [`super::frames`].

use eecvs_nostd::coder::tree::Levels;
use eecvs_nostd::frame::{CRC_BYTES, HEADER_BYTES_MAX, OrderSection, seal};
use eecvs_nostd::{Axis, Header, Quantiser, Readout, Regime, Scans, Sensor, Transform};

use super::encode::to_mode;
use super::frames;

/// Sensor of all frames.
pub const SENSOR: Sensor = Sensor {
    width: 40,
    height: 24,
};
/// Duration of their windows.
pub const WINDOW_US: u32 = 1 << 13;

/// Returns the largest number of events of pixels that are sent as times, as a byte tells it.
pub const fn few(byte: u8) -> u8 {
    2 + byte % 62
}

/// Runs one input.
pub fn run(data: &[u8]) {
    let (mut rest, mut stream, mut sequence) = (data, Vec::new(), 0);
    while let [
        length,
        flags,
        mode,
        fidelity,
        window_events,
        events,
        pixels,
        order,
        after @ ..,
    ] = rest
    {
        let bytes = usize::from(*length) * 4;
        let payload;
        (payload, rest) = after.split_at(bytes.min(after.len()));
        let has = |bit: u8| flags >> bit & 1 == 1;
        let window_events = u32::from(*window_events);
        let kind = to_mode(*mode, *fidelity);
        let has_few = has(7) && kind.is_transform();
        let readout = Readout::new(Axis::Columns, 20 << 16, 1 << 10);
        let header = Header {
            truncated: false,
            begins_run: has(0),
            last: has(1),
            regime: Regime::Moderate,
            mode: kind,
            is_key: has(2),
            has_previous: has(3),
            // All eight bits are in use: the fidelity's byte has levels too.
            levels: Some(Levels {
                first: *fidelity & 7,
                second: *fidelity >> 3 & 7,
            }),
            scans: readout
                .filter(|_| has(4))
                .and_then(|readout| Scans::new(readout, 0, SENSOR, WINDOW_US)),
            order: has(5).then_some(OrderSection {
                bytes: u32::from(*order >> 4),
                events: u32::from(*order & 15),
            }),
            sequence,
            part: u32::from(has(6)),
            sensor: SENSOR,
            t0_us: u64::from(WINDOW_US) * u64::from(sequence / 2),
            duration_us: WINDOW_US,
            window_events,
            events: window_events.min((*events).into()),
            pixels: (*pixels).into(),
            late: 0,
            filtered: 0,
            dropped: 0,
            thinned: 0,
            saturated: 0,
            transform: Transform::ALL[usize::from(*mode >> 4) % 3],
            m: 8,
            grid: 8,
            quantiser: Quantiser::DEFAULT,
            timed_max: u8::from(has_few) * few(*fidelity),
        };
        let mut out = vec![0; HEADER_BYTES_MAX + payload.len() + CRC_BYTES];
        out[HEADER_BYTES_MAX..][..payload.len()].copy_from_slice(payload);
        let range = seal(&header, payload.len(), &mut out).expect("there is room");
        stream.extend_from_slice(&out[range]);
        sequence += 1;
    }
    frames::run(&stream);
}
