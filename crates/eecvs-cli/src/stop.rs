//! Requests by the user to stop a command, by Ctrl-C or a signal.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use event_files::output::remove_parts;

/// Flag set by the first signal, if a command has asked for it.
static WISH: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);

/// What is called before a signal ends the process.
static RESTORE: Mutex<Option<fn()>> = Mutex::new(None);

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
        let restore = *RESTORE.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(restore) = restore {
            restore();
        }
        std::process::exit(ENDED);
    })
    .context("handling Ctrl-C")
}

/// Has a function called before a second signal ends the process, which drops nothing then: it gives back what is not
/// the process's own, such as a terminal.
pub fn restore_at_end(restore: fn()) {
    *RESTORE.lock().unwrap_or_else(PoisonError::into_inner) = Some(restore);
}

/// Returns a flag that the first signal from here on sets; the second signal ends the process at once.
pub fn stop_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    *WISH.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&stop));
    stop
}
