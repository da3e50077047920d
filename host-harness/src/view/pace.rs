//! Decides when the next frame is due.

use std::time::{Duration, Instant};

/// If playback lags by more, the remaining frames are delayed; if by less, frames are skipped.
const BEHIND_MAX: Duration = Duration::from_secs(1);

/// What to do with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Show it after this time.
    After(Duration),
    /// Skip it: the next frame is due already.
    Skip,
}

/// Paces frames at equal intervals, and skips some if showing them takes longer.
#[derive(Debug)]
pub struct Pace {
    interval: Duration,
    /// Time at which the next frame is due; `None` before the first.
    due: Option<Instant>,
}

impl Pace {
    /// Paces `fps` frames per second; 0 is taken as 1.
    #[must_use]
    pub fn new(fps: u32) -> Self {
        Self {
            interval: Duration::from_secs(1) / fps.max(1),
            due: None,
        }
    }

    /// Begins anew: the next frame is due when it comes.
    pub const fn restart(&mut self) {
        self.due = None;
    }

    /// Decides on the next frame at time `now`.
    pub fn turn(&mut self, now: Instant) -> Turn {
        let due = match self.due {
            Some(due) if now.saturating_duration_since(due) <= BEHIND_MAX => due,
            _ => now,
        };
        self.due = Some(due + self.interval);
        if now.saturating_duration_since(due) >= self.interval {
            return Turn::Skip;
        }
        Turn::After(due.saturating_duration_since(now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_due_at_equal_intervals() {
        let mut pace = Pace::new(10);
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let after = |ms| Turn::After(Duration::from_millis(ms));
        assert_eq!(pace.turn(at(0)), after(0));
        assert_eq!(pace.turn(at(30)), after(70));
        assert_eq!(pace.turn(at(250)), after(0));
        // The frames due at 300 and at 400.
        assert_eq!(pace.turn(at(450)), Turn::Skip);
        assert_eq!(pace.turn(at(450)), after(0));
        // The frame due at 500 is too late to catch up.
        assert_eq!(pace.turn(at(2_000)), after(0));
        assert_eq!(pace.turn(at(2_010)), after(90));
    }
}
