//! A stop request shared between threads, set by Ctrl-C, by a termination signal or by the program.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use event_files::output::remove_parts;

/// Exit status of a process that a second signal ended.
const ENDED: i32 = 130;

/// A stop request that any thread can see; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Creates a request that Ctrl-C and termination signals set. A second signal ends the process at once.
    ///
    /// # Errors
    /// The system refuses the handler; only the first call in a process can install it.
    pub fn on_signals() -> Result<Self> {
        let stop = Self::default();
        let wish = stop.clone();
        // Not the wish itself, which the program may set as well, at its end.
        let is_signalled = AtomicBool::new(false);
        ctrlc::set_handler(move || {
            wish.ask();
            if is_signalled.swap(true, Ordering::Relaxed) {
                remove_parts();
                std::process::exit(ENDED);
            }
        })
        .context("handling Ctrl-C")?;
        Ok(stop)
    }

    /// Requests the stop, for all clones.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Returns whether the stop was requested.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
