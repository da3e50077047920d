//! What is known of a sensor, in the form that the page and the metrics use.

use eecvs_nostd::{Coder, Fidelity, Header, Hybrid, Mode};
use serde::Serialize;

use super::latency::Latency;
use super::rate::Rates;
use crate::clock::Estimate;
use crate::key::Name;

/// All that is known of one sensor. Ages are in seconds, by the hub's own clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the sensor.
    pub name: Name,
    /// Whether the sensor has a link to some hub: its token exists or, if none was ever seen, the sensor was heard
    /// recently.
    pub is_connected: bool,
    /// Columns of the sensor; 0 if unknown.
    pub columns: u16,
    /// Rows of the sensor; 0 if unknown.
    pub rows: u16,
    /// The sensor's run, as in [`crate::message::Stamp`]; 0 if unknown.
    pub run: u64,
    /// Seconds since the run's start; `None` if unknown.
    pub up_s: Option<f64>,
    /// Number of sensors that send under this name at present: more than 1 if the name was given to several, whose
    /// figures are then mixed here; 0 if none is heard.
    pub at_once: usize,
    /// The largest such number so far.
    pub at_once_most: usize,
    /// Seconds since the last frame arrived.
    pub frame_age_s: Option<f64>,
    /// Seconds since the last status arrived.
    pub status_age_s: Option<f64>,
    /// Rates over the last few seconds.
    pub rate: Rates,
    /// Frames of the sensor that arrived here, each counted once.
    pub frames_received: u64,
    /// Events in these frames.
    pub events_received: u64,
    /// Bytes of these frames.
    pub bytes_received: u64,
    /// Windows that arrived here: sparse, moderate, dense.
    pub windows: [u64; 3],
    /// The latest window that arrived.
    pub window: Option<Latest>,
    /// Losses by cause.
    pub losses: Losses,
    /// Time from the end of a window to the arrival of its frames here, over the last ten seconds, without the
    /// difference between the clocks; `None` if that is unknown, or no frame arrived.
    pub latency: Option<Latency>,
    /// How far the clock of the present run is ahead of the hub's; `None` if unknown.
    pub clock: Option<Estimate>,
    /// Limit on the sensor's rate in bytes per second, if there is one.
    pub budget: Option<u32>,
    /// Whether the sensor lowers its rate because its link cannot take more.
    pub is_congested: bool,
    /// Bytes of frames in memory in the sensor's store.
    pub store_memory_bytes: u64,
    /// Bytes that the sensor's store takes on disk.
    pub store_disk_bytes: u64,
    /// Bytes of damaged records among them.
    pub store_damaged_bytes: u64,
    /// Identifies the picture: it changes with the picture. `None` if there is none.
    pub picture: Option<u64>,
}

/// The latest window of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latest {
    /// `sparse`, `moderate` or `dense`.
    pub regime: &'static str,
    /// Events per pixel and second.
    pub density: f64,
    /// `dct`, `dtft` or `dwt`; for a window sent as events, the transform of the volume made from them.
    pub transform: &'static str,
    /// `plain`, `fast` or `dense`.
    pub coder: &'static str,
    /// How exact the event times are.
    pub times: Times,
}

/// How exactly frames represent the times of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Times {
    /// Exactly.
    Exact,
    /// Each within this many microseconds.
    WithinUs(u32),
    /// By the bin, of this many in the window.
    Bins(u16),
    /// By this many coefficients per pixel.
    Coefficients(u8),
}

impl Latest {
    /// Describes the window of a frame.
    pub(super) fn of(header: &Header) -> Self {
        let name = Coder::name;
        let (coder, times) = match header.mode {
            Mode::Transform => ("plain", Times::Coefficients(header.m)),
            Mode::Coefficients(coder) => (name(coder), Times::Coefficients(header.m)),
            Mode::Hybrid(Hybrid { coder, fidelity }) => {
                let times = match fidelity {
                    Fidelity::Lossless => Times::Exact,
                    Fidelity::ToleranceUs(within_us) => Times::WithinUs(within_us),
                    Fidelity::SpreadUs(width_us) => Times::WithinUs(width_us.saturating_sub(1)),
                    Fidelity::Bins(bins) => Times::Bins(bins),
                };
                (name(coder), times)
            }
        };
        let density = eecvs_nostd::Density {
            events: header.window_events,
            pixels: header.sensor.pixels(),
            duration_us: header.duration_us,
        };
        Self {
            regime: header.regime.name(),
            density: density.per_pixel_s(),
            transform: header.transform.name(),
            coder,
            times,
        }
    }
}

/// Losses of a sensor, by cause. Counts of events and of the store are those of the present run, as reported by the
/// sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Losses {
    /// Events too old for their window.
    pub events_late: u64,
    /// Events removed by a filter.
    pub events_filtered: u64,
    /// Events lost before or in the encoder.
    pub events_dropped: u64,
    /// Events left out so that the frames fit the budget.
    pub events_thinned: u64,
    /// Frames of this run and the one before it that exist and have not arrived here.
    pub frames_missing: u64,
    /// The same for all earlier runs.
    pub frames_missing_before: u64,
    /// Frames that arrived damaged.
    pub frames_damaged: u64,
    /// Frames that arrived again, which is not a loss.
    pub frames_repeated: u64,
    /// Frames made during or near an outage that the sensor's store no longer holds.
    pub frames_let_go: u64,
    /// Frames that the sensor could not write to disk.
    pub disk_failures: u64,
    /// Frames in the sensor's store on disk that are damaged or missing.
    pub disk_damaged_frames: u64,
    /// Messages under the sensor's name that could not be read.
    pub malformed: u64,
    /// Number of times that the sensor's link failed.
    pub outages: u64,
    /// Total time without a link, in seconds.
    pub outages_s: f64,
}
