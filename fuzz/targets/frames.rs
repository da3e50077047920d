//! Reads any bytes as a stream of frames: no panic, no endless loop, no more damage than bytes, and every frame decodes
//! to events or is refused.

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::work_limit::WorkLimit;
use eecvs_nostd::Mode;

/// Runs one input.
pub fn run(data: &[u8]) {
    let mut windows = WindowReader::new(FrameReader::new(data));
    while let Some(window) = windows.next_window().expect("memory does not fail") {
        let header = window.header;
        let counts = window
            .pixels
            .iter()
            .map(|p| u64::from(p.on) + u64::from(p.off));
        let events = match header.mode {
            Mode::Hybrid(_) => window.events.len() as u64,
            Mode::Transform | Mode::Coefficients(_) => counts.sum(),
        };
        for finder in [Finder::Exact, Finder::Peaks] {
            let mut window = window.clone();
            let limit = WorkLimit::millions(20);
            let mut decoder = EventDecoder::new(finder).with_work_limit(limit);
            decoder.fill(&mut window);
            assert!(decoder.units() <= limit.get());
            assert_eq!(window.events.len() as u64, events);
            assert!(
                window
                    .events
                    .iter()
                    .all(|event| header.sensor.contains(event.x, event.y))
            );
            assert!(window.events.is_sorted_by_key(|event| event.t_us));
        }
    }
    let damaged = windows.report().damaged_bytes;
    assert!(damaged <= data.len() as u64, "{damaged} of {}", data.len());
}
