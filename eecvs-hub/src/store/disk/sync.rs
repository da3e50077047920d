//! Syncs what was written, at an interval, on a thread of its own: a sync may take as long as the disk likes, and
//! neither the encoder nor the link waits for it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::{Context as _, Result};

use super::medium::{Medium, Writable};

/// Maximum number of files that wait to be synced, each of which has a descriptor; beyond it, whoever writes syncs.
const FILES_MAX: usize = 8;

/// Syncs the files of a folder.
#[derive(Debug)]
pub(super) struct Syncer {
    shared: Arc<Shared>,
    /// None where every frame is synced when it is written.
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    medium: Arc<dyn Medium>,
    folder: PathBuf,
    state: Mutex<State>,
    changed: Condvar,
    /// Held while files are synced: whoever has had it knows that what was taken by others is synced too.
    turn: Mutex<()>,
}

#[derive(Debug, Default)]
struct State {
    /// Files that were written to, and the number of frames in each that are not synced.
    waiting: Vec<(Arc<dyn Writable>, u64)>,
    /// Whether a file was created, so that the folder has to be synced.
    is_folder_changed: bool,
    /// Number of frames that are being synced.
    under_way: u64,
    /// Number of frames that could not be synced.
    failures: u64,
    has_failed: bool,
    ends: bool,
}

impl Syncer {
    /// Starts to sync at an interval; if that is zero, every frame when it is written.
    pub(super) fn start(folder: &Path, medium: Arc<dyn Medium>, every: Duration) -> Result<Self> {
        let shared = Arc::new(Shared {
            medium,
            folder: folder.to_owned(),
            state: Mutex::default(),
            changed: Condvar::new(),
            turn: Mutex::default(),
        });
        let own = Arc::clone(&shared);
        let thread = (!every.is_zero()).then(|| {
            let thread = thread::Builder::new().name("sync".to_owned());
            thread.spawn(move || own.run(every))
        });
        let thread = thread
            .transpose()
            .context("starting the thread that syncs")?;
        Ok(Self { shared, thread })
    }

    /// Takes note of a new file.
    pub(super) fn created(&self) {
        self.shared.state().is_folder_changed = true;
    }

    /// Takes note of a frame that was written to a file.
    pub(super) fn wrote(&self, file: &Arc<dyn Writable>) {
        let mut state = self.shared.state();
        match state.waiting.last_mut() {
            Some((last, frames)) if Arc::ptr_eq(last, file) => *frames += 1,
            _ => state.waiting.push((Arc::clone(file), 1)),
        }
        let is_now = self.thread.is_none() || state.waiting.len() > FILES_MAX;
        drop(state);
        match is_now {
            true => self.sync(),
            false => self.shared.changed.notify_all(),
        }
    }

    /// Syncs all that was written so far.
    pub(super) fn sync(&self) {
        self.shared.sync();
    }

    /// Returns the number of frames that a power cut may cost at this moment, and the number of those that could not
    /// be synced.
    pub(super) fn figures(&self) -> (u64, u64) {
        let state = self.shared.state();
        let waiting: u64 = state.waiting.iter().map(|(_, frames)| frames).sum();
        (waiting + state.under_way, state.failures)
    }

    /// Returns whether a sync has failed since this was last asked.
    pub(super) fn take_failed(&self) -> bool {
        std::mem::take(&mut self.shared.state().has_failed)
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.shared.state().ends = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        self.sync();
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, every: Duration) {
        loop {
            let state = self.state();
            let is_idle = |state: &mut State| !state.ends && state.waiting.is_empty();
            let waited = self.changed.wait_while(state, is_idle);
            let state = waited.unwrap_or_else(PoisonError::into_inner);
            let goes_on = |state: &mut State| !state.ends;
            let waited = self.changed.wait_timeout_while(state, every, goes_on);
            let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
            if state.ends {
                return;
            }
            drop(state);
            self.sync();
        }
    }

    fn sync(&self) {
        let _turn = self.turn.lock().unwrap_or_else(PoisonError::into_inner);
        let mut state = self.state();
        let files = std::mem::take(&mut state.waiting);
        if files.is_empty() {
            return;
        }
        let is_folder_changed = std::mem::take(&mut state.is_folder_changed);
        state.under_way = files.iter().map(|(_, frames)| frames).sum();
        drop(state);
        let is_folder_synced = !is_folder_changed || self.medium.sync_folder(&self.folder).is_ok();
        let mut failures = 0;
        for (file, frames) in files {
            if file.sync().is_err() || !is_folder_synced {
                failures += frames;
            }
        }
        let mut state = self.state();
        state.under_way = 0;
        state.failures += failures;
        state.has_failed |= failures > 0;
        state.is_folder_changed |= !is_folder_synced;
    }
}
