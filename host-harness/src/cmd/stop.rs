//! The wish to stop, of who runs a command.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// Set by Ctrl-C and termination signals; the second ends the process at once.
///
/// # Errors
/// Signals that cannot be handled.
pub fn stop_on_signals() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let wish = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if wish.swap(true, Ordering::Relaxed) {
            std::process::exit(1);
        }
    })
    .context("handling Ctrl-C")?;
    Ok(stop)
}
