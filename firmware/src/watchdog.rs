//! A watchdog that progress feeds: it restarts the board half a second after the last sign of it, however the program came
//! to a halt.

use core::cell::Cell;

use critical_section::Mutex;

use crate::{board, clock, receiving};

/// What had happened when the watchdog was fed last.
static SEEN: Mutex<Cell<Seen>> = Mutex::new(Cell::new(Seen {
    timer: 0,
    receiving: 0,
    #[cfg(feature = "sensor")]
    blocks: 0,
}));

/// Counts of what goes on happening on a board that works.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Seen {
    /// Interrupts of the timer.
    timer: u32,
    /// Runs of PendSV, which each of those triggers.
    receiving: u32,
    /// Blocks of a sensor, which sends empty ones when it sees nothing.
    #[cfg(feature = "sensor")]
    blocks: u32,
}

impl Seen {
    fn now() -> Self {
        Self {
            timer: clock::wraps(),
            receiving: receiving::runs(),
            #[cfg(feature = "sensor")]
            blocks: crate::sensor::transfers(),
        }
    }

    /// Whether everything that has to go on did since.
    const fn goes_on(self, since: Self) -> bool {
        #[cfg(feature = "sensor")]
        if self.blocks == since.blocks {
            return false;
        }
        self.timer != since.timer && self.receiving != since.receiving
    }
}

/// Feeds the watchdog, if the interrupts have done their work since the last time. Called by `main` alone, with every turn
/// of its loop in which it has work or nothing to do, and while it waits for the link, whose host may take its time.
pub fn feed() {
    let now = Seen::now();
    let goes_on = critical_section::with(|token| {
        let seen = SEEN.borrow(token);
        let goes_on = now.goes_on(seen.get());
        if goes_on {
            seen.set(now);
        }
        goes_on
    });
    if goes_on {
        board::feed_watchdog();
    }
}
