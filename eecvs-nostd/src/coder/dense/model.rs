//! Model of the dense coder: all probabilities and tables that it learns, by context.

use crate::coder::dense::neighbourhood::{
    PIXEL_CONTEXTS, POLARITY_CONTEXTS, RUN_CONTEXTS, SEGMENT_CONTEXTS,
};
use crate::coder::dense::times::LearnedTimes;
use crate::coder::range::Probability;

/// Contexts of a row's flag: whether the row above, and this row of the window before, have pixels.
const ROW_CONTEXTS: usize = 4;

/// The part of the dense coder's memory whose size does not depend on the sensor.
#[derive(Debug, Clone)]
pub struct Model {
    pub(super) rows: [Probability; ROW_CONTEXTS],
    pub(super) segments: [Probability; SEGMENT_CONTEXTS],
    pub(super) runs: [Probability; RUN_CONTEXTS],
    pub(super) pixels: [Probability; PIXEL_CONTEXTS],
    pub(super) polarities: [Probability; POLARITY_CONTEXTS],
    pub(super) times: LearnedTimes,
}

impl Model {
    /// All zero, for memory in `.bss`; call [`Self::restart`] before use.
    pub const UNSET: Self = Self {
        rows: [Probability::UNSET; _],
        segments: [Probability::UNSET; _],
        runs: [Probability::UNSET; _],
        pixels: [Probability::UNSET; _],
        polarities: [Probability::UNSET; _],
        times: LearnedTimes::UNSET,
    };

    /// Resets all probabilities and tables to what they are before any event.
    pub fn restart(&mut self) {
        let Self {
            rows,
            segments,
            runs,
            pixels,
            polarities,
            times,
        } = self;
        rows.fill(Probability::EVEN);
        segments.fill(Probability::EVEN);
        runs.fill(Probability::EVEN);
        pixels.fill(Probability::EVEN);
        polarities.fill(Probability::EVEN);
        times.restart();
    }
}
