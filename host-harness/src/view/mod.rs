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
    pub open: &'s mut dyn FnMut(&Frames, u64) -> Result<Frames>,
}

impl Scrub<'_> {
    /// Returns the frame `by` slices after the one at `at_us`, or the first one with events after that; on the way back
    /// one that is before `at_us`, if there is any.
    fn go(
        &mut self,
        frames: &mut Frames,
        (at_us, by): (u64, i64),
        stop: &AtomicBool,
    ) -> Result<Option<Frame>> {
        let mut slices = by.unsigned_abs();
        loop {
            let offset_us = slices.saturating_mul(frames.slice_us());
            let from_us = if by < 0 {
                at_us.saturating_sub(offset_us).max(self.start_us)
            } else {
                at_us.saturating_add(offset_us)
            };
            *frames = (self.open)(frames, from_us)?;
            let frame = frames.next_frame()?;
            let is_before = frame.as_ref().is_some_and(|frame| frame.start_us < at_us);
            let is_stopped = stop.load(Ordering::Relaxed);
            if by >= 0 || is_before || from_us == self.start_us || is_stopped {
                return Ok(frame);
            }
            // A stretch without events is longer than the way back.
            slices = slices.saturating_mul(2);
        }
    }

    /// Returns the first frame.
    fn start(&mut self, frames: &mut Frames) -> Result<Option<Frame>> {
        *frames = (self.open)(frames, self.start_us)?;
        frames.next_frame()
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
    let mut wish = Wish::Next;
    // Start of the frame that was shown last.
    let mut shown_us = None;
    while played.frames < limit && !stop.load(Ordering::Relaxed) {
        let next = match (wish, &mut scrub) {
            (Wish::End, _) => break,
            (Wish::By(by), Some(scrub)) => {
                let at_us = shown_us.unwrap_or(scrub.start_us);
                scrub.go(frames, (at_us, by), stop)
            }
            (Wish::Start, Some(scrub)) => scrub.start(frames),
            _ => frames.next_frame(),
        };
        match next {
            Ok(Some(frame)) => {
                wish = screen.show(&frame)?;
                if wish != Wish::Next {
                    // It waited to be shown.
                    continue;
                }
                shown_us = Some(frame.start_us);
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
