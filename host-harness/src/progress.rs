//! A progress line on stderr, for work over a second when stderr is a terminal.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Work that takes longer shows its progress.
const PROGRESS_AFTER: Duration = Duration::from_secs(1);

/// How far the work has come; gone from the terminal when dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    start: Instant,
}

impl Progress {
    /// Counts `unit`s, such as events.
    #[must_use]
    pub fn new(unit: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template(&format!(
            "{{spinner}} {{human_pos}} {unit}, {{per_sec}}, {{elapsed}}"
        )) {
            bar.set_style(style);
        }
        Self {
            bar,
            start: Instant::now(),
        }
    }

    /// Counts `unit`s of a number that [`Self::set_of`] tells.
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

    /// `count` units of `total` are done.
    pub fn set_of(&self, count: u64, total: u64) {
        self.bar.set_length(total);
        self.set(count);
    }

    /// `count` units are done in all.
    pub fn set(&self, count: u64) {
        // indicatif draws nothing where stderr is no terminal.
        if self.bar.is_hidden() && self.start.elapsed() > PROGRESS_AFTER {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
        }
        self.bar.set_position(count);
    }

    /// `count` further units are done.
    pub fn advance(&self, count: u64) {
        self.set(self.bar.position() + count);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
