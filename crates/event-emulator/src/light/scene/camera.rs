//! The movement of the camera, in pixels of the background.

/// One turn in radians.
const TURN: f64 = core::f64::consts::TAU;

/// Number of depth layers of the background, stacked from top to bottom.
const LAYERS: u32 = 6;

/// Movement of the camera, in pixels of the background.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Camera {
    /// Mean velocity in pixels per second.
    pub(crate) drift: (f64, f64),
    /// Amplitude of the velocity's oscillation about its mean: 0 for a steady velocity, 1 to slow down to rest.
    pub(crate) pulse: f64,
    /// Frequency of that oscillation in Hz.
    pub(crate) pulse_hz: f64,
    /// Two sways, each with horizontal and vertical amplitude in pixels and a frequency in Hz.
    pub(crate) sway: [(f64, f64, f64); 2],
    /// Difference in horizontal speed between the lower and the upper edge, relative to the middle: near ground
    /// passes faster than the sky.
    pub(crate) parallax: f64,
}

impl Camera {
    /// A camera on a tripod.
    pub(crate) const STATIC: Self = Self {
        drift: (0.0, 0.0),
        pulse: 0.0,
        pulse_hz: 0.0,
        sway: [(0.0, 0.0, 0.0); 2],
        parallax: 0.0,
    };

    /// Returns whether the background ever moves.
    pub(crate) fn moves(&self) -> bool {
        let sways = self.sway.iter().any(|(x, y, _)| *x != 0.0 || *y != 0.0);
        self.drift != (0.0, 0.0) || sways
    }

    /// Returns the position of the sensor's upper left corner on the background after `t` seconds.
    pub(crate) fn offset(&self, t: f64) -> (f64, f64) {
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

    /// Returns the velocity of [`Self::offset`] after `t` seconds, in pixels per second.
    pub(crate) fn velocity(&self, t: f64) -> (f64, f64) {
        let pace = 1.0 + self.pulse * libm::sin(TURN * self.pulse_hz * t);
        let (mut x, mut y) = (self.drift.0 * pace, self.drift.1 * pace);
        for (i, (along, across, hz)) in self.sway.iter().enumerate() {
            let angle = TURN * hz * t + i as f64;
            x += along * TURN * hz * libm::cos(angle);
            y -= across * TURN * hz * libm::sin(angle);
        }
        (x, y)
    }

    /// Returns the largest horizontal and vertical speeds between two times in seconds, in pixels per second: the
    /// speed in the middle, and the greatest acceleration for half of the time.
    pub(crate) fn speed_bound(&self, from: f64, to: f64) -> (f64, f64) {
        let (x, y) = self.velocity(0.5 * (from + to));
        let turn = TURN * self.pulse_hz * self.pulse;
        let (mut ax, mut ay) = (self.drift.0 * turn, self.drift.1 * turn);
        (ax, ay) = (libm::fabs(ax), libm::fabs(ay));
        for (along, across, hz) in &self.sway {
            ax += libm::fabs(*along) * (TURN * hz) * (TURN * hz);
            ay += libm::fabs(*across) * (TURN * hz) * (TURN * hz);
        }
        let half = 0.5 * (to - from);
        (libm::fabs(x) + ax * half, libm::fabs(y) + ay * half)
    }

    /// Returns the horizontal speed of a row relative to the middle.
    ///
    /// Rows move in [`LAYERS`] bands: within a band the picture stays rigid however long the scene lasts, whereas a
    /// speed per row would shear it more and more.
    pub(crate) fn row_speed(&self, y: u16, height: u16) -> f64 {
        let layer = u32::from(y) * LAYERS / u32::from(height.max(1));
        let middle = (f64::from(layer) + 0.5) / f64::from(LAYERS);
        1.0 + self.parallax * (middle - 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn no_movement_is_faster_than_its_bound() {
        let camera = Camera {
            drift: (60.0, 15.0),
            pulse: 1.0,
            pulse_hz: 1.1,
            sway: [(14.0, 10.0, 0.9), (1.0, 1.5, 4.3)],
            parallax: 0.4,
        };
        for step in [0.001, 0.02, 0.3] {
            for i in 0..500 {
                let from = f64::from(i) * 0.013;
                let (x, y) = camera.speed_bound(from, from + step);
                for part in 0..10 {
                    let t = from + step * f64::from(part) / 10.0;
                    let (a, b) = (camera.offset(t), camera.offset(t + 1e-5));
                    let speed = ((b.0 - a.0).abs() * 1e5, (b.1 - a.1).abs() * 1e5);
                    assert!(speed.0 <= x + 1e-3 && speed.1 <= y + 1e-3, "{t}: {speed:?}");
                }
            }
        }
    }
}
