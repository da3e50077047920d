//! `decode --volume`, with and without `--bins`, against the f64 reference and against sums over events.

use std::num::{NonZeroU32, NonZeroUsize};

use eecvs_oracle::reconstruct::bins;
use eecvs_oracle::transform::Transform;
use eecvs_oracle::window::{HOST_CAPACITY, Window, windows};
use eecvs_oracle::{coefficients, impulses};
use num_complex::Complex64;

use crate::support::{Folder, count, number, text};

const WINDOW_US: NonZeroU32 = NonZeroU32::new(32_768).unwrap();

fn by_name(name: &str) -> Transform {
    match name {
        "dct" => Transform::Dct,
        "dtft" => Transform::Dtft,
        "dwt" => Transform::Dwt,
        other => panic!("{other} is no transform"),
    }
}

/// Coefficients of each pixel (y, x) as a volume in basis order has them.
struct Volume {
    transform: Transform,
    shape: [usize; 3],
    values: Vec<f32>,
}

impl Volume {
    fn read(folder: &Folder, name: &str, transform: Transform) -> Self {
        let (shape, values) = folder.npy(name);
        Self {
            transform,
            shape,
            values,
        }
    }

    fn pixel(&self, y: usize, x: usize) -> Vec<Complex64> {
        let [channels, height, width] = self.shape;
        let at = |c: usize| f64::from(self.values[(c * height + y) * width + x]);
        if self.transform == Transform::Dtft {
            (0..channels / 2)
                .map(|k| Complex64::new(at(2 * k), at(2 * k + 1)))
                .collect()
        } else {
            (0..channels).map(|k| Complex64::from(at(k))).collect()
        }
    }
}

/// Compares every pixel of a volume with the reference: kept coefficients within
/// n 2^-14 + step / 2, the others 0; the kept ones are the r largest (DCT: the first r), where the
/// bound leaves no doubt which these are. c_0 is the counts', kept or not.
fn check_volume(volume: &Volume, window: &Window, m: usize, grid: usize, step: f64) {
    let transform = volume.transform;
    let [channels, height, width] = volume.shape;
    let parts = if transform == Transform::Dtft { 2 } else { 1 };
    assert_eq!(channels, parts * grid);
    let reference = coefficients(window, transform, grid);
    let counts = impulses(window);
    let r = m.min(grid);
    for y in 0..height {
        for x in 0..width {
            let values = volume.pixel(y, x);
            let key = (y as u16, x as u16);
            let Some(c) = reference.get(&key) else {
                assert!(values.iter().all(|v| *v == Complex64::ZERO), "{key:?}");
                continue;
            };
            let n = counts[&key].len() as f64;
            let kernel = n * 0.5_f64.powi(14);
            let mut magnitudes: Vec<f64> = c.iter().map(|c| c.norm()).collect();
            magnitudes.sort_by(|a, b| b.total_cmp(a));
            let least_kept = magnitudes[r - 1];
            assert!(
                (values[0].re - c[0].re).abs() < 1e-9 && values[0].im == 0.0,
                "{key:?}"
            );
            let others = values[1..].iter();
            assert!(others.filter(|v| **v != Complex64::ZERO).count() <= r);
            for (k, (value, c)) in values.iter().zip(c).enumerate().skip(1) {
                let (kept, pruned) = match transform {
                    Transform::Dct => (k < r, k >= r),
                    _ => (
                        c.norm() > least_kept + 4.0 * kernel,
                        c.norm() < least_kept - 4.0 * kernel,
                    ),
                };
                // Volumes are float32.
                let bound = kernel + step / 2.0 + c.norm() * f64::from(f32::EPSILON);
                let close = (value.re - c.re).abs() <= bound && (value.im - c.im).abs() <= bound;
                let zero = *value == Complex64::ZERO;
                let right = match (kept, pruned) {
                    (true, _) => close,
                    (_, true) => zero,
                    _ => close || zero,
                };
                assert!(
                    right,
                    "{transform:?} {key:?} k = {k}: {value} for {c}, n = {n}"
                );
            }
            // One event is as strong at every frequency: the tie goes to the lower k.
            if n == 1.0 && transform == Transform::Dtft {
                assert!(values[r..].iter().all(|v| *v == Complex64::ZERO), "{key:?}");
            }
        }
    }
}

#[test]
fn volumes_and_bins_equal_the_reference() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, events) = folder.events("scene.raw");
    let windows = windows(&events, WINDOW_US, HOST_CAPACITY);
    for (flags, m) in [
        ("", 16),
        ("--transform dct -m 8", 8),
        ("--transform dtft -m 8", 8),
        ("--transform dwt -m 8", 8),
        ("--transform dwt -m 24", 24),
        ("--transform dtft -m 24 --step-log2 -15", 24),
        ("--transform dct -m 8 --grid 20 --step-log2 0", 8),
        ("--transform dtft -m 9 --grid 9", 9),
        ("--transform dwt -m 3 --grid 33 --step-log2 -1", 3),
        ("--transform dct -m 64 --grid 5", 64),
        ("-m 1", 1),
    ] {
        folder
            .eecvs(&format!(
                "encode scene.raw -o a.eecvs --mode transform {flags}"
            ))
            .ok();
        let rows = folder.eecvs("inspect a.eecvs --json").ok().array();
        assert_eq!(rows.len(), windows.len());
        // The busiest and the last window: with `auto`, two transforms.
        for index in [4, windows.len() - 1] {
            let (row, window) = (&rows[index], &windows[index]);
            let transform = by_name(text(row, "transform"));
            let (grid, step) = (count(row, "grid") as usize, number(row, "step"));
            assert_eq!(count(row, "m") as usize, m);
            let line = format!("decode a.eecvs --volume v.npy --window {index}");
            folder.eecvs(&line).ok();
            let volume = Volume::read(&folder, "v.npy", transform);
            let size = [usize::from(sensor.height), usize::from(sensor.width)];
            assert_eq!(volume.shape[1..], size);
            check_volume(&volume, window, m, grid, step);

            let count = [1, 5, 32][index % 3];
            let line = format!("decode a.eecvs --volume b.npy --window {index} --bins {count}");
            folder.eecvs(&line).ok();
            let (shape, values) = folder.npy("b.npy");
            assert_eq!(shape, [count, size[0], size[1]]);
            for y in 0..size[0] {
                for x in 0..size[1] {
                    let expected = bins(transform, &volume.pixel(y, x), count);
                    for (b, expected) in expected.iter().enumerate() {
                        let value = f64::from(values[(b * size[0] + y) * size[1] + x]);
                        assert!(
                            (value - expected).abs() < 1e-4,
                            "{flags}: bin {b} of ({y}, {x}): {value} for {expected}"
                        );
                    }
                }
            }
        }
    }
    // Events and a volume in one go; a window that is not there.
    folder.eecvs("decode a.eecvs -o b.csv --volume w.npy").ok();
    assert_eq!(folder.pixels("b.csv"), folder.pixels("scene.raw"));
    assert_eq!(folder.npy("w.npy").0[0], 1);
    let missing = windows.len();
    folder
        .eecvs(&format!("decode a.eecvs --volume x.npy --window {missing}"))
        .fails(&[
            "a.eecvs",
            &format!("no window {missing}"),
            &format!("has {missing}"),
        ]);
}

#[test]
fn a_window_closed_early_has_its_own_volume() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform --window-events 700 --transform dtft -m 12")
        .ok();
    let events = folder.events("scene.raw").1;
    let windows = windows(&events, WINDOW_US, NonZeroUsize::new(700).unwrap());
    let early = windows.iter().position(|w| w.duration_us < WINDOW_US.get());
    let index = early.expect("a window closed early");
    folder
        .eecvs(&format!("decode a.eecvs --volume v.npy --window {index}"))
        .ok();
    let volume = Volume::read(&folder, "v.npy", Transform::Dtft);
    check_volume(&volume, &windows[index], 12, 24, 1.0 / 64.0);
}

/// Sums of polarities by bin and pixel, of every window: T x B x H x W.
fn sums(windows: &[Window], bins: usize, [height, width]: [usize; 2]) -> Vec<f32> {
    let mut values = vec![0.0; windows.len() * bins * height * width];
    for (window, values) in windows.iter().zip(values.chunks_mut(bins * height * width)) {
        for ((y, x), impulses) in impulses(window) {
            for impulse in impulses {
                let bin =
                    u64::from(impulse.offset_us) * bins as u64 / u64::from(window.duration_us);
                values[(bin as usize * height + usize::from(y)) * width + usize::from(x)] +=
                    impulse.p as f32;
            }
        }
    }
    values
}

#[test]
fn bins_of_events_are_their_exact_sums_whatever_m_is() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    let (sensor, events) = folder.events("scene.raw");
    let sides = [usize::from(sensor.height), usize::from(sensor.width)];
    let windows = windows(&events, WINDOW_US, HOST_CAPACITY);
    for (encode, counts) in [
        ("-m 1 --transform dtft", &[1, 5, 9, 16][..]),
        ("-m 2 --transform dwt --coder dense", &[5, 4096]),
        ("--bins 1", &[1]),
        ("--bins 5 --coder dense", &[5]),
        ("--bins 9", &[9]),
        ("--bins 16 --coder dense", &[16]),
    ] {
        folder
            .eecvs(&format!("encode scene.raw -o a.eecvs {encode}"))
            .ok();
        for count in counts {
            let decode = format!("decode a.eecvs --volume v.npy --all-windows --bins {count}");
            folder.eecvs(&decode).ok();
            let wanted = sums(&windows, *count, sides);
            let bytes = folder.bytes("v.npy");
            let found = bytes[bytes.len() - 4 * wanted.len()..].as_chunks().0;
            let found: Vec<f32> = found
                .iter()
                .map(|bytes| f32::from_le_bytes(*bytes))
                .collect();
            assert!(found == wanted, "{encode}: {count} bins");
            let header = String::from_utf8_lossy(&bytes[..128]).into_owned();
            let shape = format!("({}, {count}, {}, {})", windows.len(), sides[0], sides[1]);
            assert!(header.contains(&shape), "{header}");
            // Starts and durations.
            let times = folder.bytes("v.times.npy");
            let times = times[times.len() - 16 * windows.len()..].as_chunks().0;
            let times: Vec<i64> = times
                .iter()
                .map(|bytes| i64::from_le_bytes(*bytes))
                .collect();
            let rows = windows.iter();
            let rows = rows.flat_map(|window| [window.t0_us as i64, window.duration_us.into()]);
            assert_eq!(times, rows.collect::<Vec<_>>());
        }
    }
}

#[test]
fn volumes_that_cannot_be_made_are_refused() {
    let folder = Folder::new();
    folder.scene("scene.raw");
    folder
        .eecvs("encode scene.raw -o a.eecvs --mode transform")
        .ok();
    for (flags, parts) in [
        (
            "--volume v.npy --bins 4 --polarity split",
            &["ON minus OFF"][..],
        ),
        (
            "--volume v.npy --all-windows",
            &["different transforms", "--bins"],
        ),
        ("--volume v.txt", &["v.txt", ".npy"]),
        ("-o b.csv --bins 4", &["--volume"]),
        ("-o b.csv --normalise mean-std", &["--volume"]),
    ] {
        folder
            .eecvs(&format!("decode a.eecvs {flags}"))
            .fails(parts);
        assert!(
            !folder.path("v.npy").exists() && !folder.path("b.csv").exists(),
            "{flags}"
        );
    }
    for usage in [
        "--volume v.npy --voxel bilinear",
        "--volume v.npy --window 1 --all-windows",
        "--all-windows",
    ] {
        let outcome = folder.eecvs(&format!("decode a.eecvs {usage}"));
        assert_eq!(outcome.status, Some(2), "{outcome}");
    }
    // Times that are solved for have polarities.
    let line =
        "decode a.eecvs --volume v.npz --all-windows --bins 4 --voxel bilinear --polarity split";
    folder.eecvs(line).ok();
}
