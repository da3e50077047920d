//! A stop request shared between threads, set by Ctrl-C, by a termination signal or by the program; and calls that are not
//! waited for any longer once it is set.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::Builder;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use event_files::output::remove_parts;

/// Exit status of a process that a second signal ended.
const ENDED: i32 = 130;

/// A stop request that any thread can see; clones share it.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<Asked>);

#[derive(Debug, Default)]
struct Asked {
    is_asked: AtomicBool,
    is_signalled: AtomicBool,
}

impl Stop {
    /// Creates a request that Ctrl-C and termination signals set. A second signal ends the process at once.
    ///
    /// # Errors
    /// The system refuses the handler; only the first call in a process can install it.
    pub fn on_signals() -> Result<Self> {
        let stop = Self::default();
        let wish = stop.clone();
        ctrlc::set_handler(move || {
            // Not `is_asked`, which the program may set as well, at its end.
            if wish.0.is_signalled.swap(true, Ordering::Relaxed) {
                remove_parts();
                std::process::exit(ENDED);
            }
            wish.ask();
        })
        .context("handling Ctrl-C")?;
        Ok(stop)
    }

    /// Requests the stop, for all clones.
    pub fn ask(&self) {
        self.0.is_asked.store(true, Ordering::Relaxed);
    }

    /// Returns whether the stop was requested.
    #[must_use]
    pub fn is_asked(&self) -> bool {
        self.0.is_asked.load(Ordering::Relaxed)
    }

    /// Returns whether a signal requested the stop: somebody waits for the end.
    #[must_use]
    pub fn is_signalled(&self) -> bool {
        self.0.is_signalled.load(Ordering::Relaxed)
    }
}

/// Period at which a wait for a call checks whether it goes on.
const LOOK: Duration = Duration::from_millis(20);

/// Makes a call that nothing can end, such as one of the system's resolver, in a thread of its own, and waits for it
/// while `goes_on` returns true. Returns `None` if it did not: the thread is then left to itself.
///
/// # Errors
/// There is no thread for the call, or it panicked.
pub fn wait_for<T: Send + 'static>(
    call: impl FnOnce() -> T + Send + 'static,
    goes_on: &dyn Fn() -> bool,
) -> io::Result<Option<T>> {
    let (returned, returns) = mpsc::sync_channel(1);
    Builder::new().name("call".to_owned()).spawn(move || {
        // Nobody may wait for it any more.
        let _ = returned.send(call());
    })?;
    while goes_on() {
        match returns.recv_timeout(LOOK) {
            Ok(value) => return Ok(Some(value)),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(io::Error::other("a thread panicked: please report this"));
            }
        }
    }
    Ok(None)
}

/// As [`wait_for`], for at most this time.
///
/// # Errors
/// Those of [`wait_for`].
pub fn wait_at_most<T: Send + 'static>(
    call: impl FnOnce() -> T + Send + 'static,
    most: Duration,
) -> io::Result<Option<T>> {
    let since = Instant::now();
    wait_for(call, &|| since.elapsed() < most)
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn a_call_is_waited_for_no_longer_than_wished() {
        assert_eq!(wait_for(|| 3, &|| true).unwrap(), Some(3));
        // The call returns when this is dropped, after the test.
        let (_held, hangs) = mpsc::channel::<()>();
        let asked = Cell::new(0);
        let goes_on = || asked.replace(asked.get() + 1) < 2;
        let call = move || hangs.recv().is_ok();
        assert_eq!(wait_for(call, &goes_on).unwrap(), None);
        assert_eq!(asked.get(), 3);
    }
}
