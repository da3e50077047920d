//! Finds the velocity of greatest contrast of a tile.

use super::contrast::{Image, Point, Velocity};
use super::{EVENTS_MIN, GAIN_MIN, PEAK_RADIUS_PX, PEAK_SHARE, SPEED_MAX_PX};

/// Step of the grid of velocities, in px per window.
const STEP_PX: u16 = 2;
/// Number of grid velocities along an axis.
const STEPS: u16 = 2 * (SPEED_MAX_PX / STEP_PX) + 1;
/// Largest number of events in the grid search; of more, every second, third, ... event is used.
const COARSE_EVENTS: usize = 4096;
/// Largest number of evaluations in the refinement.
const EVALUATIONS: usize = 80;
/// The refinement ends when its triangle is smaller than this, in px per window.
const RESOLUTION_PX: f32 = 0.005;

/// Finds velocities; keeps the images between calls.
#[derive(Debug, Clone)]
pub(super) struct Search {
    coarse: Image,
    fine: Image,
    /// Contrast of each velocity on the grid.
    looked: Vec<(Velocity, f32)>,
    sorted: Vec<f32>,
}

impl Search {
    pub(super) fn new() -> Self {
        Self {
            coarse: Image::coarse(),
            fine: Image::fine(),
            looked: Vec::new(),
            sorted: Vec::new(),
        }
    }

    /// Returns the velocity of a tile's events; `None` if the tile is not reliable, see [the module](super).
    pub(super) fn velocity(&mut self, points: &[Point]) -> Option<Velocity> {
        if points.len() < EVENTS_MIN {
            return None;
        }
        let stride = points.len().div_ceil(COARSE_EVENTS);
        self.looked.clear();
        for row in 0..STEPS {
            for column in 0..STEPS {
                let v = Velocity {
                    x: component(column),
                    y: component(row),
                };
                let contrast = self.coarse.contrast(points.iter().step_by(stride), v);
                self.looked.push((v, contrast));
            }
        }
        let best = self.reliable_peak()?;
        Some(self.refined(points, best))
    }

    /// Returns the best velocity on the grid, if it is distinct.
    fn reliable_peak(&mut self) -> Option<Velocity> {
        let mut looked = self.looked.iter();
        let (mut best, mut greatest) = *looked.next()?;
        for (v, contrast) in looked {
            if *contrast > greatest {
                (best, greatest) = (*v, *contrast);
            }
        }
        self.sorted.clear();
        self.sorted.extend(self.looked.iter().map(|(_, c)| *c));
        let middle = self.sorted.len() / 2;
        let (_, median, _) = self.sorted.select_nth_unstable_by(middle, f32::total_cmp);
        let level = *median + PEAK_SHARE * (greatest - *median);
        let is_alone = self
            .looked
            .iter()
            .filter(|(_, contrast)| *contrast >= level)
            .all(|(v, _)| (v.x - best.x).hypot(v.y - best.y) <= PEAK_RADIUS_PX);
        let is_inside = best.x.abs().max(best.y.abs()) < f32::from(SPEED_MAX_PX);
        (greatest >= GAIN_MIN * *median && is_alone && is_inside).then_some(best)
    }

    /// Returns the velocity of greatest contrast of the fine image near `start`, by the method of Nelder and Mead
    /// (1965).
    fn refined(&mut self, points: &[Point], start: Velocity) -> Velocity {
        let limit = f32::from(SPEED_MAX_PX);
        let mut evaluations = 0;
        let mut loss = |v: Velocity| {
            evaluations += 1;
            let is_inside = v.x.abs() <= limit && v.y.abs() <= limit;
            let loss = if is_inside {
                -self.fine.contrast(points, v)
            } else {
                f32::INFINITY
            };
            (evaluations, Corner { v, loss })
        };
        let half = f32::from(STEP_PX) / 2.0;
        let offsets = [(0.0, 0.0), (half, 0.0), (0.0, half)];
        let mut triangle = offsets.map(|(x, y)| loss(along(start, 1.0, Velocity { x, y })).1);
        loop {
            triangle.sort_by(|a, b| a.loss.total_cmp(&b.loss));
            let [best, good, worst] = triangle;
            let size = distance(best.v, good.v).max(distance(best.v, worst.v));
            let centre = along(best.v, 0.5, between(best.v, good.v));
            let away = between(worst.v, centre);
            let (evaluations, mirrored) = loss(along(centre, 1.0, away));
            if size < RESOLUTION_PX || evaluations > EVALUATIONS {
                return best.v;
            }
            let last = if mirrored.loss < best.loss {
                let (_, further) = loss(along(centre, 2.0, away));
                if further.loss < mirrored.loss {
                    further
                } else {
                    mirrored
                }
            } else if mirrored.loss < good.loss {
                mirrored
            } else {
                let is_outside = mirrored.loss < worst.loss;
                let (_, nearer) = loss(along(centre, if is_outside { 0.5 } else { -0.5 }, away));
                if nearer.loss < mirrored.loss.min(worst.loss) {
                    nearer
                } else {
                    let [good, worst] =
                        [good, worst].map(|c| loss(along(best.v, 0.5, between(best.v, c.v))).1);
                    triangle = [best, good, worst];
                    continue;
                }
            };
            triangle = [best, good, last];
        }
    }
}

/// A corner of the triangle; its loss is the negative contrast.
#[derive(Debug, Clone, Copy)]
struct Corner {
    v: Velocity,
    loss: f32,
}

fn component(step: u16) -> f32 {
    f32::from(step * STEP_PX) - f32::from(SPEED_MAX_PX)
}

fn between(from: Velocity, to: Velocity) -> Velocity {
    Velocity {
        x: to.x - from.x,
        y: to.y - from.y,
    }
}

/// Returns `from` + `share` * `way`.
fn along(from: Velocity, share: f32, way: Velocity) -> Velocity {
    Velocity {
        x: from.x + share * way.x,
        y: from.y + share * way.y,
    }
}

fn distance(a: Velocity, b: Velocity) -> f32 {
    (a.x - b.x).hypot(a.y - b.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::downstream::test_events::Random;

    /// Returns the events of a texture that moves by `v`; each dot fires `fires` times, in the pixel it is in.
    fn texture(v: Velocity, dots: usize, fires: usize) -> Vec<Point> {
        let mut random = Random::new(3);
        let mut points = Vec::new();
        for dot in 0..dots {
            let x = 64.0 * random.unit() as f32 - 16.0;
            let y = 64.0 * random.unit() as f32 - 16.0;
            for _ in 0..fires {
                let t = random.unit() as f32 - 0.5;
                let (x, y) = ((x + v.x * t).floor(), (y + v.y * t).floor());
                if (0.0..32.0).contains(&x) && (0.0..32.0).contains(&y) {
                    let p = if dot % 2 == 0 { 1.0 } else { -1.0 };
                    points.push(Point { x, y, t, p });
                }
            }
        }
        points
    }

    #[test]
    fn the_velocity_of_a_texture_is_found() {
        for (x, y) in [(0.0, 0.0), (6.3, -2.8), (-17.5, 9.1), (24.0, 20.0)] {
            let v = Velocity { x, y };
            let found = Search::new().velocity(&texture(v, 120, 12)).unwrap();
            // Positions are rounded to whole pixels.
            assert!(distance(found, v) < 0.5, "{v:?}: {found:?}");
        }
    }

    #[test]
    fn noise_a_straight_edge_and_equal_times_have_none() {
        let mut search = Search::new();
        let mut random = Random::new(4);
        for events in [64, 200, 1000, 8000] {
            let noise: Vec<Point> = (0..events)
                .map(|_| Point {
                    x: random.below(32) as f32,
                    y: random.below(32) as f32,
                    t: random.unit() as f32 - 0.5,
                    p: random.below(2) as f32 * 2.0 - 1.0,
                })
                .collect();
            assert_eq!(search.velocity(&noise), None, "{events}");
        }
        let edge: Vec<Point> = (0..32 * 20)
            .map(|i| {
                let t = (i / 32) as f32 / 20.0 - 0.5;
                Point {
                    x: (16.0 + 10.0 * t).floor(),
                    y: (i % 32) as f32,
                    t,
                    p: 1.0,
                }
            })
            .collect();
        assert_eq!(search.velocity(&edge), None);
        let moving = texture(Velocity { x: 9.0, y: 3.0 }, 120, 12);
        let mut collapsed = moving.clone();
        for point in &mut collapsed {
            point.t = 0.0;
        }
        assert!(search.velocity(&moving).is_some());
        assert_eq!(search.velocity(&collapsed), None);
        assert_eq!(search.velocity(&moving[..EVENTS_MIN - 1]), None);
        assert_eq!(search.velocity(&[]), None);
    }
}
