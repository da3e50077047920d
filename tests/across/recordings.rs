//! Every shared recording through the whole codec, window by window against the f64 oracle.
//!
//! Skipped, with a notice, where the shared recordings are absent.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use eecvs::calibrate::Calibration;
use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, all_cores, encode};
use eecvs::frame_file::FrameReader;
use eecvs::reconstruct::{DecodedWindow, Pixel};
use eecvs_nostd::{Config, Mode, Thresholds, Transform, WindowConfig};
use eecvs_oracle::window::{HOST_CAPACITY, Window, Windower};
use eecvs_oracle::{density, prune, regime, transform as oracle};

const WINDOW_US: u32 = 32_768;
const MS: [u8; 3] = [8, 16, 24];

fn recording(path: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../shared/data")
        .join(path);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: {} is absent", path.display());
    None
}

fn frames(path: &Path, transform: Option<Transform>, m: u8, thresholds: Thresholds) -> Vec<u8> {
    let mut reader = event_files::open(path, None).expect("a recording");
    let config = Config {
        transform,
        m,
        ..Config::new(
            WindowConfig::new(reader.sensor(), WINDOW_US),
            thresholds,
            Mode::Transform,
        )
    };
    let mut bytes = Vec::new();
    let summary = encode(
        reader.as_mut(),
        config,
        Limits::default(),
        all_cores(),
        &mut bytes,
        &mut |_| (),
    )
    .expect("encoding works");
    assert_eq!(
        summary.events_in,
        summary.events_encoded
            + summary.events_late
            + summary.events_filtered
            + summary.events_dropped
    );
    bytes
}

fn oracle_windows(path: &Path) -> Vec<Window> {
    let mut reader = event_files::open(path, None).expect("a recording");
    let mut windower = Windower::new(NonZeroU32::new(WINDOW_US).expect("not 0"), HOST_CAPACITY);
    let mut windows = Vec::new();
    let mut events = Vec::new();
    while reader.read(&mut events).expect("a recording") > 0 {
        windows.extend(events.drain(..).filter_map(|event| windower.push(event)));
    }
    windows.extend(windower.flush());
    windows
}

fn decoded_windows(bytes: &[u8], mut each: impl FnMut(usize, DecodedWindow)) {
    let mut reader = WindowReader::new(FrameReader::new(bytes));
    let mut count = 0;
    while let Some(window) = reader.next_window().expect("memory does not fail") {
        each(count, window);
        count += 1;
    }
    assert!(reader.report().is_clean(), "{:?}", reader.report());
}

/// A pixel against the oracle's coefficients of the whole grid.
fn check_pixel(pixel: &Pixel, expected: &[num_complex::Complex64], window: &DecodedWindow) {
    let header = &window.header;
    let kind = oracle_kind(header.transform);
    let slack = f64::from(pixel.on + pixel.off) / 16_384.0;
    let half_step = f64::from(header.quantiser.step_log2()).exp2() / 2.0;
    let tolerance = half_step + slack + 1e-9;
    let kept = prune::kept(kind, expected, usize::from(header.m));
    let least = kept
        .iter()
        .map(|k| expected[*k].norm())
        .fold(f64::INFINITY, f64::min);
    let place = || format!("{} us, pixel {} {}", header.t0_us, pixel.x, pixel.y);
    let mut sent = BTreeMap::new();
    for (k, re, im) in &pixel.coefficients {
        let expected = expected[usize::from(*k)];
        assert!(
            (re - expected.re).abs() <= tolerance,
            "{}: re of c_{k}",
            place()
        );
        assert!(
            (im - expected.im).abs() <= tolerance,
            "{}: im of c_{k}",
            place()
        );
        // Another coefficient than the oracle's only where the magnitudes are within the bound.
        assert!(
            kept.contains(&usize::from(*k)) || least - expected.norm() <= slack,
            "{}: c_{k} is not among the largest",
            place()
        );
        sent.insert(usize::from(*k), ());
    }
    for k in kept {
        let c = expected[k];
        let rounds_to_zero = c.re.abs() <= tolerance && c.im.abs() <= tolerance;
        assert!(
            sent.contains_key(&k) || rounds_to_zero || c.norm() - least <= slack,
            "{}: c_{k} is missing",
            place()
        );
    }
}

const fn oracle_kind(transform: Transform) -> oracle::Transform {
    match transform {
        Transform::Dct => oracle::Transform::Dct,
        Transform::Dtft => oracle::Transform::Dtft,
        Transform::Dwt => oracle::Transform::Dwt,
    }
}

fn check_coefficients(path: &Path, windows: &[Window]) {
    let thresholds = Thresholds::new(0, 0).expect("in order");
    for (i, transform) in Transform::ALL.into_iter().enumerate() {
        for (j, m) in MS.into_iter().enumerate() {
            let bytes = frames(path, Some(transform), m, thresholds);
            let mut count = 0;
            decoded_windows(&bytes, |index, window| {
                count += 1;
                // The oracle is slow: each window is compared with one M of each transform, and every M is.
                if (index + i + j) % MS.len() != 0 {
                    return;
                }
                let expected = eecvs_oracle::coefficients(
                    &windows[index],
                    oracle_kind(transform),
                    usize::from(window.header.grid),
                );
                assert_eq!(window.pixels.len(), expected.len());
                for (pixel, ((y, x), expected)) in window.pixels.iter().zip(&expected) {
                    assert_eq!((pixel.y, pixel.x), (*y, *x));
                    check_pixel(pixel, expected, &window);
                }
            });
            assert_eq!(count, windows.len());
        }
    }
}

/// `--transform auto` under the recording's own thresholds and under those of the scenes.
fn check_regimes(path: &Path, windows: &[Window]) {
    let mut calibration = Calibration::new(NonZeroU32::new(WINDOW_US).expect("not 0"));
    let mut reader = event_files::open(path, None).expect("a recording");
    let sensor = reader.sensor();
    calibration
        .add(reader.as_mut(), &mut |_| ())
        .expect("a recording");
    let own = calibration.thresholds().expect("events");
    let own = Thresholds::new(own.tau_low_pico, own.tau_high_pico).expect("in order");
    let scenes = eecvs::thresholds_file::ThresholdsFile::scenes()
        .and_then(|file| file.thresholds())
        .expect("the thresholds that come with the program");
    for thresholds in [own, scenes] {
        let low = thresholds.tau_low_pico() as f64 * 1e-12;
        let high = thresholds.tau_high_pico() as f64 * 1e-12;
        let bytes = frames(path, None, 8, thresholds);
        decoded_windows(&bytes, |index, window| {
            let rho = density::window_density(&windows[index], sensor);
            let expected = regime::Regime::of(rho, low, high).transform();
            assert_eq!(
                oracle_kind(window.header.transform),
                expected,
                "window {index}, {rho}"
            );
        });
    }
}

macro_rules! recordings {
    ($($name:ident: $path:literal,)*) => {$(
        #[test]
        fn $name() {
            if let Some(path) = recording($path) {
                let windows = oracle_windows(&path);
                check_regimes(&path, &windows);
                check_coefficients(&path, &windows);
            }
        }
    )*};
}

recordings! {
    davis346_static_sparse: "davis346_static_sparse/davis346.aedat4",
    davis346_building_dense: "davis346_building_dense/davis.aedat4",
    gen3_vga_dense_evt2: "gen3_vga_dense_evt2/evt2.raw",
    imx636_sparse_evt3: "imx636_sparse_evt3/evt3.raw",
    dvxl_person_moderate: "dvxl_person_moderate/data_sample.aedat4",
    davis240_boxes_moderate: "davis240_boxes_moderate/IMU_translBoxes.aedat",
    dvs128_walking_moderate: "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    dvs128_walking_sparse: "dvs128_walking_sparse/neal_walking.aedat",
    dvs128_standup: "dvs128_standup/cam255_alex_standing_up2.aedat",
    es_csv_1ms_grid: "es_csv_1ms_grid/dvs.csv",
    derived_text: "derived_layouts/davis346_building_txyp.txt",
    derived_npz: "derived_layouts/davis346_building_xytp.npz",
}
