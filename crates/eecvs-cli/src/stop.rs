//! Requests by the user to stop a command, by Ctrl-C or a signal.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use event_files::output::remove_parts;

/// Flag set by the first signal, if a command has asked for it.
static WISH: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);

/// Exit status of a process that was ended by a signal.
const ENDED: i32 = 130;

/// Makes Ctrl-C and termination signals end the process without leaving incomplete files behind.
///
/// A command that has called [`stop_on_signals`] is only notified of the first signal, and ends by itself.
///
/// # Errors
/// The signal handler cannot be installed.
pub fn end_on_signals() -> Result<()> {
    ctrlc::set_handler(|| {
        let wish = WISH.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if wish.is_some_and(|wish| !wish.swap(true, Ordering::Relaxed)) {
            return;
        }
        remove_parts();
        std::process::exit(ENDED);
    })
    .context("handling Ctrl-C")
}

/// Returns a flag that the first signal from here on sets; the second signal ends the process at once.
pub fn stop_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    *WISH.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&stop));
    stop
}
