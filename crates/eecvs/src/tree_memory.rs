//! Memory of the tree coder on the host.

use eecvs_nostd::coder::tree::{
    Counter, Curve, Marks, Nodes, Pixel, Sizes, TreeEvent, TreeMemory, Weights,
};
use eecvs_nostd::{Effort, Sensor};

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
    /// Allocates memory for windows of any number of events; `events` of them have room in it.
    pub(crate) fn new(sensor: Sensor, effort: Effort, events: usize) -> Self {
        let sizes = Sizes::new(sensor, effort, usize::MAX, true);
        Self {
            counters: vec![Counter::UNSET; sizes.counters],
            weights: vec![Weights::default(); sizes.weights],
            curves: vec![[0; _]; sizes.curves],
            bytes: vec![0; sizes.bytes],
            halves: vec![0; sizes.halves],
            words: vec![0; sizes.words],
            pixels: vec![Pixel::NONE; sizes.pixels],
            seconds: vec![Nodes::default(); sizes.seconds],
            marks: vec![Marks::default(); sizes.marks],
            events: vec![TreeEvent::NONE; events],
        }
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
