//! What commands do about times that run back.

use std::path::Path;

use anyhow::{Result, bail};
use clap::Args;

use crate::encode::EncodeSummary;
use crate::formats::EventReader;
use crate::progress::Progress;
use crate::sort::Sorted;

/// Whether a recording is sorted.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct SortOptions {
    /// Sort the events by time first, however far times run back; events of equal time keep their order. Uses
    /// temporary files where they are many
    #[arg(long)]
    sort: bool,
}

impl SortOptions {
    /// Whether it is.
    #[must_use]
    pub const fn is_asked(self) -> bool {
        self.sort
    }

    /// The reader, or one of its events in order.
    ///
    /// # Errors
    /// A temporary file that cannot be written.
    pub fn apply(self, reader: Box<dyn EventReader>) -> Result<Box<dyn EventReader>> {
        if !self.sort {
            return Ok(reader);
        }
        let progress = Progress::new("events");
        Ok(Box::new(Sorted::new(reader, &mut |events| {
            progress.advance(events);
        })?))
    }
}

/// How much disorder is put right, and whether more of it is an error.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OrderOptions {
    /// Put events in order that come up to N microseconds after later ones; a clock that falls back further
    /// begins a new run of windows. 0: it always does [default: 5000, of a live source 1000]
    #[arg(long, value_name = "N")]
    pub reorder_us: Option<u32>,

    /// Exit with 0 also where events came too late and are in no frame
    #[arg(long)]
    pub allow_loss: bool,
}

/// Says on stderr how often a clock fell back; an error where events are lost by it, unless that is allowed.
///
/// # Errors
/// Events that came too late, which are in no frame.
pub fn tell_disorder(input: &Path, summary: &EncodeSummary, allow_loss: bool) -> Result<()> {
    let name = input.display();
    if summary.runs > 1 {
        eprintln!(
            "eecvs: {name}: times run back further than is put in order: the frames are of {} runs, and hold all \
             events; where it is one recording out of order, --sort or a longer --reorder-us takes fewer bytes",
            summary.runs
        );
    }
    if summary.events_late == 0 {
        return Ok(());
    }
    let message = format!(
        "{name}: {} of {} events came too late and are in no frame: give --reorder-us or --sort",
        summary.events_late, summary.events_in
    );
    if allow_loss {
        eprintln!("eecvs: {message}");
        return Ok(());
    }
    bail!("{message}; --allow-loss makes it no error")
}
