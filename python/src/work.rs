//! Work without the interpreter's lock: interruptible, and safe in forked processes.

use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::time::{Duration, Instant};

use event_types::stream::{Assumption, Error, EventReader, Pause, Result, Skipped};
use event_types::{Event, Sensor};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The pool of a process. A forked process has none of its parent's threads: it makes a pool of its own, and the parent's
/// is left as it is.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// How often the pool's lock is tried, once a millisecond.
const TRIES: u32 = 1000;

/// Runs work that may use several threads, on this process's own pool.
///
/// # Errors
/// The system refuses the threads.
pub fn in_pool<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T> {
    Ok(pool()?.install(work))
}

/// Runs work as [`in_pool`] does, while this thread looks for signals: Python handles them in its main thread alone. What they
/// raise ends the work's [`Interruptible`] readers.
///
/// # Errors
/// The system refuses the threads.
pub fn in_pool_watched<T: Send>(raised: &Raised, work: impl FnOnce() -> T + Send) -> Result<T> {
    let pool = pool()?;
    std::thread::scope(|scope| {
        let working = scope.spawn(|| pool.install(work));
        let mut signals = Signals::new(raised);
        while !working.is_finished() {
            // It is kept in `raised`.
            let _ = signals.check();
            std::thread::sleep(Duration::from_millis(1));
        }
        let worked = working.join();
        Ok(worked.unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

fn pool() -> Result<Arc<ThreadPool>> {
    for _ in 0..TRIES {
        match POOL.try_lock() {
            Ok(slot) => return own(slot),
            Err(TryLockError::Poisoned(slot)) => return own(slot.into_inner()),
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    // It is held only while a pool is made. A process that was forked in that moment finds it held for ever.
    new_pool()
}

/// Returns the pool of this process; makes one if the slot has none, or that of another process.
fn own(mut slot: MutexGuard<'_, Option<(u32, Arc<ThreadPool>)>>) -> Result<Arc<ThreadPool>> {
    let own = std::process::id();
    if let Some((process, pool)) = slot.as_ref()
        && *process == own
    {
        return Ok(Arc::clone(pool));
    }
    let pool = new_pool()?;
    if let Some((_, parents)) = slot.replace((own, Arc::clone(&pool))) {
        // To end it would be to wait for threads that are not there.
        std::mem::forget(parents);
    }
    Ok(pool)
}

fn new_pool() -> Result<Arc<ThreadPool>> {
    let pool = ThreadPoolBuilder::new()
        .thread_name(|index| format!("eecvs-{index}"))
        .build();
    pool.map(Arc::new).map_err(Error::other)
}

/// Time between two looks at signals, such as Ctrl-C.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// An exception of Python that ended work in a library, to be raised in place of the library's error.
#[derive(Clone, Default)]
pub struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    /// Keeps the exception and returns an error that ends the work.
    pub fn keep(&self, exception: PyErr) -> Error {
        if let Ok(mut slot) = self.0.lock() {
            slot.get_or_insert(exception);
        }
        Error::other("an exception was raised")
    }

    /// Takes the exception, if there is one.
    pub fn take(&self) -> Option<PyErr> {
        self.0.lock().ok()?.take()
    }

    fn is_set(&self) -> bool {
        self.0.lock().is_ok_and(|slot| slot.is_some())
    }
}

/// Looks for signals from time to time.
pub struct Signals {
    raised: Raised,
    next: Instant,
}

impl Signals {
    pub fn new(raised: &Raised) -> Self {
        Self {
            raised: raised.clone(),
            next: Instant::now() + LOOK_EVERY,
        }
    }

    /// Returns an error if a signal's handler raised an exception, here or in another thread of this work.
    ///
    /// # Errors
    /// An exception was raised, which [`Raised`] has.
    pub fn check(&mut self) -> Result<()> {
        let now = Instant::now();
        if now < self.next {
            return Ok(());
        }
        self.next = now + LOOK_EVERY;
        if self.raised.is_set() {
            return Err(Error::other("an exception was raised"));
        }
        // The method itself is of one lifetime.
        #[allow(clippy::redundant_closure_for_method_calls)]
        let checked = Python::attach(|py| py.check_signals());
        checked.map_err(|raised| self.raised.keep(raised))
    }
}

/// A reader that ends when a signal's handler raises an exception.
pub struct Interruptible {
    reader: Box<dyn EventReader>,
    signals: Signals,
}

impl Interruptible {
    pub fn new(reader: Box<dyn EventReader>, raised: &Raised) -> Self {
        Self {
            reader,
            signals: Signals::new(raised),
        }
    }
}

impl EventReader for Interruptible {
    fn format(&self) -> &'static str {
        self.reader.format()
    }

    fn sensor(&self) -> Sensor {
        self.reader.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.reader.camera()
    }

    fn assumptions(&self) -> &[Assumption] {
        self.reader.assumptions()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        self.signals.check()?;
        self.reader.read(events)
    }

    fn seek(&mut self, t_us: u64) -> Result<bool> {
        self.reader.seek(t_us)
    }

    fn end_at(&mut self, t_us: u64) -> Result<bool> {
        self.reader.end_at(t_us)
    }

    fn pause(&self) -> Pause {
        self.reader.pause()
    }

    fn skipped(&self) -> &Skipped {
        self.reader.skipped()
    }
}
