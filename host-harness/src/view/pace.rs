//! When the next frame is due.

use std::time::{Duration, Instant};

/// Behind by more, the rest is shown later; by less, frames are left out.
const BEHIND_MAX: Duration = Duration::from_secs(1);

/// What becomes of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// It is shown after this time.
    After(Duration),
    /// It is left out: the one after it is due as well.
    Skip,
}

/// Frames at equal intervals, left out where showing them takes longer.
#[derive(Debug)]
pub struct Pace {
    interval: Duration,
    /// When the next frame is due; `None` before the first.
    due: Option<Instant>,
}

impl Pace {
    /// `fps` frames a second; 0 is taken as 1.
    #[must_use]
    pub fn new(fps: u32) -> Self {
        Self {
            interval: Duration::from_secs(1) / fps.max(1),
            due: None,
        }
    }

    /// The next frame's turn.
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
        // Due at 300 and at 400.
        assert_eq!(pace.turn(at(450)), Turn::Skip);
        assert_eq!(pace.turn(at(450)), after(0));
        // Due at 500: too late to catch up.
        assert_eq!(pace.turn(at(2_000)), after(0));
        assert_eq!(pace.turn(at(2_010)), after(90));
    }
}
