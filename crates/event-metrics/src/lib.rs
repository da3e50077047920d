//! Distortion metrics between two event recordings, A (the reference) and B.
//!
//! All metrics are computed window by window on A's grid (see [`windows`]). The frame of a window holds, for each
//! pixel, the signed sum of the polarities, divided by the largest |sum| found in either recording.
//!
//! | key | value |
//! |---|---|
//! | `events_a`, `events_b` | events read, including late events |
//! | `exact_fraction` | events of A found in B with the same t, x, y, p (multiset) / events of A |
//! | `exact_fraction_b` | the same count / events of B: lowered by events that only B has |
//! | `missing_events` | events of A that B does not have |
//! | `surplus_events`, `surplus_fraction` | events of B that A does not have; the same / events of B |
//! | `mse` | mean of (a - b)^2 over pixels and windows |
//! | `ssim` | mean structural similarity over windows |
//! | `emd_time_ms` | mean W1 distance of the event times, over the windows that hold events |
//! | `emd_pixel_us` | cost of the least-cost matching per pixel and polarity ([`emd_pixel`]), per event of A |
//!
//! `mse` and `ssim` average over every window between A's first and A's last, empty windows (mse 0, ssim 1)
//! included, and over the windows outside that span in which B holds events. Where B lies elsewhere in time, the
//! empty time between A and B is not counted: it would hide that nothing agrees.
//!
//! If the times of a recording run backwards by more than windows stay open (see [`windows`]), for example because
//! its clock restarts, both recordings are sorted by time first. A window then holds the events of every run of
//! the clock that fall into it.
//!
//! Recordings from sensors of different sizes are refused. This does not apply where a file states no size and its
//! reader inferred one from the largest x and y: frames then take the larger width and height of the two.

pub mod clock;
pub mod denoising;
pub mod emd_pixel;
pub mod emd_time;
pub mod exact_fraction;
pub mod frame;
pub mod mse;
pub mod ssim;
pub mod windows;

use event_files::sort::Sorted;
use event_types::stream::{Context, EventReader, Result, SIZE_TAKEN};
use event_types::{Sensor, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use emd_pixel::Matcher;
use frame::{PeakFinder, frame_pair, pixel_order};
use ssim::Ssim;
use windows::{Grid, Pairs, WindowPair, Windower, first_time_us};

/// Opens a recording at its start; [`compare`] calls it more than once.
pub type Open<'a> = &'a dyn Fn() -> Result<Box<dyn EventReader>>;

/// Result of [`compare`]; the field names are the keys of the JSON object. All numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Number of events of A.
    pub events_a: u64,
    /// Number of events of B.
    pub events_b: u64,
    /// Share of A's events that B holds, 0 to 1; 1 if A is empty.
    pub exact_fraction: f64,
    /// Share of B's events that A holds, 0 to 1; 1 if B is empty.
    #[serde(default)]
    pub exact_fraction_b: f64,
    /// Number of A's events that B does not hold.
    #[serde(default)]
    pub missing_events: u64,
    /// Number of B's events that A does not hold, repeated ones included.
    #[serde(default)]
    pub surplus_events: u64,
    /// Share of B's events that A does not hold, 0 to 1; 0 if B is empty.
    #[serde(default)]
    pub surplus_fraction: f64,
    /// Mean squared error of the frames, 0 to 4.
    pub mse: f64,
    /// Structural similarity of the frames, -1 to 1.
    pub ssim: f64,
    /// Mean Wasserstein-1 distance of the event times, in ms.
    pub emd_time_ms: f64,
    /// Cost of the matching per event of A, in us.
    pub emd_pixel_us: f64,
}

/// Compares two recordings in windows of `window_us`.
///
/// Each recording is read twice: first to find the largest |sum| of the frames, then to compute the metrics. Memory
/// holds, for each recording, the current window, the windows that its disorder keeps open (two if the window is
/// [`windows::DISORDER_US`] or longer) and one frame.
/// `progress` is called with the number of events read so far, over both recordings and passes.
///
/// An empty B gives finite numbers: no event matches, and every event of A costs `window_us`.
///
/// # Errors
/// An error of a reader; sensors of different sizes; a `window_us` of 0; an A without events where B has some,
/// because every metric is relative to A.
pub fn compare(
    open_a: Open<'_>,
    open_b: Open<'_>,
    window_us: u64,
    progress: &mut dyn FnMut(u64),
) -> Result<Comparison> {
    let in_a = || open_a().context("recording A");
    let in_b = || open_b().context("recording B");
    let (mut start_a, mut start_b) = (in_a()?, in_b()?);
    let sensor = common_sensor(&*start_a, &*start_b)?;
    let first_a = first_time_us(&mut *start_a).context("recording A")?;
    let first_b = first_time_us(&mut *start_b).context("recording B")?;
    ensure!(
        first_a.is_some() || first_b.is_none(),
        Refused,
        "recording A holds no events, and the metrics are per event of A; swap A and B"
    );
    let grid = Grid::new(first_a.unwrap_or(0), window_us)?;
    drop((start_a, start_b));

    let mut peak = PeakFinder::new(sensor);
    let mut span_a = None;
    let mut events_before = 0;
    for is_a in [true, false] {
        let reader = if is_a { in_a()? } else { in_b()? };
        let mut stream = Windower::new(reader, grid, sensor);
        let name = if is_a { "recording A" } else { "recording B" };
        while let Some(window) = stream.next_window().context(name)? {
            peak.add_window(&window.events);
            if is_a {
                let (first, _) = span_a.unwrap_or((window.index, window.index));
                span_a = Some((first, window.index));
            }
            progress(events_before + stream.events_read());
        }
        events_before += stream.events_read();
        if stream.late() > 0 {
            return compare_sorted(open_a, open_b, window_us, progress);
        }
    }
    let peak = peak.peak();

    let mut pairs = Pairs::new(
        Windower::new(in_a()?, grid, sensor),
        Windower::new(in_b()?, grid, sensor),
    );
    let ssim = Ssim::new(sensor, peak);
    let mut matcher = Matcher::new(window_us);
    let mut sums = Sums::default();
    while let Some(mut pair) = pairs.next_pair()? {
        let outside = span_a.is_none_or(|(first, last)| !(first..=last).contains(&pair.index));
        sums.windows_outside_a += u64::from(outside);
        sums.add(&mut pair, window_us, &ssim, &mut matcher);
        progress(events_before + pairs.a().events_read() + pairs.b().events_read());
    }
    let windows_of_a = span_a.map_or(0, |(first, last)| last.abs_diff(first) + 1);
    let frames = Frames {
        windows: windows_of_a as f64 + sums.windows_outside_a as f64,
        pixels: f64::from(sensor.pixels()),
        peak: peak as f64,
    };
    Ok(sums.comparison(&frames, pairs.a(), pairs.b(), matcher.cost()))
}

/// Returns a sensor size that covers both recordings, or refuses two stated sizes that differ.
fn common_sensor(a: &dyn EventReader, b: &dyn EventReader) -> Result<Sensor> {
    let (of_a, of_b) = (a.sensor(), b.sensor());
    let is_stated = |reader: &dyn EventReader| {
        let mut assumptions = reader.assumptions().iter();
        assumptions.all(|assumption| assumption.what != SIZE_TAKEN)
    };
    ensure!(
        of_a == of_b || !is_stated(a) || !is_stated(b),
        Refused,
        "the recordings are of different sensors, {}x{} and {}x{}, and cannot be compared",
        of_a.width,
        of_a.height,
        of_b.width,
        of_b.height
    );
    Ok(Sensor {
        width: of_a.width.max(of_b.width),
        height: of_a.height.max(of_b.height),
    })
}

/// [`compare`] for recordings whose clocks restart or run backwards by more than windows stay open: sorts the
/// events by time, so that each falls into its window, whichever run of the clock it comes from.
fn compare_sorted(
    open_a: Open<'_>,
    open_b: Open<'_>,
    window_us: u64,
    progress: &mut dyn FnMut(u64),
) -> Result<Comparison> {
    let sorted = |open: Open<'_>| -> Result<Box<dyn EventReader>> {
        Ok(Box::new(Sorted::new(open()?, &mut |_| {})?))
    };
    compare(&|| sorted(open_a), &|| sorted(open_b), window_us, progress)
}

/// Numbers that normalise the frame metrics.
struct Frames {
    windows: f64,
    pixels: f64,
    peak: f64,
}

/// Sums of the metrics over the windows so far, before division.
#[derive(Default)]
struct Sums {
    windows_with_events: u64,
    windows_outside_a: u64,
    matched: u64,
    squared_error: u128,
    dissimilarity: f64,
    emd_time_us: f64,
}

impl Sums {
    fn add(&mut self, pair: &mut WindowPair, window_us: u64, ssim: &Ssim, matcher: &mut Matcher) {
        self.windows_with_events += 1;
        pair.a.par_sort_unstable_by_key(pixel_order);
        pair.b.par_sort_unstable_by_key(pixel_order);
        let (a, b) = (&*pair.a, &*pair.b);
        let pixels = frame_pair(a, b);
        self.squared_error += mse::squared_error(&pixels);
        self.matched += exact_fraction::matched(a, b);
        let (dissimilarity, emd_time_us) = rayon::join(
            || ssim.dissimilarity(&pixels),
            || {
                let mut times_a: Vec<u64> = a.iter().map(|e| e.t_us).collect();
                let mut times_b: Vec<u64> = b.iter().map(|e| e.t_us).collect();
                matcher.add_window(a, b);
                emd_time::wasserstein_us(&mut times_a, &mut times_b, window_us)
            },
        );
        self.dissimilarity += dissimilarity;
        self.emd_time_us += emd_time_us;
    }

    fn comparison(
        &self,
        frames: &Frames,
        a: &Windower,
        b: &Windower,
        matching_us: u128,
    ) -> Comparison {
        let events_a = a.events_read();
        let share = |events: u64| match events {
            // No event is missing.
            0 => 1.0,
            events => self.matched as f64 / events as f64,
        };
        let events_b = b.events_read();
        let surplus = events_b - self.matched;
        let scale = frames.peak.max(1.0).powi(2) * frames.pixels * frames.windows.max(1.0);
        Comparison {
            events_a,
            events_b,
            exact_fraction: share(events_a),
            exact_fraction_b: share(events_b),
            missing_events: events_a - self.matched,
            surplus_events: surplus,
            surplus_fraction: surplus as f64 / events_b.max(1) as f64,
            mse: self.squared_error as f64 / scale,
            ssim: 1.0 - self.dissimilarity / frames.windows.max(1.0),
            emd_time_ms: self.emd_time_us / self.windows_with_events.max(1) as f64 / 1000.0,
            emd_pixel_us: matching_us as f64 / events_a.max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests;
