//! Shows recordings and frames as moving pictures: events -> slices of time -> frames -> terminal, GIF or PNG.
//!
//! Memory is bounded whatever the length of the stream: only events that may belong to the next frames are held.

pub mod frames;
pub mod gif;
pub mod input;
pub mod keys;
pub mod pace;
pub mod palette;

pub mod picture;
pub mod png;
pub mod slices;
pub mod terminal;

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Error, Result};

use frames::{Frame, Frames};

/// An output that shows one frame after the other.
pub trait Screen {
    /// Shows the next frame; may wait until the frame is due. Returns what to show after it.
    ///
    /// # Errors
    /// Fails if writing fails.
    fn show(&mut self, frame: &Frame) -> Result<Wish>;

    /// Completes the output. A file that is dropped without this call is removed.
    ///
    /// # Errors
    /// Fails if writing fails.
    fn finish(self: Box<Self>) -> Result<()>;
}

/// What a user wishes to see after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wish {
    /// The next frame.
    Next,
    /// The frame so many slices after this one, or before it if negative.
    By(i64),
    /// The first frame.
    Start,
    /// Nothing.
    End,
}

/// How frames of another time are reached.
pub struct Scrub<'s> {
    /// Start of the first slice, in us.
    pub start_us: u64,
    /// Opens the inputs again, in place of the frames given, for slices from a time in us on.
    #[allow(clippy::type_complexity, reason = "named here")]
    pub open: &'s mut dyn FnMut(&Frames, u64) -> Result<Frames>,
}

impl Scrub<'_> {
    /// Returns the frame `by` slices after the one at `at_us`, or the next one with events; the one before it if
    /// nothing else is that far back.
    fn go(&mut self, frames: &mut Frames, at_us: u64, mut by: i64) -> Result<Option<Frame>> {
        loop {
            let offset_us = by.saturating_mul(i64::try_from(frames.slice_us()).unwrap_or(i64::MAX));
            let from_us = at_us.saturating_add_signed(offset_us).max(self.start_us);
            *frames = (self.open)(frames, from_us)?;
            let frame = frames.next_frame()?;
            let is_before = frame.as_ref().is_some_and(|frame| frame.start_us < at_us);
            if by >= 0 || is_before || from_us == self.start_us {
                return Ok(frame);
            }
            // A stretch without events is longer than the way back.
            by = by.saturating_mul(2);
        }
    }
}

/// Counts of what was shown.
#[derive(Debug, Default)]
pub struct Played {
    /// Number of frames.
    pub frames: u64,
    /// Number of events of the first input in the frames.
    pub events: u64,
    /// Number of events of the second input in the frames.
    pub decoded_events: u64,
    /// Damage that ended the playback; everything before it has been shown.
    pub failure: Option<Error>,
}

/// Shows frames until the end, the first damage, `limit` frames or `stop`; calls `progress` with their number. Without
/// `scrub`, they come one after the other.
///
/// # Errors
/// Fails if writing fails; damage of an input is reported in [`Played::failure`] instead.
pub fn play(
    frames: &mut Frames,
    mut screen: Box<dyn Screen>,
    limit: u64,
    stop: &AtomicBool,
    mut scrub: Option<Scrub<'_>>,
    progress: &mut dyn FnMut(u64),
) -> Result<Played> {
    let mut played = Played::default();
    let mut wish = (Wish::Next, 0);
    while played.frames < limit && !stop.load(Ordering::Relaxed) {
        let next = match (wish, &mut scrub) {
            ((Wish::End, _), _) => break,
            ((Wish::By(by), at_us), Some(scrub)) => scrub.go(frames, at_us, by),
            ((Wish::Start, at_us), Some(scrub)) => scrub.go(frames, at_us, i64::MIN),
            _ => frames.next_frame(),
        };
        match next {
            Ok(Some(frame)) => {
                wish = (screen.show(&frame)?, frame.start_us);
                played.frames += 1;
                played.events += frame.events;
                played.decoded_events += frame.decoded_events;
                progress(played.frames);
            }
            Ok(None) => break,
            Err(error) => {
                played.failure = Some(error);
                break;
            }
        }
    }
    if played.frames > 0 {
        screen.finish()?;
    }
    Ok(played)
}
