//! The coder as a whole: every window comes back, and any bytes are decoded to an end.

use super::*;
use crate::coder::{Axis, Cells, Fidelity, Readout};
use proptest::prelude::*;
use std::{vec, vec::Vec};

/// Memory of any content.
struct Memory {
    counters: Vec<Counter>,
    weights: Vec<Weights>,
    curves: Vec<Curve>,
    bytes: Vec<u8>,
    halves: Vec<u16>,
    words: Vec<u32>,
    pixels: Vec<Pixel>,
    seconds: Vec<Nodes>,
    marks: Vec<Marks>,
    events: Vec<TreeEvent>,
}

impl Memory {
    fn new(sizes: Sizes) -> Self {
        Self {
            counters: vec![Counter::UNSET; sizes.counters],
            weights: vec![[7; 16]; sizes.weights],
            curves: vec![[7; 33]; sizes.curves],
            bytes: vec![7; sizes.bytes],
            halves: vec![7; sizes.halves],
            words: vec![7; sizes.words],
            pixels: vec![Pixel::NONE; sizes.pixels],
            seconds: vec![Nodes::default(); sizes.seconds],
            marks: vec![Marks::default(); sizes.marks],
            events: vec![TreeEvent::NONE; sizes.events],
        }
    }

    fn lent(&mut self) -> TreeMemory<'_> {
        TreeMemory {
            counters: &mut self.counters,
            weights: &mut self.weights,
            curves: &mut self.curves,
            bytes: &mut self.bytes,
            halves: &mut self.halves,
            words: &mut self.words,
            pixels: &mut self.pixels,
            seconds: &mut self.seconds,
            marks: &mut self.marks,
            events: &mut self.events,
        }
    }

    /// What a frame continues from: all but what is set anew in each window.
    fn state(&self) -> impl PartialEq + std::fmt::Debug + '_ {
        (
            (&self.counters, &self.weights, &self.curves),
            (&self.bytes, &self.words, &self.pixels),
        )
    }
}

/// How a chain of windows is coded.
#[derive(Debug, Clone, Copy)]
struct Case {
    sensor: Sensor,
    effort: Effort,
    shape: Shape,
    times: Times,
    has_history: bool,
}

impl Case {
    fn memory(&self, events: usize) -> Memory {
        Memory::new(Sizes::new(
            self.sensor,
            self.effort,
            events,
            self.has_history,
        ))
    }

    fn tree<'b>(&self, events: usize, memory: &'b mut TreeMemory<'_>) -> Tree<'b> {
        let tree = Tree::new(self.sensor, self.effort, events, self.has_history, memory);
        tree.unwrap()
    }
}

/// Cells of a microsecond.
fn cells(count: u32) -> Times {
    Times::Cells(Cells::new(Fidelity::Lossless, count))
}

/// Scans of a window: along columns or rows, period, slope, and a number that says how much before the window the line
/// that is read last has its first scan.
fn scans_of(
    sensor: Sensor,
    duration_us: u32,
    (is_columns, period_q16, slope_q16, ago): (bool, u32, i32, u32),
) -> Option<Scans> {
    let axis = if is_columns {
        Axis::Columns
    } else {
        Axis::Rows
    };
    let readout = Readout::new(axis, period_q16, slope_q16)?;
    let lines = if is_columns {
        sensor.width
    } else {
        sensor.height
    };
    let last = i64::from(slope_q16.max(0)) * i64::from(lines - 1);
    let phase_q16 = i32::try_from(-last - i64::from(ago % period_q16)).ok()?;
    Scans::new(readout, phase_q16, sensor, duration_us)
}

fn sensors() -> impl Strategy<Value = Sensor> {
    let sides = prop_oneof![
        4 => (1_u16..150, 1_u16..60),
        1 => Just((1, 1)),
        1 => Just((2048, 1)),
        1 => Just((1, 2048)),
    ];
    sides.prop_map(|(width, height)| Sensor::new(width, height).unwrap())
}

fn cases() -> impl Strategy<Value = Case> {
    let units = prop_oneof![
        1_u32..200,
        1_u32..=1 << 28,
        (0_u32..=28).prop_map(|b| 1 << b)
    ];
    let shape = (1_u8..=6, 0_u8..=6);
    let scans = (
        any::<bool>(),
        16_u32 << 16..=250 << 16,
        -125_i32 << 16..=125 << 16,
        any::<u32>(),
    );
    let scans = proptest::option::weighted(0.3, scans);
    let effort = prop_oneof![
        6 => Just(Effort::One),
        1 => Just(Effort::Two),
        1 => Just(Effort::Three)
    ];
    let all = (sensors(), effort, (units, scans), shape, any::<bool>());
    all.prop_filter_map(
        "levels",
        |(sensor, effort, (units, scans), (first, second), has_history)| {
            let times = match scans {
                None => cells(units),
                Some(scans) => Times::Scans(scans_of(sensor, units, scans)?),
            };
            let second = if first == 6 { second } else { 0 };
            let shape = |first, second| Shape::new(times, Levels { first, second });
            let some = shape(first, second).or_else(|| shape(first, 0));
            let shape = some.or_else(|| shape(1, 0))?;
            Some(Case {
                sensor,
                effort,
                shape,
                times,
                has_history,
            })
        },
    )
}

/// A window's events in the coder's order: anywhere, in one corner, or all at one pixel or time.
fn window(case: Case) -> impl Strategy<Value = Vec<TreeEvent>> {
    let Sensor { width, height } = case.sensor;
    let near = |side: u16| prop_oneof![0..side, 0..side.min(3)];
    let count = case.times.count();
    let top = prop_oneof![0..count, 0..count.min(9)];
    // Distances from a scan that an encoder writes.
    let fine = prop_oneof![1_u32..256, 127_u32..130];
    let bits = case.times.fine_bits();
    let time =
        (top, fine).prop_map(move |(top, fine)| if bits == 0 { top } else { top << bits | fine });
    let event = (near(width), near(height), time, any::<bool>());
    let events = proptest::collection::vec(event, 0..120);
    (events, 0_u8..8).prop_map(move |(events, kind)| {
        let first = events.first().copied();
        let mut events: Vec<_> = events
            .into_iter()
            .map(|(x, y, time, on)| {
                let (x0, y0, time0, _) = first.unwrap_or((0, 0, 0, false));
                let place = if kind == 0 { (x0, y0) } else { (x, y) };
                TreeEvent::at(place, if kind == 1 { time0 } else { time }, on)
            })
            .collect();
        sort(&mut events);
        events
    })
}

fn sort(events: &mut [TreeEvent]) {
    events.sort_by_key(|event| (event.place() >> 16, event.place() & 0xFFFF, event.time));
}

fn chains() -> impl Strategy<Value = (Case, Vec<(bool, u32, Vec<TreeEvent>)>)> {
    cases().prop_flat_map(|case| {
        let window = (prop::bool::weighted(0.2), any::<u32>(), window(case));
        (Just(case), proptest::collection::vec(window, 1..5))
    })
}

fn most(windows: &[(bool, u32, Vec<TreeEvent>)]) -> usize {
    windows.iter().map(|window| window.2.len()).max().unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]

    /// A chain of windows, each with or without a key before it, comes back, and both sides are in the same state.
    #[test]
    fn windows_come_back((case, windows) in chains()) {
        let events = most(&windows);
        let (mut there, mut back) = (case.memory(events), case.memory(events));
        let (mut start, mut is_first) = (0_u32, true);
        for (is_key, skip, window) in &windows {
            let (mut lent, mut lent_back) = (there.lent(), back.lent());
            let mut encoder = case.tree(events, &mut lent);
            let mut decoder = case.tree(events, &mut lent_back);
            let is_key = *is_key || is_first;
            if is_key {
                encoder.restart();
                decoder.restart();
            }
            is_first = false;
            start = start.wrapping_add(if skip % 2 == 0 { case.times.count() } else { *skip });
            let mut out = vec![0; 64 + 24 * window.len()];
            let mut sent = window.clone();
            let len = encoder.encode(case.shape, start, &mut sent, &mut out).unwrap();
            prop_assert_eq!(&sent, window);
            let mut got = vec![TreeEvent::NONE; window.len()];
            prop_assert!(decoder.decode(case.shape, start, &out[..len], &mut got));
            prop_assert_eq!(&got, window);
            prop_assert!(there.state() == back.state());
            if is_key {
                // Nothing of the windows before is left.
                let mut memory = case.memory(events);
                let mut lent = memory.lent();
                let mut tree = case.tree(events, &mut lent);
                tree.restart();
                let mut alone = vec![0; out.len()];
                prop_assert_eq!(tree.encode(case.shape, start, &mut sent, &mut alone), Some(len));
                prop_assert_eq!(&alone[..len], &out[..len]);
            }
        }
    }

    /// A window that does not fit is refused, and after a restart the coder is as new.
    #[test]
    fn a_window_without_room_is_refused((case, windows) in chains(), part in 0.0_f64..1.0) {
        let events = most(&windows);
        let window = &windows[0].2;
        let encode = |memory: &mut Memory, room: usize| {
            let mut lent = memory.lent();
            let mut tree = case.tree(events, &mut lent);
            tree.restart();
            let mut out = vec![0; room];
            let len = tree.encode(case.shape, 5, &mut window.clone(), &mut out);
            len.map(|len| out[..len].to_vec())
        };
        let mut memory = case.memory(events);
        let whole = encode(&mut memory, 64 + 24 * window.len()).unwrap();
        let room = (part * whole.len() as f64) as usize;
        if room < whole.len() {
            prop_assert_eq!(encode(&mut memory, room), None);
        }
        prop_assert_eq!(encode(&mut memory, whole.len()), Some(whole));
    }

    /// Damaged payloads decode to an end; what they give lies on the sensor, and in the window as far as its bits.
    #[test]
    fn any_bytes_decode_without_a_panic(
        (case, windows) in chains(), noise in any::<Vec<u8>>(),
        flips in proptest::collection::vec((any::<prop::sample::Index>(), 0_u8..8), 0..4),
        cut in any::<prop::sample::Index>(), kind in 0_u8..4, more in 0_usize..200,
    ) {
        let events = most(&windows) + more;
        let (mut memory, mut other) = (case.memory(events), case.memory(events));
        let (mut lent, mut lent_other) = (memory.lent(), other.lent());
        let mut encoder = case.tree(events, &mut lent);
        let mut decoder = case.tree(events, &mut lent_other);
        encoder.restart();
        decoder.restart();
        for (_, start, window) in &windows {
            let mut out = vec![0; 64 + 24 * window.len()];
            let len = encoder.encode(case.shape, *start, &mut window.clone(), &mut out).unwrap();
            out.truncate(len);
            match kind {
                0 => out.clone_from(&noise),
                1 if len > 0 => out.truncate(cut.index(len)),
                2 if len > 0 => for (at, bit) in &flips {
                    out[at.index(len)] ^= 1 << bit;
                },
                _ => (),
            }
            let mut got = vec![TreeEvent::NONE; window.len() + more];
            let _ = decoder.decode(case.shape, *start, &out, &mut got);
            for event in got {
                let (x, y) = event.position();
                prop_assert!(x < case.sensor.width && y < case.sensor.height);
                prop_assert!(event.coded_time() >> case.shape.bits == 0);
            }
        }
    }
}

#[test]
fn shapes_have_bounds() {
    let levels = |units, first, second| {
        let shape = Shape::new(cells(units), Levels { first, second });
        shape.map(|shape| (shape.levels().first, shape.levels().second))
    };
    assert_eq!(levels(1, 1, 0), Some((1, 0)));
    assert_eq!(levels(1, 2, 0), None);
    assert_eq!(levels(32768, 6, 6), Some((6, 6)));
    assert_eq!(levels(2048, 6, 6), None);
    assert_eq!(levels(2049, 6, 6), Some((6, 6)));
    assert_eq!(levels(32768, 5, 1), None);
    assert_eq!(levels(32768, 6, 7), None);
    assert_eq!(levels(32768, 7, 0), None);
    assert_eq!(levels(32768, 0, 0), None);
    assert_eq!(levels(1 << 28, 6, 0), Some((6, 0)));
    assert_eq!(levels((1 << 28) + 1, 6, 0), None);
    for (number, effort) in (1..).zip(Effort::ALL) {
        assert_eq!(Effort::from_number(number), Some(effort));
        assert_eq!(effort as u8, number);
    }
    assert_eq!(
        (Effort::from_number(0), Effort::from_number(4)),
        (None, None)
    );
}

/// Every window within the bits of a time has a shape.
#[test]
fn windows_have_shapes() {
    for effort in Effort::ALL {
        for bits in 0..=31 {
            for (events, pixels) in [(0, 0), (1, 1), (5, 4), (2, 1), (3, 1), (9, 1), (1 << 24, 1)] {
                let shape = Shape::of_window(cells(1 << bits), effort, events, pixels);
                assert_eq!(shape.is_some(), bits <= TIME_BITS_MAX, "{bits}");
            }
        }
        let levels = |events| {
            let shape = Shape::of_window(cells(32768), effort, events, 8);
            shape.map(|shape| (shape.levels().first, shape.levels().second))
        };
        assert_eq!(levels(64), Some((6, 6)));
        assert!(levels(8) < levels(20));
    }
}

/// Too little of any part is told.
#[test]
fn memory_that_is_too_small_is_refused() {
    let sensor = Sensor::new(40, 30).unwrap();
    for effort in Effort::ALL {
        let sizes = Sizes::new(sensor, effort, 100, true);
        let mut memory = Memory::new(sizes);
        assert!(Tree::new(sensor, effort, 100, true, &mut memory.lent()).is_some());
        assert!(Tree::new(sensor, effort, 101, true, &mut memory.lent()).is_none());
        let words = memory.words.len();
        memory.words.truncate(words - 1);
        assert!(Tree::new(sensor, effort, 100, true, &mut memory.lent()).is_none());
    }
}

/// Events on the scans cost less than those beside them, and what a clock shows follows the scans.
#[test]
fn times_on_scans_are_cheap() {
    let sensor = Sensor::new(64, 48).unwrap();
    let scans = scans_of(sensor, 50_000, (true, 197 << 16, -30_000, 0)).unwrap();
    let times = Times::Scans(scans);
    let bytes = |beside: u32| {
        let mut events: Vec<_> = (0..3000_u32)
            .map(|i| {
                let mixed = i.wrapping_mul(0x9E37_79B9);
                let place = ((mixed >> 8 & 63) as u16, (mixed >> 16) as u16 % 48);
                let fine = 128 + if beside > 0 { mixed >> 5 & beside } else { 0 };
                TreeEvent::at(
                    place,
                    ((mixed % scans.count()) << 8) | fine,
                    mixed >> 31 == 1,
                )
            })
            .collect();
        sort(&mut events);
        let sizes = Sizes::new(sensor, Effort::One, events.len(), true);
        let mut memory = Memory::new(sizes);
        let mut lent = memory.lent();
        let mut tree = Tree::new(sensor, Effort::One, events.len(), true, &mut lent).unwrap();
        tree.restart();
        let shape = Shape::of_window(times, Effort::One, 3000, 1500).unwrap();
        let mut out = vec![0; 24_000];
        tree.encode(shape, 7, &mut events, &mut out).unwrap()
    };
    let (on, beside) = (bytes(0), bytes(1));
    // A bit an event.
    assert!((350..400).contains(&(beside - on)), "{on} {beside}");
    let shape = Shape::of_window(times, Effort::One, 3000, 1500).unwrap();
    let clock = Clock::new(shape, 1000);
    assert_eq!(clock.at(2 << 8 | 130), 1000 + 2 * 197 + scans.line0_us(0));
    // 197 us are a scan, but for the rounding.
    assert_eq!(clock.units(197), 255);
    assert_eq!(clock.units(u32::MAX), 1 << 30);
}
