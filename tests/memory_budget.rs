//! The figures of memory.x are those of the types.

use std::mem::size_of;

use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::{Slot, WindowEncoder, bitmap_words, segments};

const RAM_BYTES: usize = 1210 << 10;
const STACK_BYTES: usize = 10 << 10;
/// Of firmware/src/encoding.rs.
const WINDOW_WORDS: usize = 22 * 1024;
const NUMBERS: usize = 256;
const FRAME_BYTES: usize = 4096;

/// Events that each of two windows holds on the target, as `WindowBuffers::share` divides.
fn window_events(width: u16, height: u16) -> usize {
    let segments = segments(width, height);
    // `Head` of the target is 16 bits; a host's is wider.
    let heads_words = (segments * size_of::<u16>()).div_ceil(4);
    (WINDOW_WORDS / 2 - bitmap_words(segments) - heads_words) * 4 / size_of::<Slot>()
}

#[test]
fn the_readme_says_what_windows_hold() {
    let readme = include_str!("../firmware/README.md");
    for (width, height) in [(128, 128), (320, 320), (346, 260), (640, 480)] {
        let events = window_events(width, height);
        let row = format!(
            "| {width} x {height} | {},{:03} |",
            events / 1000,
            events % 1000
        );
        assert!(readme.contains(&row), "{row}");
    }
}

#[test]
fn the_budget_of_the_linker_script_is_true() {
    let source = include_str!("../firmware/src/encoding.rs");
    for constant in [
        "WINDOW_WORDS: usize = 22 * 1024;",
        "NUMBERS: usize = 256;",
        "FRAME_BYTES: usize = 4096;",
    ] {
        assert!(source.contains(constant), "{constant}");
    }
    let rows = [
        ("windows", WINDOW_WORDS * 4),
        (
            "numbers",
            NUMBERS * (size_of::<Sum>() + size_of::<WideSum>() + size_of::<u32>()),
        ),
        // Of a 64-bit host: pointers are narrower on the target.
        ("encoder", size_of::<WindowEncoder<'_>>()),
        ("output", FRAME_BYTES),
    ];
    let script = include_str!("../memory.x");
    let figure = |name: &str| -> usize {
        let line = script
            .lines()
            .find_map(|line| line.strip_prefix(" *   ")?.strip_prefix(name))
            .unwrap_or_else(|| panic!("memory.x has a line for {name}"));
        line.split_whitespace()
            .next()
            .and_then(|bytes| bytes.parse().ok())
            .expect("bytes")
    };
    for (name, bytes) in rows {
        assert_eq!(figure(name), bytes, "{name}");
    }
    let total = rows.iter().map(|(_, bytes)| bytes).sum::<usize>();
    assert_eq!(figure("total"), total);
    assert!(total + STACK_BYTES <= RAM_BYTES);
}
