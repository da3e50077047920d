//! The figures of memory.x are those of the types.

use std::mem::size_of;

use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::words;
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::{Sensor, Slot, WindowEncoder, bitmap_words, segments};
use eecvs_usb_class::Outgoing;

const RAM_BYTES: usize = 128 << 10;
const STACK_BYTES: usize = 10 << 10;
/// Of firmware/src/memory.rs.
const WINDOW_WORDS: usize = 22 * 1024;
const FRAME_BYTES: usize = 4096;
const DENSE_FRAME_BYTES: usize = 8192;
const PREVIOUS_WORDS_MAX: usize = WINDOW_WORDS / 16;
/// Of firmware/src/encoding.rs.
const NUMBERS: usize = 256;
const HOT_PIXELS: usize = 512;
/// The same of the small image, and of firmware/src/receiving.rs.
const SMALL_RAM_BYTES: usize = 48 << 10;
const SMALL_STACK_BYTES: usize = 7 << 10;
const SMALL_WINDOW_WORDS: usize = 2 * 2048 + 1700;
const SMALL_HOT_PIXELS: usize = 128;
const SMALL_RING_BYTES: usize = 8192;

/// Events that each of some windows holds on the target, as `WindowBuffers::share` divides.
fn events_of(windows: usize, memory_words: usize, sensor: Sensor) -> usize {
    let segments = segments(sensor.width, sensor.height);
    // `Head` of the target is 16 bits; a host's is wider.
    let heads_words = (segments * size_of::<u16>()).div_ceil(4);
    (memory_words / windows - bitmap_words(segments) - heads_words) * 4 / size_of::<Slot>()
}

fn window_events(memory_words: usize, sensor: Sensor) -> usize {
    events_of(2, memory_words, sensor)
}

/// The same beside the dense coder.
fn dense_window_events(sensor: Sensor) -> usize {
    let bytes = WINDOW_WORDS * 4 + FRAME_BYTES - DENSE_FRAME_BYTES - size_of::<Model>();
    let with_previous = words(sensor, true);
    let words = match with_previous <= PREVIOUS_WORDS_MAX {
        true => with_previous,
        false => words(sensor, false),
    };
    window_events(bytes / 4 - words, sensor)
}

#[test]
fn the_readme_says_what_windows_hold() {
    let readme = include_str!("../../firmware/README.md");
    let thousands = |events: usize| match events / 1000 {
        0 => events.to_string(),
        thousands => format!("{thousands},{:03}", events % 1000),
    };
    let in_order = thousands(WINDOW_WORDS / 2 * size_of::<u32>() / size_of::<Slot>());
    assert!(readme.contains(&format!(
        "windows hold {in_order} events whatever the sensor"
    )));
    for (width, height) in [(128, 128), (320, 320), (346, 260), (640, 480)] {
        let sensor = Sensor { width, height };
        let row = format!(
            "| {width} x {height} | {} | {} | {} |",
            thousands(window_events(WINDOW_WORDS, sensor)),
            thousands(dense_window_events(sensor)),
            thousands(events_of(1, SMALL_WINDOW_WORDS, sensor))
        );
        assert!(readme.contains(&row), "{row}");
    }
}

#[test]
fn the_budget_of_the_linker_script_is_true() {
    let source = [
        include_str!("../../firmware/src/encoding.rs"),
        include_str!("../../firmware/src/memory.rs"),
    ]
    .concat();
    for constant in [
        "WINDOW_WORDS: usize = 22 * 1024;",
        " FRAME_BYTES: usize = 4096;",
        "DENSE_FRAME_BYTES: usize = 8192;",
        "PREVIOUS_WORDS_MAX: usize = WINDOW_WORDS / 16;",
        "NUMBERS: usize = if IS_FULL { 256 } else { 0 };",
        "HOT_PIXELS: usize = if IS_FULL { 512 } else { 128 };",
    ] {
        assert!(source.contains(constant), "{constant}");
    }
    let rows = [
        ("windows", WINDOW_WORDS * 4),
        ("output", FRAME_BYTES),
        (
            "numbers",
            NUMBERS * (size_of::<Sum>() + size_of::<WideSum>() + size_of::<u32>()),
        ),
        ("hot pixels", HOT_PIXELS * size_of::<u32>()),
        // Of a 64-bit host: pointers are narrower on the target.
        ("encoder", size_of::<WindowEncoder<'_>>()),
    ];
    let model = size_of::<Model>();
    let script = include_str!("../../memory.x");
    assert!(
        script.contains(&format!("its model, {model} bytes")),
        "{model}"
    );
    assert!(rows_are_true(script, &rows) + STACK_BYTES <= RAM_BYTES);
    assert_eq!(figure(script, "usb queue"), size_of::<Outgoing>());
}

#[test]
fn the_budget_of_the_small_image_is_true() {
    let source = [
        include_str!("../../firmware/src/encoding.rs"),
        include_str!("../../firmware/src/memory.rs"),
        include_str!("../../firmware/src/receiving.rs"),
    ]
    .concat();
    for constant in [
        "WINDOW_WORDS: usize = 2 * 2048 + 1700;",
        " FRAME_BYTES: usize = 4096;",
        "HOT_PIXELS: usize = if IS_FULL { 512 } else { 128 };",
        "RING_BYTES: usize = if HAS_TWO_WINDOWS { 1024 } else { 8192 };",
    ] {
        assert!(source.contains(constant), "{constant}");
    }
    let sensor = Sensor {
        width: 320,
        height: 320,
    };
    assert_eq!(events_of(1, SMALL_WINDOW_WORDS, sensor), 2048);
    let rows = [
        ("window", SMALL_WINDOW_WORDS * 4),
        ("output", FRAME_BYTES),
        ("ring", SMALL_RING_BYTES),
        ("hot pixels", SMALL_HOT_PIXELS * size_of::<u32>()),
        ("encoder", size_of::<WindowEncoder<'_>>()),
    ];
    let script = include_str!("../../firmware/memory/small.x");
    assert!(rows_are_true(script, &rows) + SMALL_STACK_BYTES <= SMALL_RAM_BYTES);
}

/// The bytes that a linker script's comment has for a name.
fn figure(script: &str, name: &str) -> usize {
    let line = script
        .lines()
        .find_map(|line| line.strip_prefix(" *   ")?.strip_prefix(name))
        .unwrap_or_else(|| panic!("the linker script has a line for {name}"));
    line.split_whitespace()
        .next()
        .and_then(|bytes| bytes.parse().ok())
        .expect("bytes")
}

/// Compares rows, and their total, with the comment; returns the total.
fn rows_are_true(script: &str, rows: &[(&str, usize)]) -> usize {
    for (name, bytes) in rows {
        assert_eq!(figure(script, name), *bytes, "{name}");
    }
    let total = rows.iter().map(|(_, bytes)| bytes).sum();
    assert_eq!(figure(script, "total"), total);
    total
}
