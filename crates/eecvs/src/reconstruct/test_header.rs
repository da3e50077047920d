//! A frame header for tests.

use eecvs_nostd::{Header, Mode, Quantiser, Regime, Sensor, Transform};

/// Returns the header of a DTFT window of an 8 x 4 sensor that starts at 5,000 us, with K = M = 16 and step 2^3.
pub fn header(duration_us: u32) -> Header {
    Header {
        truncated: false,
        begins_run: false,
        last: true,
        regime: Regime::Moderate,
        mode: Mode::Transform,
        is_key: true,
        has_previous: false,
        levels: None,
        scans: None,
        order: None,
        sequence: 0,
        part: 0,
        sensor: Sensor {
            width: 8,
            height: 4,
        },
        t0_us: 5000,
        duration_us,
        window_events: 1,
        events: 1,
        pixels: 1,
        late: 0,
        filtered: 0,
        dropped: 0,
        thinned: 0,
        saturated: 0,
        transform: Transform::Dtft,
        m: 16,
        grid: 16,
        quantiser: Quantiser::new(3).expect("in range"),
        timed_max: 0,
    }
}
