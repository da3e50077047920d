//! The figures of memory.x are those of the types.

use std::mem::size_of;

use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::{Slot, WindowEncoder, bitmap_words, segments};

const WINDOWS: usize = 2;
const WINDOW_EVENTS: usize = 4096;
const RAM_BYTES: usize = 128 << 10;

#[test]
fn the_budget_of_the_linker_script_is_true() {
    let segments = segments(320, 320);
    // 2K numbers for the largest grid of M = 16.
    let numbers = 2 * 32;
    let rows = [
        ("slots", WINDOWS * WINDOW_EVENTS * size_of::<Slot>()),
        ("heads", WINDOWS * segments * size_of::<u32>()),
        (
            "bitmaps",
            WINDOWS * bitmap_words(segments) * size_of::<u32>(),
        ),
        (
            "scratch",
            numbers * (size_of::<Sum>() + size_of::<WideSum>() + size_of::<u32>()),
        ),
        // Of a 64-bit host: pointers are narrower on the target.
        ("encoder", size_of::<WindowEncoder<'_>>()),
        ("output", 4096),
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
    assert!(total <= RAM_BYTES);
}
