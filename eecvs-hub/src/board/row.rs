//! What is told of a sensor, as the page and the metrics have it.

use eecvs_nostd::{Coder, Fidelity, Header, Hybrid, Mode};
use serde::Serialize;

use super::latency::Latency;
use super::rate::Rates;
use crate::key::Name;

/// All that is known of one sensor. Times are seconds, and of the hub's own clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// What it is called.
    pub name: Name,
    /// Whether it has a link to some hub: its token is there or, where none was ever seen, it was heard lately.
    pub is_connected: bool,
    /// Columns of the sensor; 0 where nothing has told them.
    pub columns: u16,
    /// Rows of the sensor; 0 where nothing has told them.
    pub rows: u16,
    /// When it was started, as in [`crate::message::Stamp`]; 0 where nothing has told it.
    pub run: u64,
    /// Seconds since its last frame came.
    pub frame_age_s: Option<f64>,
    /// Seconds since its last status came.
    pub status_age_s: Option<f64>,
    /// What came over the last few seconds.
    pub rate: Rates,
    /// Frames of the sensor that came here, each once.
    pub frames_received: u64,
    /// Events in these.
    pub events_received: u64,
    /// Bytes of these.
    pub bytes_received: u64,
    /// Windows that came here: sparse, moderate, dense.
    pub windows: [u64; 3],
    /// The latest window that came.
    pub window: Option<Latest>,
    /// What was lost, by its cause.
    pub losses: Losses,
    /// From the end of a window to the arrival of its frames here, of the last ten seconds.
    pub latency: Option<Latency>,
    /// Bytes a second that it is held to.
    pub budget: Option<u32>,
    /// Whether it lowers its rate as its link does not take more.
    pub is_congested: bool,
    /// Bytes of frames that its store has in memory.
    pub store_memory_bytes: u64,
    /// Bytes of frames that its store has on disk.
    pub store_disk_bytes: u64,
    /// Tells pictures apart: another number, another picture. None where there is none.
    pub picture: Option<u64>,
}

/// The latest window of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latest {
    /// `sparse`, `moderate` or `dense`.
    pub regime: &'static str,
    /// Events per pixel and second.
    pub density: f64,
    /// `dct`, `dtft` or `dwt`; where events themselves are sent, that of the volume made of them.
    pub transform: &'static str,
    /// `plain`, `fast` or `dense`.
    pub coder: &'static str,
    /// What is kept of the times.
    pub times: Times,
}

/// What frames keep of the times of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Times {
    /// All of them.
    Exact,
    /// Each within so many microseconds.
    WithinUs(u32),
    /// Which of so many bins of the window.
    Bins(u16),
    /// So many coefficients of each pixel.
    Coefficients(u8),
}

impl Latest {
    /// That of a frame's window.
    pub(super) fn of(header: &Header) -> Self {
        let name = |coder| match coder {
            Coder::Fast => "fast",
            Coder::Dense => "dense",
        };
        let (coder, times) = match header.mode {
            Mode::Transform => ("plain", Times::Coefficients(header.m)),
            Mode::Coefficients(coder) => (name(coder), Times::Coefficients(header.m)),
            Mode::Hybrid(Hybrid { coder, fidelity }) => {
                let times = match fidelity {
                    Fidelity::Lossless => Times::Exact,
                    Fidelity::ToleranceUs(within_us) => Times::WithinUs(within_us),
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

/// What of a sensor was lost, and where. Events and the store are those of its present run, as it says itself.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Losses {
    /// Events too old for their window.
    pub events_late: u64,
    /// Events that a filter kept out.
    pub events_filtered: u64,
    /// Events lost before or in the encoder.
    pub events_dropped: u64,
    /// Events left out so that the frames fit the budget.
    pub events_thinned: u64,
    /// Frames that exist and have not come here: of this run and the one before it.
    pub frames_missing: u64,
    /// The same of all earlier runs.
    pub frames_missing_before: u64,
    /// Frames that came damaged.
    pub frames_damaged: u64,
    /// Frames that came again, which is no loss.
    pub frames_repeated: u64,
    /// Frames that its store holds no longer.
    pub frames_let_go: u64,
    /// Frames that it could not write to disk.
    pub disk_failures: u64,
    /// Messages under its name that could not be read.
    pub malformed: u64,
    /// Times that it had no link.
    pub outages: u64,
    /// Seconds of these, all together.
    pub outages_s: f64,
}
