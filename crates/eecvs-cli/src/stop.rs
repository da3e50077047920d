//! The wish to stop, of who runs a command.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result};
use event_files::output::remove_parts;

/// Set by the first signal, where a command looks at it.
static WISH: Mutex<Option<Arc<AtomicBool>>> = Mutex::new(None);

/// Status of a process that a signal ended.
const ENDED: i32 = 130;

/// Makes Ctrl-C and termination signals end the process without half a file left behind; a command that asks for
/// [`stop_on_signals`] ends by itself at the first.
///
/// # Errors
/// Signals that cannot be handled.
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

/// Set by the first signal from here on; the second ends the process at once.
pub fn stop_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    *WISH.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&stop));
    stop
}
