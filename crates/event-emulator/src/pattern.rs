//! Everything that moves or flickers: the camera, boxes that travel or turn, lamps.
//!
//! Positions and sizes of single objects are fractions of the sensor's width and height, so that a scene keeps its
//! event density on any sensor. The camera moves in pixels.

use event_types::Sensor;

/// One turn in radians.
const TURN: f64 = core::f64::consts::TAU;

/// Number of depth layers of the background, stacked from top to bottom.
const LAYERS: u32 = 6;

/// Movement of the camera, in pixels of the background.
#[derive(Debug, Clone, Copy)]
pub(super) struct Camera {
    /// Mean velocity in pixels per second.
    pub(super) drift: (f64, f64),
    /// Amplitude of the velocity's oscillation about its mean: 0 for a steady velocity, 1 to slow down to rest.
    pub(super) pulse: f64,
    /// Frequency of that oscillation in Hz.
    pub(super) pulse_hz: f64,
    /// Two sways, each with horizontal and vertical amplitude in pixels and a frequency in Hz.
    pub(super) sway: [(f64, f64, f64); 2],
    /// Difference in horizontal speed between the lower and the upper edge, relative to the middle: near ground
    /// passes faster than the sky.
    pub(super) parallax: f64,
}

impl Camera {
    /// A camera on a tripod.
    pub(super) const STATIC: Self = Self {
        drift: (0.0, 0.0),
        pulse: 0.0,
        pulse_hz: 0.0,
        sway: [(0.0, 0.0, 0.0); 2],
        parallax: 0.0,
    };

    /// Returns whether the background ever moves.
    pub(super) fn moves(&self) -> bool {
        let sways = self.sway.iter().any(|(x, y, _)| *x != 0.0 || *y != 0.0);
        self.drift != (0.0, 0.0) || sways
    }

    /// Returns the position of the sensor's upper left corner on the background after `t` seconds.
    pub(super) fn offset(&self, t: f64) -> (f64, f64) {
        // Oscillating part of the integral of 1 + pulse * sin(turn * t).
        let swing = if self.pulse_hz > 0.0 {
            let turn = TURN * self.pulse_hz;
            self.pulse / turn * (1.0 - libm::cos(turn * t))
        } else {
            0.0
        };
        let way = t + swing;
        let (mut x, mut y) = (self.drift.0 * way, self.drift.1 * way);
        for (i, (along, across, hz)) in self.sway.iter().enumerate() {
            let angle = TURN * hz * t + i as f64;
            x += along * libm::sin(angle);
            y += across * libm::cos(angle);
        }
        (x, y)
    }

    /// Returns the horizontal speed of a row relative to the middle.
    ///
    /// Rows move in [`LAYERS`] bands: within a band the picture stays rigid however long the scene lasts, whereas a
    /// speed per row would shear it more and more.
    pub(super) fn row_speed(&self, y: u16, height: u16) -> f64 {
        let layer = u32::from(y) * LAYERS / u32::from(height.max(1));
        let middle = (f64::from(layer) + 0.5) / f64::from(LAYERS);
        1.0 + self.parallax * (middle - 0.5)
    }
}

/// An object in front of the background; it adds to the log intensity.
#[derive(Debug, Clone, Copy)]
pub(super) enum Pattern {
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
pub(super) struct Placed {
    /// Columns `x.0..x.1` and rows `y.0..y.1` that the pattern touches.
    x: (u16, u16),
    y: (u16, u16),
    shape: Shape,
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
    pub(super) fn place(&self, t: f64, sensor: Sensor) -> Option<Placed> {
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

    /// Returns whether the light may change from one step to the next.
    pub(super) fn changes(&self) -> bool {
        match *self {
            Self::Box {
                velocity, spin_hz, ..
            } => velocity != (0.0, 0.0) || spin_hz != 0.0,
            Self::Flicker { .. } => true,
        }
    }
}

impl Placed {
    fn visible(self) -> Option<Self> {
        (self.x.0 < self.x.1 && self.y.0 < self.y.1).then_some(self)
    }

    /// Returns the blocks of `block` pixels that the pattern touches: range of rows, and range of blocks in a row.
    pub(super) fn blocks(
        &self,
        block: usize,
    ) -> (core::ops::Range<usize>, core::ops::Range<usize>) {
        let rows = usize::from(self.y.0)..usize::from(self.y.1);
        let across = usize::from(self.x.0) / block..usize::from(self.x.1).div_ceil(block);
        (rows, across)
    }

    /// Adds the pattern to the log intensity of the pixels (x + i, y).
    pub(super) fn add(&self, y: u16, x: u16, light: &mut [f32]) {
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
    fn camera_offset_is_the_integral_of_its_velocity() {
        let camera = Camera {
            drift: (40.0, -10.0),
            pulse: 1.0,
            pulse_hz: 2.0,
            ..Camera::STATIC
        };
        // After whole oscillations only the mean velocity counts.
        let (x, y) = camera.offset(1.5);
        assert!(
            (x - 60.0).abs() < 1e-9 && (y + 15.0).abs() < 1e-9,
            "{x} {y}"
        );
        // The velocity is 0 at three quarters of an oscillation.
        let slow = camera.offset(0.376).0 - camera.offset(0.374).0;
        assert!(slow.abs() < 1e-3, "{slow}");
        assert!(!Camera::STATIC.moves() && camera.moves());
    }

    #[test]
    fn near_ground_is_faster_and_layers_are_rigid() {
        let camera = Camera {
            parallax: 1.2,
            ..Camera::STATIC
        };
        let speeds: Vec<f64> = (0..60).map(|y| camera.row_speed(y, 60)).collect();
        assert!(speeds.is_sorted());
        assert_eq!(speeds.chunk_by(|a, b| a == b).count(), 6);
        assert!((speeds[0] - 0.5).abs() < 1e-9 && (speeds[59] - 1.5).abs() < 1e-9);
        assert!((camera.row_speed(0, 1) - 0.5).abs() < 1e-9);
    }

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
