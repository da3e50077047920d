//! Reads any bytes as a stream of frames: no panic, no endless loop, every byte is accounted for, and every frame
//! decodes to events or is refused.

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::events::{EventDecoder, Finder};

/// Runs one input.
pub fn run(data: &[u8]) {
    let mut windows = WindowReader::new(FrameReader::new(data));
    while let Some(window) = windows.next_window().expect("memory does not fail") {
        let header = window.header;
        let events: u64 = window
            .pixels
            .iter()
            .map(|p| u64::from(p.on) + u64::from(p.off))
            .sum();
        if events > 1000 || header.grid > 64 {
            continue;
        }
        for finder in [Finder::Exact, Finder::Peaks] {
            let decoder = EventDecoder::new(header.transform, header.grid, header.m, finder);
            assert_eq!(decoder.window(&window).len() as u64, events);
        }
    }
}
