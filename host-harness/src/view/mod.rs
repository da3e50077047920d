//! Recordings and frames as moving pictures: events -> slices of time -> frames -> terminal, GIF or PNG.
//!
//! Nothing is held but what of the stream may still belong to the next frames, however long it is.

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

/// What shows frames, one after the other.
pub trait Screen {
    /// Shows the next frame; it may return only when its time has come.
    ///
    /// # Errors
    /// Writing.
    fn show(&mut self, frame: &Frame) -> Result<()>;

    /// Ends what was shown. A file that is not ended so is removed.
    ///
    /// # Errors
    /// Writing.
    fn finish(self: Box<Self>) -> Result<()>;
}

/// What was shown.
#[derive(Debug, Default)]
pub struct Played {
    /// Frames.
    pub frames: u64,
    /// Events of the first input in them.
    pub events: u64,
    /// Events of the second input in them.
    pub decoded_events: u64,
    /// Damage that ended it; everything before has been shown.
    pub failure: Option<Error>,
}

/// Shows frames up to the end, to the first damage, to `limit` frames or until `stop` is set;
/// `progress` gets their number.
///
/// # Errors
/// Writing; damage of an input is told by [`Played::failure`].
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
