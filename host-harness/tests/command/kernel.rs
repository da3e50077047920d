//! `encode --kernel`: the file of every kernel against the default's and against the f64 reference.

use std::num::NonZeroU32;

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::{DecodedWindow, Pixel};
use eecvs_nostd::fixed_point::CHUNK_EVENTS;
use eecvs_nostd::{Event, Kernel, Polarity, Transform};
use eecvs_oracle::window::{HOST_CAPACITY, Window, windows};
use eecvs_oracle::{coefficients, transform};

use crate::support::Folder;

/// Large enough for pixels of several chunks.
const WINDOW_US: NonZeroU32 = NonZeroU32::new(100_000).unwrap();
const KERNELS: [Kernel; 5] = [
    Kernel::Table,
    Kernel::Recurrence,
    Kernel::Precise,
    Kernel::Micromath,
    Kernel::Libm,
];
/// Transforms and grids: with and without pruning, with the walk of the few, and one whose kernel has
/// thousands of sums.
const SETTINGS: [&str; 5] = [
    "--transform dct -m 8",
    "--transform dct -m 16 --step-log2 -15",
    "--transform dtft -m 16 --grid 16 --step-log2 -15",
    "--transform dtft -m 8",
    "--transform dtft -m 64 --grid 200 --step-log2 -10",
];

/// A scene, and in its first row pixels whose events are all at u = 0, where every coefficient is as
/// large as it gets.
fn recording(folder: &Folder) -> Vec<Event> {
    folder.scene("scene.raw");
    let (sensor, mut events) = folder.events("scene.raw");
    events.retain(|event| event.y > 0);
    let t_us = events[0].t_us;
    let mut at_start = Vec::new();
    for (x, count) in [1, 2, 3, 4, 63, 64, 128, 129].into_iter().enumerate() {
        let polarity = [Polarity::On, Polarity::Off][x % 2];
        let (x, y) = (x as u16, 0);
        let event = Event {
            t_us,
            x,
            y,
            polarity,
        };
        at_start.extend(vec![event; count]);
    }
    events.splice(..0, at_start);
    let mut writer = event_files::create(&folder.path("in.csv"), sensor).unwrap();
    writer.write(&events).unwrap();
    writer.finish().unwrap();
    events
}

/// Encodes with a kernel, as the default where there is none, and decodes.
fn decoded(folder: &Folder, setting: &str, kernel: Option<Kernel>) -> Vec<DecodedWindow> {
    let flag = kernel.map_or(String::new(), |kernel| {
        format!("--kernel {}", kernel.name())
    });
    let line = format!(
        "encode in.csv -o a.eecvs --mode transform --window-us {WINDOW_US} {setting} {flag}"
    );
    folder.eecvs(&line).ok();
    let mut reader = WindowReader::new(FrameReader::new(
        std::fs::File::open(folder.path("a.eecvs")).unwrap(),
    ));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().unwrap() {
        windows.push(window);
    }
    assert!(reader.report().is_clean());
    windows
}

fn error_per_event(kernel: Kernel) -> f64 {
    kernel
        .error_log2()
        .map_or(0.0, |log2| f64::from(log2).exp2())
}

/// Error of a number of a pixel of n events: the kernel's, and what the sums of each chunk round.
fn bound(kernel: Kernel, n: u32) -> f64 {
    let chunks = n.div_ceil(CHUNK_EVENTS as u32);
    f64::from(n) * error_per_event(kernel) + f64::from(chunks) * (-25_f64).exp2()
}

/// What is sent beside the coefficients is that of the default; the coefficients that both have are
/// within both kernels' errors of each other, and a step.
fn check_against_default(window: &DecodedWindow, default: &DecodedWindow, kernel: Kernel) {
    assert_eq!(window.header.packing(), default.header.packing());
    assert_eq!(window.pixels.len(), default.pixels.len());
    let step = f64::from(window.header.quantiser.step_log2()).exp2();
    for (pixel, default) in window.pixels.iter().zip(&default.pixels) {
        let place = |pixel: &Pixel| (pixel.x, pixel.y, pixel.on, pixel.off, pixel.times.clone());
        assert_eq!(place(pixel), place(default));
        assert_eq!(pixel.coefficients.len(), default.coefficients.len());
        let n = pixel.on + pixel.off;
        if n == 1 {
            assert_eq!(pixel, default, "a single event is its cell");
            continue;
        }
        let most = bound(kernel, n) + bound(Kernel::Table, n) + step;
        for (k, re, im) in &pixel.coefficients {
            let mut same = default.coefficients.iter().filter(|c| c.0 == *k);
            if let Some((_, default_re, default_im)) = same.next() {
                assert!((re - default_re).abs() <= most, "{kernel:?} c_{k} of {n}");
                assert!((im - default_im).abs() <= most, "{kernel:?} c_{k} of {n}");
            }
        }
    }
}

/// Every coefficient within the kernel's error and half a step.
fn check_against_reference(decoded: &DecodedWindow, window: &Window, kernel: Kernel) {
    let header = &decoded.header;
    let oracle = match header.transform {
        Transform::Dct => transform::Transform::Dct,
        Transform::Dtft => transform::Transform::Dtft,
        Transform::Dwt => transform::Transform::Dwt,
    };
    let expected = coefficients(window, oracle, header.grid.into());
    let half_step = f64::from(header.quantiser.step_log2()).exp2() / 2.0;
    for pixel in &decoded.pixels {
        let n = pixel.on + pixel.off;
        let most = half_step + bound(kernel, n);
        for (k, re, im) in &pixel.coefficients {
            let c = expected[&(pixel.y, pixel.x)][usize::from(*k)];
            let error = (re - c.re).abs().max((im - c.im).abs());
            assert!(error <= most, "{kernel:?} c_{k} of {n}: {error} > {most}");
        }
    }
}

#[test]
fn coefficients_are_within_each_kernels_error() {
    let folder = Folder::new();
    let events = recording(&folder);
    let cut = windows(&events, WINDOW_US, HOST_CAPACITY);
    for setting in SETTINGS {
        let default = decoded(&folder, setting, None);
        let bytes = folder.bytes("a.eecvs");
        assert_eq!(default.len(), cut.len());
        let crowded = default.iter().flat_map(|window| &window.pixels);
        let crowded = crowded.filter(|pixel| (pixel.on + pixel.off) as usize > CHUNK_EVENTS);
        assert!(crowded.count() > 3, "some pixels have several chunks");
        for kernel in KERNELS {
            let found = decoded(&folder, setting, Some(kernel));
            let is_same = folder.bytes("a.eecvs") == bytes;
            assert_eq!(is_same, kernel == Kernel::Table, "{kernel:?} {setting}");
            for ((window, default), cut) in found.iter().zip(&default).zip(&cut) {
                check_against_default(window, default, kernel);
                check_against_reference(window, cut, kernel);
            }
        }
    }
}

#[test]
fn the_haar_transform_has_one_kernel() {
    let folder = Folder::new();
    recording(&folder);
    for setting in ["-m 8", "-m 64 --grid 512 --step-log2 2"] {
        let encode = format!("encode in.csv -o a.eecvs --mode transform --transform dwt {setting}");
        folder.eecvs(&encode).ok();
        let bytes = folder.bytes("a.eecvs");
        for kernel in KERNELS.map(Kernel::name) {
            folder.eecvs(&format!("{encode} --kernel {kernel}")).ok();
            assert!(folder.bytes("a.eecvs") == bytes, "{kernel}");
        }
    }
}

#[test]
fn threads_and_small_frames_change_no_kernels_coefficients() {
    let folder = Folder::new();
    recording(&folder);
    let encode = "encode in.csv --kernel precise --window-us 20000";
    for (name, flags) in [
        ("one", "--threads 1"),
        ("three", "--threads 3"),
        ("many", "--threads 3 --frame-bytes 1208"),
    ] {
        folder
            .eecvs(&format!("{encode} -o {name}.eecvs {flags}"))
            .ok();
        folder
            .eecvs(&format!("decode {name}.eecvs -o {name}.csv"))
            .ok();
    }
    assert!(folder.bytes("one.eecvs") == folder.bytes("three.eecvs"));
    assert!(folder.bytes("one.eecvs") != folder.bytes("many.eecvs"));
    assert!(folder.bytes("one.csv") == folder.bytes("many.csv"));
    let help = folder.eecvs("encode --help").ok().stdout;
    for kernel in KERNELS.map(Kernel::name) {
        assert!(help.contains(&format!("- {kernel}:")), "{help}");
    }
}
