//! Shows recordings and frames as moving pictures: events -> slices of time -> frames -> terminal, GIF or PNG.
//!
//! Memory is bounded whatever the length of the stream: only events that may belong to the next frames are held.

pub mod frames;
pub mod gif;
pub mod input;
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
    /// Shows the next frame; may wait until the frame is due.
    ///
    /// # Errors
    /// Fails if writing fails.
    fn show(&mut self, frame: &Frame) -> Result<()>;

    /// Completes the output. A file that is dropped without this call is removed.
    ///
    /// # Errors
    /// Fails if writing fails.
    fn finish(self: Box<Self>) -> Result<()>;
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

/// Shows frames until the end, the first damage, `limit` frames or `stop`; calls `progress` with their number.
///
/// # Errors
/// Fails if writing fails; damage of an input is reported in [`Played::failure`] instead.
pub fn play(
    frames: &mut Frames,
    mut screen: Box<dyn Screen>,
    limit: u64,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(u64),
) -> Result<Played> {
    let mut played = Played::default();
    while played.frames < limit && !stop.load(Ordering::Relaxed) {
        match frames.next_frame() {
            Ok(Some(frame)) => {
                screen.show(&frame)?;
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
