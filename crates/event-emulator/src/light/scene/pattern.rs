//! Objects that move or flicker: boxes that travel or turn, lamps.
//!
//! Positions and sizes are fractions of the sensor's width and height, so that a scene keeps its event density on any
//! sensor.

use event_types::Sensor;

use crate::light::Tile;

/// One turn in radians.
const TURN: f64 = core::f64::consts::TAU;

/// An object in front of the background; it adds to the log intensity.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Pattern {
    /// A box with soft edges that may travel and turn: a bar, a person, a drone, its rotor.
    Box {
        /// Position of the centre at the start, as fractions of width and height.
        start: (f64, f64),
        /// Velocity in widths and heights per second.
        velocity: (f64, f64),
        /// Length of a lap in widths (and heights), after which the box reappears; if above 1, it is out of sight for
        /// a while.
        lap: f64,
        /// Half length and half width, as fractions of the height.
        half: (f64, f64),
        /// Turns per second.
        spin_hz: f64,
        /// Log intensity added inside.
        gain: f32,
    },
    /// A lamp or a lit part of the scene that flickers.
    Flicker {
        /// Left, top, right, bottom as fractions of width and height.
        area: (f64, f64, f64, f64),
        /// Cycles per second.
        hz: f64,
        /// Difference in log intensity between brightest and darkest.
        depth: f32,
        /// Square wave (LED) instead of a sine (mains).
        square: bool,
        /// Share of each second during which the modulation pauses.
        rest: f64,
    },
}

/// A pattern at one moment, in pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placed {
    /// Columns `x.0..x.1` and rows `y.0..y.1` that the pattern touches.
    x: (u16, u16),
    y: (u16, u16),
    shape: Shape,
}

/// How a rigid object moves in the picture at one moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    /// The point that it turns about, in pixels.
    centre: (f64, f64),
    /// Velocity of that point in pixels per second.
    velocity: (f64, f64),
    /// Angular velocity in radians per second, from the x axis to the y axis.
    spin: f64,
}

#[derive(Debug, Clone, Copy)]
enum Shape {
    Box {
        centre: (f32, f32),
        half: (f32, f32),
        direction: (f32, f32),
        gain: f32,
    },
    Even(f32),
}

impl Pattern {
    /// Returns the pattern after `t` seconds; `None` if it is out of sight.
    pub(crate) fn place(&self, t: f64, sensor: Sensor) -> Option<Placed> {
        let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
        match *self {
            Self::Box {
                start,
                velocity,
                lap,
                half,
                spin_hz,
                gain,
            } => {
                let centre = (
                    along(start.0, velocity.0, lap, t) * width,
                    along(start.1, velocity.1, lap, t) * height,
                );
                let half = (half.0 * height, half.1 * height);
                let turn = TURN * (spin_hz * t - libm::floor(spin_hz * t));
                let direction = (libm::cos(turn), libm::sin(turn));
                // Half extents of the bounding rectangle of the turned box with its soft edge.
                let (c, s) = (libm::fabs(direction.0), libm::fabs(direction.1));
                let reach_x = half.0 * c + half.1 * s + 2.0;
                let reach_y = half.0 * s + half.1 * c + 2.0;
                let placed = Placed {
                    x: clip(centre.0 - reach_x, centre.0 + reach_x, sensor.width),
                    y: clip(centre.1 - reach_y, centre.1 + reach_y, sensor.height),
                    shape: Shape::Box {
                        centre: (centre.0 as f32, centre.1 as f32),
                        half: (half.0 as f32, half.1 as f32),
                        direction: (direction.0 as f32, direction.1 as f32),
                        gain,
                    },
                };
                placed.visible()
            }
            Self::Flicker {
                area,
                hz,
                depth,
                square,
                rest,
            } => {
                let phase = hz * t - libm::floor(hz * t);
                let second = t - libm::floor(t);
                let wave = if second < rest {
                    0.0
                } else if square {
                    if phase < 0.5 { 0.5 } else { -0.5 }
                } else {
                    0.5 * libm::sin(TURN * phase)
                };
                let placed = Placed {
                    x: clip(area.0 * width, area.2 * width, sensor.width),
                    y: clip(area.1 * height, area.3 * height, sensor.height),
                    shape: Shape::Even(depth * wave as f32),
                };
                placed.visible()
            }
        }
    }

    /// As [`Self::place`], at a time in ns: lamps switch at whole nanoseconds, exactly.
    pub(crate) fn place_at(&self, t_ns: u64, sensor: Sensor) -> Option<Placed> {
        let placed = self.place(t_ns as f64 * 1e-9, sensor)?;
        let Self::Flicker {
            hz, depth, rest, ..
        } = *self
        else {
            return Some(placed);
        };
        let wave = if is_resting(t_ns, rest) {
            0.0
        } else if self.is_square() {
            match half_cycle(t_ns, hz) % 2 {
                0 => 0.5,
                _ => -0.5,
            }
        } else {
            let cycles = hz * (t_ns as f64 * 1e-9);
            0.5 * libm::sin(TURN * (cycles - libm::floor(cycles)))
        };
        let shape = Shape::Even(depth * wave as f32);
        Some(Placed { shape, ..placed })
    }

    /// Returns how the object moves after `t` seconds; a lamp stays where it is in the picture.
    pub(crate) fn motion(&self, t: f64, sensor: Sensor) -> Motion {
        let (velocity, spin_hz) = match *self {
            Self::Box {
                velocity, spin_hz, ..
            } => (velocity, spin_hz),
            Self::Flicker { .. } => ((0.0, 0.0), 0.0),
        };
        Motion {
            centre: self.centre(t, sensor),
            velocity: (
                velocity.0 * f64::from(sensor.width),
                velocity.1 * f64::from(sensor.height),
            ),
            spin: TURN * spin_hz,
        }
    }

    fn is_square(&self) -> bool {
        matches!(self, Self::Flicker { square: true, .. })
    }

    /// Returns a bound of the rate of change of the log intensity, in 1/s, that the pattern causes in a tile between
    /// two times in ns, switches left out.
    pub(crate) fn rate_bound(
        &self,
        tile: Tile,
        (from_ns, to_ns): (u64, u64),
        sensor: Sensor,
    ) -> f64 {
        let from = t_s(from_ns);
        match *self {
            Self::Box {
                velocity,
                half,
                spin_hz,
                gain,
                ..
            } => {
                if !self.changes() {
                    return 0.0;
                }
                let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
                let reach = (half.0 + half.1) * height + 2.0;
                let travel = libm::fabs(velocity.0) * width + libm::fabs(velocity.1) * height;
                let speed = travel + TURN * libm::fabs(spin_hz) * reach;
                // Where the box may be: around the places at both ends, as far as it may come in between.
                let around = reach + speed * (t_s(to_ns) - from);
                let way = speed * (t_s(to_ns) - from);
                let is_near = [from_ns, to_ns].into_iter().any(|t_ns| {
                    let (x, y) = self.centre(t_s(t_ns), sensor);
                    tile.touches(
                        clip(x - around, x + around, sensor.width),
                        clip(y - around, y + around, sensor.height),
                    )
                }) && self.comes_near(tile, from, way, sensor);
                // The edges in both directions are 1.5 pixels wide: the gain's share is l w / 2.25, with l and w up
                // to 1.5 that change with the speed at most, and both at once by its square root of 2.
                if is_near {
                    core::f64::consts::SQRT_2 / 1.5 * speed * f64::from(gain.abs())
                } else {
                    0.0
                }
            }
            Self::Flicker {
                hz, depth, rest, ..
            } => {
                let rests = is_resting(from_ns, rest) && to_ns <= self.next_edge_ns(from_ns);
                if self.is_square() || rests || !self.is_in(tile, sensor) {
                    0.0
                } else {
                    0.5 * TURN * hz * f64::from(depth.abs())
                }
            }
        }
    }

    /// Returns the first time after `after_ns` at which the pattern makes the light of a tile jump, or `u64::MAX`.
    pub(crate) fn next_switch_ns(&self, tile: Tile, after_ns: u64, sensor: Sensor) -> u64 {
        match self {
            Self::Flicker { .. } if self.is_in(tile, sensor) => self.next_edge_ns(after_ns),
            _ => u64::MAX,
        }
    }

    /// Returns the first time after `after_ns` at which a lamp switches or its rest begins or ends, or `u64::MAX`.
    fn next_edge_ns(&self, after_ns: u64) -> u64 {
        let Self::Flicker {
            hz, square, rest, ..
        } = *self
        else {
            return u64::MAX;
        };
        let second = after_ns / SECOND_NS * SECOND_NS;
        if is_resting(after_ns, rest) {
            return second + rest_ns(rest);
        }
        let next_second = if rest > 0.0 {
            second.saturating_add(SECOND_NS)
        } else {
            u64::MAX
        };
        let next_half = if square {
            half_begin_ns(half_cycle(after_ns, hz) + 1, hz)
        } else {
            u64::MAX
        };
        next_second.min(next_half)
    }

    /// Returns whether a lamp lights a pixel of the tile.
    fn is_in(&self, tile: Tile, sensor: Sensor) -> bool {
        let placed = self.place(0.0, sensor);
        placed.is_some_and(|placed| tile.touches(placed.x, placed.y))
    }

    /// Returns whether a box that turns at `t` seconds, and any point of which moves by `way` pixels at most, may touch
    /// a tile: its sides keep them apart otherwise.
    fn comes_near(&self, tile: Tile, t: f64, way: f64, sensor: Sensor) -> bool {
        let Self::Box {
            half,
            spin_hz,
            velocity,
            ..
        } = *self
        else {
            return true;
        };
        if velocity != (0.0, 0.0) {
            // Where it reappears, it is not near where it was.
            return true;
        }
        let (x, y) = self.centre(t, sensor);
        let (width, height) = (0.5 * f64::from(tile.width), 0.5 * f64::from(tile.height));
        let (dx, dy) = (
            f64::from(tile.x) + width - x,
            f64::from(tile.y) + height - y,
        );
        let turn = TURN * (spin_hz * t - libm::floor(spin_hz * t));
        let (c, s) = (libm::cos(turn), libm::sin(turn));
        let (along, across) = (libm::fabs(dx * c + dy * s), libm::fabs(dy * c - dx * s));
        let (c, s) = (libm::fabs(c), libm::fabs(s));
        let side = f64::from(sensor.height);
        along <= half.0 * side + width * c + height * s + way + 2.0
            && across <= half.1 * side + width * s + height * c + way + 2.0
    }

    /// Returns the centre of a box after `t` seconds, in pixels.
    fn centre(&self, t: f64, sensor: Sensor) -> (f64, f64) {
        match *self {
            Self::Box {
                start,
                velocity,
                lap,
                ..
            } => (
                along(start.0, velocity.0, lap, t) * f64::from(sensor.width),
                along(start.1, velocity.1, lap, t) * f64::from(sensor.height),
            ),
            Self::Flicker { .. } => (0.0, 0.0),
        }
    }

    /// Returns whether the light may change from one step to the next.
    pub(crate) fn changes(&self) -> bool {
        match *self {
            Self::Box {
                velocity, spin_hz, ..
            } => velocity != (0.0, 0.0) || spin_hz != 0.0,
            Self::Flicker { .. } => true,
        }
    }
}

impl Motion {
    /// Returns the velocity of the object's point at the centre of pixel (x, y), in pixels per second.
    pub(crate) fn at(&self, x: u16, y: u16) -> [f32; 2] {
        let (dx, dy) = (f64::from(x) - self.centre.0, f64::from(y) - self.centre.1);
        [
            (self.velocity.0 - self.spin * dy) as f32,
            (self.velocity.1 + self.spin * dx) as f32,
        ]
    }
}

impl Placed {
    /// Returns the pixels whose centres lie in the object, edges included, row by row: in the middle of its soft edge, a
    /// box gives half of its light.
    pub(crate) fn pixels(&self) -> impl Iterator<Item = (u16, u16)> {
        let Self { x, y, shape } = *self;
        let all = (y.0..y.1).flat_map(move |y| (x.0..x.1).map(move |x| (x, y)));
        all.filter(move |(x, y)| match shape {
            Shape::Even(_) => true,
            Shape::Box {
                centre,
                half,
                direction: (c, s),
                ..
            } => {
                let (dx, dy) = (f32::from(*x) - centre.0, f32::from(*y) - centre.1);
                (dx * c + dy * s).abs() <= half.0 && (dy * c - dx * s).abs() <= half.1
            }
        })
    }

    fn visible(self) -> Option<Self> {
        (self.x.0 < self.x.1 && self.y.0 < self.y.1).then_some(self)
    }

    /// Returns the blocks of `block` pixels that the pattern touches: range of rows, and range of blocks in a row.
    pub(crate) fn blocks(
        &self,
        block: usize,
    ) -> (core::ops::Range<usize>, core::ops::Range<usize>) {
        let rows = usize::from(self.y.0)..usize::from(self.y.1);
        let across = usize::from(self.x.0) / block..usize::from(self.x.1).div_ceil(block);
        (rows, across)
    }

    /// Adds the pattern to the log intensity of the pixels (x + i, y).
    pub(crate) fn add(&self, y: u16, x: u16, light: &mut [f32]) {
        if y < self.y.0 || y >= self.y.1 {
            return;
        }
        let first = usize::from(self.x.0.saturating_sub(x));
        let last = usize::from(self.x.1.saturating_sub(x)).min(light.len());
        let Some(part) = light.get_mut(first..last) else {
            return;
        };
        match self.shape {
            Shape::Even(gain) => {
                for log in part {
                    *log += gain;
                }
            }
            Shape::Box {
                centre,
                half,
                direction: (c, s),
                gain,
            } => {
                let dy = f32::from(y) - centre.1;
                let dx0 = f32::from(x) - centre.0;
                for (i, log) in part.iter_mut().enumerate() {
                    let dx = dx0 + (first + i) as f32;
                    let length = (half.0 + 0.75 - (dx * c + dy * s).abs()).clamp(0.0, 1.5);
                    let width = (half.1 + 0.75 - (dy * c - dx * s).abs()).clamp(0.0, 1.5);
                    // Edges are 1.5 pixels wide, as imaged by a lens.
                    *log += gain * (length * width) * (1.0 / 2.25);
                }
            }
        }
    }
}

/// One second in ns.
const SECOND_NS: u64 = 1_000_000_000;

fn t_s(t_ns: u64) -> f64 {
    t_ns as f64 * 1e-9
}

/// Returns the duration of a lamp's rest in ns, of a rest in seconds.
fn rest_ns(rest: f64) -> u64 {
    libm::ceil(rest.clamp(0.0, 1.0) * SECOND_NS as f64) as u64
}

/// Returns whether a lamp rests: it does so at the beginning of each second.
fn is_resting(t_ns: u64, rest: f64) -> bool {
    t_ns % SECOND_NS < rest_ns(rest)
}

/// Returns the number of the half cycle at `t_ns`; half cycle 0 begins at 0.
fn half_cycle(t_ns: u64, hz: f64) -> u64 {
    let mut half = (t_s(t_ns) * 2.0 * hz) as u64;
    // The product may be rounded across a beginning; the beginnings themselves decide.
    while half > 0 && half_begin_ns(half, hz) > t_ns {
        half -= 1;
    }
    while half_begin_ns(half + 1, hz) <= t_ns {
        half += 1;
    }
    half
}

/// Returns the time at which a half cycle begins.
fn half_begin_ns(half: u64, hz: f64) -> u64 {
    libm::ceil(half as f64 * (0.5 * SECOND_NS as f64 / hz)) as u64
}

/// Returns the coordinate of an object that starts at `start` and reappears after each lap; laps are centred on the
/// sensor.
fn along(start: f64, velocity: f64, lap: f64, t: f64) -> f64 {
    if velocity == 0.0 {
        return start;
    }
    let before = 0.5 * (lap - 1.0);
    let way = start + velocity * t + before;
    way - libm::floor(way / lap) * lap - before
}

/// Returns the range of whole pixels in 0..side that covers an interval.
fn clip(from: f64, to: f64, side: u16) -> (u16, u16) {
    let side_f = f64::from(side);
    (
        libm::floor(from).clamp(0.0, side_f) as u16,
        libm::ceil(to).clamp(0.0, side_f) as u16,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 100,
        height: 50,
    };

    #[test]
    fn box_covers_its_area_and_nothing_outside_of_its_bounds() {
        for spin_hz in [0.0, 0.125, 0.31] {
            let bar = Pattern::Box {
                start: (0.5, 0.5),
                velocity: (0.0, 0.0),
                lap: 1.0,
                half: (0.3, 0.1),
                spin_hz,
                gain: 2.0,
            };
            let placed = bar.place(1.0, SENSOR).unwrap();
            let mut sum = 0.0;
            for y in 0..SENSOR.height {
                let mut light = [0.0; 100];
                placed.add(y, 0, &mut light);
                sum += light.iter().sum::<f32>();
                // A piece of the row gets the same light as the whole row.
                let mut piece = [0.0; 30];
                placed.add(y, 40, &mut piece);
                assert_eq!(piece, light[40..70]);
            }
            // 30 x 10 pixels with gain 2.
            assert!((sum - 600.0).abs() < 12.0, "spin {spin_hz}: {sum}");
        }
    }

    #[test]
    fn travelling_box_leaves_and_returns() {
        let ball = Pattern::Box {
            start: (0.5, 0.5),
            velocity: (1.0, 0.0),
            lap: 2.0,
            half: (0.1, 0.1),
            spin_hz: 0.0,
            gain: 1.0,
        };
        assert!(ball.place(0.0, SENSOR).is_some());
        assert!(ball.place(0.9, SENSOR).is_none());
        assert!(ball.place(2.0, SENSOR).is_some());
        assert!(ball.place(1e300, SENSOR).is_none_or(|p| p.x.1 <= 100));
    }
}
