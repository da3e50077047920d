//! A progress line on stderr, shown if stderr is a terminal and the work takes more than a second.

use std::io::{IsTerminal, stderr};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::{JoinHandle, spawn};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Duration after which work shows its progress.
const PROGRESS_AFTER: Duration = Duration::from_secs(1);

/// Redraw interval; the line is redrawn even if nothing is counted, because a single step may take half a minute.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Progress of some work; the line is removed from the terminal when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    /// Thread that starts drawing after [`PROGRESS_AFTER`], if stderr is a terminal; it ends when its channel is
    /// closed.
    drawing: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Progress {
    /// Creates a counter of `unit`s, such as events, without a known total.
    #[must_use]
    pub fn new(unit: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template(&format!(
            "{{spinner}} {{human_pos}} {unit}, {{per_sec}}, {{elapsed}}"
        )) {
            bar.set_style(style);
        }
        let drawing = stderr().is_terminal().then(|| {
            let (end, ended) = channel();
            let bar = bar.clone();
            let thread = spawn(move || {
                if ended.recv_timeout(PROGRESS_AFTER) == Err(RecvTimeoutError::Timeout) {
                    bar.set_draw_target(ProgressDrawTarget::stderr());
                    bar.enable_steady_tick(DRAW_EVERY);
                }
            });
            (end, thread)
        });
        Self { bar, drawing }
    }

    /// Creates a progress bar of `unit`s, with the total set by [`Self::set_of`].
    #[must_use]
    pub fn bar(unit: &str) -> Self {
        let progress = Self::new(unit);
        if let Ok(style) = ProgressStyle::with_template(&format!(
            "{{bar:30}} {{human_pos}} of {{human_len}} {unit}, {{elapsed}}"
        )) {
            progress.bar.set_style(style);
        }
        progress
    }

    /// Reports that `count` of `total` units are done.
    pub fn set_of(&self, count: u64, total: u64) {
        self.bar.set_length(total);
        self.set(count);
    }

    /// Reports that `count` units are done in all.
    pub fn set(&self, count: u64) {
        self.bar.set_position(count);
    }

    /// Reports that `count` further units are done.
    pub fn advance(&self, count: u64) {
        self.set(self.bar.position() + count);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some((end, thread)) = self.drawing.take() {
            drop(end);
            // The thread only draws, so its result does not matter.
            let _ = thread.join();
        }
        self.bar.finish_and_clear();
    }
}
