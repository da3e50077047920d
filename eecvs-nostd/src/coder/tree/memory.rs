//! Memory lent to the tree coder, and how much of it an effort needs.

use event_types::Sensor;

use super::counter::Counter;
use super::mix::{Curve, Weights};
use super::pyramid::Pyramid;
use super::times::{Marks, Nodes, Pixel, area_count};
use super::{Effort, TreeEvent, places, times};

/// Memory of a [`super::Tree`], each part of at least the length that [`Sizes`] gives. Its content may be anything.
#[derive(Debug)]
pub struct TreeMemory<'b> {
    /// Learned probabilities.
    pub counters: &'b mut [Counter],
    /// Learned weights of predictions.
    pub weights: &'b mut [Weights],
    /// Learned corrections of predictions.
    pub curves: &'b mut [Curve],
    /// Two pyramids, a byte or more of each pixel, and one of each block of counters.
    pub bytes: &'b mut [u8],
    /// When each node of the pyramid was last in use, and how often each slot of a window is.
    pub halves: &'b mut [u16],
    /// The last event of each pixel, after what is counted.
    pub words: &'b mut [u32],
    /// Rows of pixels.
    pub pixels: &'b mut [Pixel],
    /// Second trees of these rows.
    pub seconds: &'b mut [Nodes],
    /// Polarities and times beside the pixels, then beside the second trees.
    pub marks: &'b mut [Marks],
    /// Events of a window: for the caller, who hands them to the coder.
    pub events: &'b mut [TreeEvent],
}

/// Length of each part of [`TreeMemory`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "those of TreeMemory")]
pub struct Sizes {
    pub counters: usize,
    pub weights: usize,
    pub curves: usize,
    pub bytes: usize,
    pub halves: usize,
    pub words: usize,
    pub pixels: usize,
    pub seconds: usize,
    pub marks: usize,
    pub events: usize,
}

/// Words that count: four of the mixers, the number of the window, and which pyramid is the next one.
pub(super) const COUNTS: usize = places::MIXERS + times::MIXERS + 2;

impl Sizes {
    /// Returns what a sensor needs with an effort, for windows of up to `events` events.
    ///
    /// Without `has_history` nothing but the pixels' places is kept of the window before. [`Effort::Two`] and
    /// [`Effort::Three`] always have history.
    #[must_use]
    pub const fn new(sensor: Sensor, effort: Effort, events: usize, has_history: bool) -> Self {
        let pyramid = Pyramid::new(sensor);
        let pixels = sensor.width as usize * sensor.height as usize;
        let areas = area_count(sensor, 8);
        // A row has no more second trees than slots or events.
        let slots = 64 * sensor.width as usize;
        let trees = if events < slots { events } else { slots };
        let row = times::row_pixels(sensor);
        match effort {
            Effort::One => Self {
                counters: places::COUNTERS_SINGLE + times::COUNTERS_SINGLE,
                weights: 0,
                curves: 0,
                bytes: 2 * pyramid.bytes + areas + if has_history { pyramid.nodes } else { 0 },
                halves: 0,
                words: COUNTS + if has_history { pixels } else { 0 },
                pixels: 2 * row,
                seconds: 2 * trees,
                marks: 0,
                events,
            },
            Effort::Two | Effort::Three => {
                let is_full = matches!(effort, Effort::Three);
                let of_places = places::mixed_sizes(is_full);
                let of_times = times::mixed_sizes(is_full);
                Self {
                    counters: of_places.counters + of_times.counters,
                    weights: of_places.weights + of_times.weights,
                    curves: of_places.curves + of_times.curves,
                    bytes: 2 * pyramid.bytes
                        + pyramid.nodes
                        + areas
                        + area_count(sensor, 4)
                        + 2 * pixels
                        + of_places.blocks
                        + of_times.blocks,
                    halves: pyramid.nodes + times::HISTOGRAM,
                    words: COUNTS + pixels,
                    pixels: 3 * row,
                    seconds: 3 * trees,
                    marks: 3 * (row + trees),
                    events,
                }
            }
        }
    }

    /// Returns the size of it all in bytes.
    #[must_use]
    pub const fn total_bytes(&self) -> usize {
        self.counters * size_of::<Counter>()
            + self.weights * size_of::<Weights>()
            + self.curves * size_of::<Curve>()
            + self.bytes
            + self.halves * size_of::<u16>()
            + self.words * size_of::<u32>()
            + self.pixels * size_of::<Pixel>()
            + self.seconds * size_of::<Nodes>()
            + self.marks * size_of::<Marks>()
            + self.events * size_of::<TreeEvent>()
    }
}

impl TreeMemory<'_> {
    /// Returns whether it is large enough for a sensor and an effort, with history, and windows of as many events as
    /// it has room for, at least one.
    #[must_use]
    pub const fn serves(&self, sensor: Sensor, effort: Effort) -> bool {
        let events = self.events.len();
        events > 0 && self.has(&Sizes::new(sensor, effort, events, true))
    }

    /// Returns whether each part is large enough, but for the events, which the caller keeps.
    pub(super) const fn has(&self, sizes: &Sizes) -> bool {
        self.counters.len() >= sizes.counters
            && self.weights.len() >= sizes.weights
            && self.curves.len() >= sizes.curves
            && self.bytes.len() >= sizes.bytes
            && self.halves.len() >= sizes.halves
            && self.words.len() >= sizes.words
            && self.pixels.len() >= sizes.pixels
            && self.seconds.len() >= sizes.seconds
            && self.marks.len() >= sizes.marks
    }
}

/// Loads an element that is needed soon, so that its cache line is near by then: what is kept of a large sensor's pixels
/// does not fit in the caches of a core, and the decisions before hide how long it takes.
#[inline(always)]
pub(super) fn fetch<T: Copy>(from: &[T], at: usize) {
    if let Some(element) = from.get(at) {
        core::hint::black_box(*element);
    }
}
