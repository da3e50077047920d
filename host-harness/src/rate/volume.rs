//! The signed box volume on which distortions are measured, and its normalised error.
//!
//! `V[w, y, x, b]` is the number of ON minus that of OFF events of pixel (x, y) in bin b of window w, i.e. with
//! times in `[t0 + w T + b T / B, t0 + w T + (b + 1) T / B)`; T = 32,768 us, B = 8, and t0 is the time of the
//! original's first event. The normalised error is `sum (V_decoded - V)^2 / sum V^2`.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Event, Sensor};

/// Number B of bins per window.
pub const BINS: usize = 8;

/// The grid of a recording's volumes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// Time t0 of the first event, in us.
    pub start_us: u64,
    /// Sensor of the recording.
    pub sensor: Sensor,
}

impl Grid {
    /// Returns the index of the cell for bin `bin` of pixel (x, y) in window `window`.
    #[must_use]
    pub fn cell(&self, window: u64, x: u16, y: u16, bin: usize) -> u64 {
        let Sensor { width, height } = self.sensor;
        let pixel = (window * u64::from(height) + u64::from(y)) * u64::from(width) + u64::from(x);
        pixel * BINS as u64 + bin as u64
    }

    /// Returns the window of a time, and the time since its start in us. A time before t0 counts as t0.
    #[must_use]
    pub fn window(&self, t_us: u64) -> (u64, u64) {
        let since_us = t_us.saturating_sub(self.start_us);
        let window_us = u64::from(WINDOW_US);
        (since_us / window_us, since_us % window_us)
    }

    /// Computes the volume of events.
    #[must_use]
    pub fn volume(&self, events: &[Event]) -> Volume {
        let cells = events.iter().map(|event| {
            let (window, since_us) = self.window(event.t_us);
            let bin = (since_us * BINS as u64 / u64::from(WINDOW_US)) as usize;
            let sign = f64::from(event.polarity.sign());
            (self.cell(window, event.x, event.y, bin), sign)
        });
        Volume::new(cells)
    }
}

/// The non-empty cells of a volume.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Index and value, in order of the index.
    cells: Vec<(u64, f64)>,
}

impl Volume {
    /// Sums the values per cell; cells may be repeated and in any order.
    #[must_use]
    pub fn new(cells: impl IntoIterator<Item = (u64, f64)>) -> Self {
        let mut cells: Vec<(u64, f64)> = cells.into_iter().collect();
        cells.sort_unstable_by_key(|(cell, _)| *cell);
        cells.dedup_by(|next, kept| {
            let is_same = next.0 == kept.0;
            if is_same {
                kept.1 += next.1;
            }
            is_same
        });
        Self { cells }
    }

    /// Returns the normalised error of `decoded`; `None` if this volume is 0 everywhere, which leaves nothing to
    /// relate it to.
    #[must_use]
    pub fn nmse(&self, decoded: &Self) -> Option<f64> {
        let (mut error, mut power) = (0.0, 0.0);
        let (mut a, mut b) = (
            self.cells.iter().peekable(),
            decoded.cells.iter().peekable(),
        );
        loop {
            let next = a.peek().map(|cell| cell.0);
            let next = next.into_iter().chain(b.peek().map(|cell| cell.0)).min();
            let Some(next) = next else {
                break;
            };
            let mine = a.next_if(|cell| cell.0 == next).map_or(0.0, |cell| cell.1);
            let other = b.next_if(|cell| cell.0 == next).map_or(0.0, |cell| cell.1);
            error += (mine - other) * (mine - other);
            power += mine * mine;
        }
        (power > 0.0).then(|| error / power)
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    const GRID: Grid = Grid {
        start_us: 1000,
        sensor: Sensor {
            width: 10,
            height: 7,
        },
    };

    #[test]
    fn a_cell_is_a_signed_count() {
        // Two in bin 0, one of each sign in bin 1, one in the next window.
        let events = [
            event(1000, 3, 2, true),
            event(5095, 3, 2, true),
            event(5096, 3, 2, true),
            event(9191, 3, 2, false),
            event(1000 + 32_768, 3, 2, false),
        ];
        let expected = [
            (GRID.cell(0, 3, 2, 0), 2.0),
            (GRID.cell(0, 3, 2, 1), 0.0),
            (GRID.cell(1, 3, 2, 0), -1.0),
        ];
        assert_eq!(GRID.volume(&events).cells, expected);
        assert_eq!(GRID.cell(0, 3, 2, 1), 8 * 23 + 1);
        assert_eq!(GRID.cell(2, 9, 6, 7), 8 * 3 * 70 - 1);
        assert_eq!(GRID.window(999), (0, 0));
    }

    #[test]
    fn the_error_is_relative_to_the_volumes_power() {
        let volume = Volume::new([(5, 2.0), (9, -1.0)]);
        assert_eq!(volume.nmse(&volume), Some(0.0));
        assert_eq!(volume.nmse(&Volume::new([])), Some(1.0));
        // (2 - 1)^2 + (-1)^2 + 3^2 over 5.
        assert_eq!(volume.nmse(&Volume::new([(7, 3.0), (5, 1.0)])), Some(2.2));
        assert_eq!(Volume::new([(1, 0.0)]).nmse(&volume), None);
    }
}
