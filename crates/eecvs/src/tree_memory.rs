//! Memory of the tree coder on the host.

use eecvs_nostd::coder::tree::{
    Counter, Curve, Marks, Nodes, Pixel, Sizes, TreeEvent, TreeMemory, Weights,
};
use eecvs_nostd::{Effort, Sensor};
use zerocopy::{AllocError, FromZeros};

/// Memory of the tree coder, allocated for a sensor and an effort.
#[derive(Debug, Default)]
pub(crate) struct TreeStorage {
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

impl TreeStorage {
    /// Allocates memory for windows of any number of events; `events` of them have room in it. The system gives zeros,
    /// of which only what a window touches takes room.
    ///
    /// # Errors
    /// Fails if the system refuses the memory.
    pub(crate) fn new(sensor: Sensor, effort: Effort, events: usize) -> Result<Self, AllocError> {
        let sizes = Sizes::new(sensor, effort, usize::MAX, true);
        Ok(Self {
            counters: Counter::new_vec_zeroed(sizes.counters)?,
            weights: Weights::new_vec_zeroed(sizes.weights)?,
            curves: Curve::new_vec_zeroed(sizes.curves)?,
            bytes: u8::new_vec_zeroed(sizes.bytes)?,
            halves: u16::new_vec_zeroed(sizes.halves)?,
            words: u32::new_vec_zeroed(sizes.words)?,
            pixels: Pixel::new_vec_zeroed(sizes.pixels)?,
            seconds: Nodes::new_vec_zeroed(sizes.seconds)?,
            marks: Marks::new_vec_zeroed(sizes.marks)?,
            events: TreeEvent::new_vec_zeroed(events)?,
        })
    }

    /// Lends all of it.
    pub(crate) fn lent(&mut self) -> TreeMemory<'_> {
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
}
