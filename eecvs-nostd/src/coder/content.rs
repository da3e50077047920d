//! What a coder codes: an encoder's window, or a decoder's place to put one.

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
    /// Hands an encoder's window, where its times are told as they are, to a walk that looks at it itself.
    #[cfg(eecvs_dsp)]
    fn with_parts(
        &mut self,
        _walk: impl super::dense::armv7em::Walks,
    ) -> Option<super::dense::armv7em::Walked> {
        None
    }
    /// An event of the pixels coded so far; `None` for [`END`].
    fn at(&self, list: u32) -> Option<Node>;
}
