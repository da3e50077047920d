//! Handling of times that run backwards.

use std::path::Path;

use anyhow::{Result, bail};
use clap::Args;
use eecvs::encode::EncodeSummary;
use event_files::EventReader;
use event_files::sort::Sorted;

use crate::progress::Progress;
use crate::say;

/// Whether a recording is sorted first.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct SortOptions {
    /// Sort the events by time first, however far times run back; events of equal time keep their order. Uses
    /// temporary files for large recordings
    #[arg(long)]
    sort: bool,
}

impl SortOptions {
    /// Returns whether sorting was requested.
    #[must_use]
    pub const fn is_asked(self) -> bool {
        self.sort
    }

    /// Returns the reader, or if sorting was requested a reader of its events sorted by time.
    ///
    /// # Errors
    /// An error of the reader, or a temporary file that cannot be written.
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

/// How much disorder is corrected, and whether any more is an error.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OrderOptions {
    /// Reorder events that arrive up to N microseconds after later ones; a clock that falls back further begins a new
    /// run of windows, and with 0 any step back does [default: 5000, for a live source 1000]
    #[arg(long, value_name = "N")]
    pub reorder_us: Option<u32>,

    /// Exit with 0 even if events came too late and are in no frame
    #[arg(long)]
    pub allow_loss: bool,
}

impl OrderOptions {
    /// Reports events that came too late: as an error that names a `remedy`, or through `warn` if loss is allowed.
    ///
    /// The pair is the number of late events and the number of all events; nothing is reported if none was late.
    ///
    /// # Errors
    /// Events are in no frame, and loss is not allowed.
    pub fn refuse_late(
        self,
        name: &str,
        (late, events): (u64, u64),
        remedy: &str,
        warn: impl FnOnce(&str),
    ) -> Result<()> {
        if late == 0 {
            return Ok(());
        }
        let message = format!(
            "{name}: {late} of {events} events came too late and are in no frame: give {remedy}"
        );
        if self.allow_loss {
            warn(&message);
            return Ok(());
        }
        bail!("{message}; with --allow-loss this is not an error")
    }
}

/// Reports on stderr into how many runs a clock that fell back divided the recording, and refuses late events.
///
/// # Errors
/// Events came too late and are in no frame, unless loss is allowed.
pub fn tell_disorder(input: &Path, summary: &EncodeSummary, order: OrderOptions) -> Result<()> {
    let name = input.display().to_string();
    if summary.runs > 1 {
        say!(
            "eecvs: {name}: times run backwards further than --reorder-us puts in order: the \
             frames form {} runs and hold all events; if this is one recording out of order, \
             --sort or a longer --reorder-us needs fewer bytes",
            summary.runs
        );
    }
    let late = (summary.events_late, summary.events_in);
    order.refuse_late(&name, late, "--reorder-us or --sort", |line| {
        say!("eecvs: {line}");
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_events_are_an_error_unless_loss_is_allowed() {
        let mut order = OrderOptions::default();
        let silent = |line: &str| panic!("{line}");
        order.refuse_late("door", (0, 20), "time", silent).unwrap();
        let refused = order.refuse_late("door", (4, 20), "time", silent);
        let refused = refused.unwrap_err().to_string();
        let message = "door: 4 of 20 events came too late and are in no frame: give time";
        assert_eq!(
            refused,
            format!("{message}; with --allow-loss this is not an error")
        );
        order.allow_loss = true;
        let mut warned = String::new();
        order
            .refuse_late("door", (4, 20), "time", |line| warned = line.to_owned())
            .unwrap();
        assert_eq!(warned, message);
    }
}
