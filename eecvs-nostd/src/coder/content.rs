//! What a coder codes: the window of an encoder, or the store into which a decoder puts one.

use crate::group::{Group, Pixel};
use crate::window::Window;

/// Marks the end of a list of events.
pub const END: u32 = u32::MAX;

/// An event in a pixel's list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node {
    /// Coded time: the value of [`super::Times::of`].
    pub cell: u32,
    /// Polarity.
    pub on: bool,
    /// Index of the pixel's next event, or [`END`].
    pub next: u32,
}

/// An encoder's window, and how much of it has been coded.
#[derive(Debug)]
#[allow(dead_code, reason = "assembly alone asks")]
pub struct Parts<'p, 'w> {
    pub(crate) group: &'p mut Group,
    pub(crate) window: &'p mut Window<'w>,
    /// Events of the window that have not been coded.
    pub(crate) left: &'p mut u32,
    /// The pixel at which the output became full, the slot of its next event, and how many of its events are left.
    pub(crate) pixel: &'p mut Option<Pixel>,
    pub(crate) at: &'p mut u32,
    pub(crate) rest: &'p mut u32,
}

/// Work on an encoder's window: a closure that is always inlined.
pub trait Walk {
    /// Result of the work.
    type Walked;
    /// Does the work.
    fn walk(self, parts: Parts<'_, '_>) -> Self::Walked;
}

/// The pixels of a frame in raster order, as a coder asks for them.
///
/// An encoder answers from its window. A decoder implements the same trait, but the coder ignores its answers and
/// uses the decoded values.
pub trait Content {
    /// Returns whether row y has pixels with events that are not coded yet.
    fn has_row(&mut self, y: u16) -> bool;
    /// Returns whether a segment of 32 columns of that row has pixels with events that are not coded yet.
    fn has_segment(&mut self, segment: u16, y: u16) -> bool;
    /// Returns the columns of that segment with events that are not coded yet: bit i is column i. Called only after
    /// [`Self::has_segment`] has found the segment to have some.
    fn columns(&mut self) -> u32;
    /// Moves to the pixel found. Returns the handle by which [`Self::at`] finds the pixel's first event.
    fn enter(&mut self, position: (u16, u16)) -> u32;
    /// Returns whether the pixel has a further event.
    fn is_more(&self) -> bool;
    /// Returns the coded time and the polarity of the pixel's next event.
    fn peek(&self) -> (u32, bool);
    /// Takes note that the pixel's next event was coded with this time and polarity.
    fn take(&mut self, cell: u32, on: bool);
    /// Returns whether all events have been coded; encoder and decoder both know this.
    fn is_over(&self) -> bool;
    /// Runs `walk` on an encoder's window whose cells are times in microseconds. Returns `None`, without running it,
    /// for any other content.
    fn with_parts<W: Walk>(&mut self, _walk: W) -> Option<W::Walked> {
        None
    }
    /// Returns an event of the pixels coded so far; `None` for [`END`].
    fn at(&self, list: u32) -> Option<Node>;
}
