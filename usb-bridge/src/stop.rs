//! The wish to stop: Ctrl-C, a termination signal, a time or a number of events that was asked for.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// A wish that any thread may see; clones are the same wish.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// One that Ctrl-C and termination signals make. The second ends the process at once.
    ///
    /// # Errors
    /// The system does not take the handler; only the first call in a process can have it.
    pub fn on_signals() -> Result<Self> {
        let stop = Self::default();
        let wish = stop.clone();
        ctrlc::set_handler(move || {
            if wish.0.swap(true, Ordering::Relaxed) {
                std::process::exit(1);
            }
        })
        .context("handling Ctrl-C")?;
        Ok(stop)
    }

    /// Makes the wish.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether it was made.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
