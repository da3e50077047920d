//! The light of a video: lines of ln E from frame to frame.

pub(crate) mod exposure;
pub(crate) mod motion;

use event_types::Sensor;

use super::{Light, Tile};

/// Columns of a piece of a row whose greatest change is known.
const PIECE: usize = 64;

/// The light between two frames of a video; frames are added as time goes on.
#[derive(Debug, Clone)]
pub struct VideoLight {
    sensor: Sensor,
    /// Light at the earlier frame and at the later one, in ln lux.
    before: Vec<f32>,
    after: Vec<f32>,
    /// Times of these frames.
    from_ns: u64,
    to_ns: u64,
    /// The greatest change of each piece of each row, in ln lux.
    changes: Vec<f32>,
}

impl VideoLight {
    /// Begins with a frame at time 0, of one value in ln lux for each pixel. A further frame has to be added before the
    /// light is used.
    pub(crate) fn new(sensor: Sensor, first: Vec<f32>) -> Self {
        let pieces = usize::from(sensor.width).div_ceil(PIECE) * usize::from(sensor.height);
        Self {
            sensor,
            before: first.clone(),
            after: first,
            from_ns: 0,
            to_ns: 0,
            changes: vec![0.0; pieces],
        }
    }

    /// Goes on to the time from the latest frame to a further one, which is later; `frame` gets the memory of one that
    /// is no longer needed.
    pub(crate) fn push(&mut self, frame: &mut Vec<f32>, at_ns: u64) {
        core::mem::swap(&mut self.before, &mut self.after);
        core::mem::swap(&mut self.after, frame);
        self.from_ns = self.to_ns;
        self.to_ns = at_ns;
        let width = usize::from(self.sensor.width);
        let rows = self.before.chunks(width).zip(self.after.chunks(width));
        let pieces = rows.flat_map(|(before, after)| before.chunks(PIECE).zip(after.chunks(PIECE)));
        for (change, (before, after)) in self.changes.iter_mut().zip(pieces) {
            *change = greatest_change(before, after);
        }
    }

    /// Returns the earlier and the later frame.
    pub(crate) fn frames(&self) -> (&[f32], &[f32]) {
        (&self.before, &self.after)
    }

    /// Returns the part of a row of a frame that belongs to a tile.
    fn part<'f>(&self, frame: &'f [f32], tile: Tile, y: u16) -> &'f [f32] {
        let start = usize::from(y) * usize::from(self.sensor.width) + usize::from(tile.x);
        frame
            .get(start..start + usize::from(tile.width))
            .unwrap_or_default()
    }
}

/// Returns the greatest difference between two rows.
fn greatest_change(before: &[f32], after: &[f32]) -> f32 {
    let differences = before.iter().zip(after).map(|(b, a)| (a - b).abs());
    differences.fold(
        0.0,
        |most, change| if change > most { change } else { most },
    )
}

impl Light for VideoLight {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn sample(&self, tile: Tile, t_ns: u64, ln_lux: &mut [f32]) {
        let width = usize::from(tile.width);
        let rows = (tile.y..tile.y + tile.height).zip(ln_lux.chunks_mut(width));
        if t_ns >= self.to_ns {
            for (y, row) in rows {
                row.copy_from_slice(self.part(&self.after, tile, y));
            }
            return;
        }
        let since = t_ns.saturating_sub(self.from_ns) as f64;
        let share = (since / (self.to_ns - self.from_ns) as f64) as f32;
        for (y, row) in rows {
            let (before, after) = (
                self.part(&self.before, tile, y),
                self.part(&self.after, tile, y),
            );
            for ((value, b), a) in row.iter_mut().zip(before).zip(after) {
                *value = b + (a - b) * share;
            }
        }
    }

    fn rate_bound(&self, tile: Tile, _: u64, _: u64) -> f64 {
        let pieces = usize::from(self.sensor.width).div_ceil(PIECE);
        let first = usize::from(tile.x) / PIECE;
        let last = (usize::from(tile.x) + usize::from(tile.width) - 1) / PIECE;
        let mut most = 0.0_f32;
        for y in usize::from(tile.y)..usize::from(tile.y) + usize::from(tile.height) {
            let row = self.changes.get(y * pieces + first..=y * pieces + last);
            most = row.unwrap_or_default().iter().fold(most, |a, b| a.max(*b));
        }
        let seconds = self.to_ns.saturating_sub(self.from_ns).max(1) as f64 * 1e-9;
        f64::from(most) / seconds
    }

    fn next_switch_ns(&self, _: Tile, _: u64) -> u64 {
        u64::MAX
    }

    fn next_bend_ns(&self, _: Tile, after_ns: u64) -> u64 {
        if after_ns < self.to_ns {
            self.to_ns
        } else {
            u64::MAX
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 130,
        height: 3,
    };

    const TILE: Tile = Tile {
        x: 60,
        y: 1,
        width: 70,
        height: 2,
    };

    #[test]
    fn light_is_a_line_from_frame_to_frame_and_its_bound_is_the_steepest() {
        let frame = |of: fn(usize) -> f32| (0..390).map(of).collect::<Vec<f32>>();
        let mut light = VideoLight::new(SENSOR, frame(|i| i as f32));
        let mut next = frame(|i| i as f32 + if i == 389 { 3.0 } else { 0.5 });
        light.push(&mut next, 2_000_000);
        assert_eq!(light.next_bend_ns(TILE, 0), 2_000_000);
        assert_eq!(light.next_bend_ns(TILE, 2_000_000), u64::MAX);
        let mut values = vec![0.0; 140];
        for (t_ns, share) in [(0, 0.0), (500_000, 0.25), (2_000_000, 1.0)] {
            light.sample(TILE, t_ns, &mut values);
            assert_eq!(values[0], 190.0 + 0.5 * share);
            assert_eq!(values[69], 259.0 + 0.5 * share);
            assert_eq!(values[139], 389.0 + 3.0 * share);
        }
        assert_eq!(light.rate_bound(TILE, 0, 1), 1_500.0);
        let upper = Tile { height: 1, ..TILE };
        assert_eq!(light.rate_bound(upper, 0, 1), 250.0);
        // The next frame is the same: nothing changes.
        let mut same = light.frames().1.to_vec();
        light.push(&mut same, 5_000_000);
        assert_eq!(light.rate_bound(TILE, 0, 1), 0.0);
        light.sample(TILE, 3_000_000, &mut values);
        assert_eq!(values[139], 392.0);
    }
}
