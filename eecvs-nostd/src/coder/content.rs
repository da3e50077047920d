//! What a coder codes: an encoder's window, or a decoder's place to put one.

use crate::group::{Group, Pixel};
use crate::window::Window;

/// The end of a list, in place of an event.
pub const END: u32 = u32::MAX;

/// An event of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Node {
    /// What its time is told as: [`super::Times`].
    pub cell: u32,
    /// Polarity.
    pub on: bool,
    /// The pixel's next event, or [`END`].
    pub next: u32,
}

/// An encoder's window, and how far it is coded.
#[derive(Debug)]
#[allow(dead_code, reason = "assembly alone asks")]
pub struct Parts<'p, 'w> {
    pub(crate) group: &'p mut Group,
    pub(crate) window: &'p mut Window<'w>,
    /// Events left of the window.
    pub(crate) left: &'p mut u32,
    /// The pixel at which the output is full, its next slot, and whether there is one.
    pub(crate) pixel: &'p mut Option<Pixel>,
    pub(crate) at: &'p mut u32,
    pub(crate) rest: &'p mut u32,
}

/// What is done with an encoder's window: a closure that is always inlined.
pub trait Walk {
    /// How far it came.
    type Walked;
    /// Does it.
    fn walk(self, parts: Parts<'_, '_>) -> Self::Walked;
}

/// The pixels of a frame in raster order, as a coder asks for them: an encoder answers, a decoder's
/// answers are not looked at.
pub trait Content {
    /// Whether row y has pixels with events that are not coded yet.
    fn has_row(&mut self, y: u16) -> bool;
    /// Whether a segment of 32 columns of that row has.
    fn has_segment(&mut self, segment: u16, y: u16) -> bool;
    /// Which columns of that segment have: bit i is column i's. It has been found to have some.
    fn columns(&mut self) -> u32;
    /// Goes to the pixel found; returns what [`Self::at`] will know its first event by.
    fn enter(&mut self, position: (u16, u16)) -> u32;
    /// Whether the pixel has a further event.
    fn is_more(&self) -> bool;
    /// What its time is told as, and its polarity.
    fn peek(&self) -> (u32, bool);
    /// It has been coded as this.
    fn take(&mut self, cell: u32, on: bool);
    /// Whether all events have been coded: both sides know.
    fn is_over(&self) -> bool;
    /// Hands an encoder's window, where its times are coded as they are, to a walk that looks at it itself.
    fn with_parts<W: Walk>(&mut self, _walk: W) -> Option<W::Walked> {
        None
    }
    /// An event of the pixels coded so far; `None` for [`END`].
    fn at(&self, list: u32) -> Option<Node>;
}
