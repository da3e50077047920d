//! Event density of a window, eq. (1).

use event_types::Sensor;

use super::window::Window;

/// Returns the density rho = N / (H W T), eq. (1), in events per pixel per second.
///
/// `events` is N, `duration_us` is T in microseconds, at least 1; H and W are the sides of `sensor`.
#[must_use]
pub fn density(events: u64, sensor: Sensor, duration_us: u32) -> f64 {
    let seconds = f64::from(duration_us) * 1e-6;
    events as f64 / (f64::from(sensor.height) * f64::from(sensor.width) * seconds)
}

/// Returns the [`density`] of a closed window over its own duration.
#[must_use]
pub fn window_density(window: &Window, sensor: Sensor) -> f64 {
    density(window.events.len() as u64, sensor, window.duration_us)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_events::at;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-14 * b.abs()
    }

    #[test]
    fn hand_computed() {
        let sensor = Sensor::new(10, 20).unwrap();
        assert!(close(density(400, sensor, 1_000_000), 2.0));
        assert!(close(density(1, sensor, 500_000), 0.01));
        assert_eq!(density(0, sensor, 1), 0.0);
        // 346 x 260, one event in the default window: 1 / (89,960 * 0.032768 s).
        let davis = Sensor::new(346, 260).unwrap();
        assert!(close(
            density(1, davis, 32_768),
            1.0 / (89_960.0 * 0.032_768)
        ));
    }

    #[test]
    fn a_window_that_closed_early_is_measured_over_its_own_duration() {
        let sensor = Sensor::new(2, 1).unwrap();
        let window = Window {
            t0_us: 5,
            duration_us: 100,
            events: vec![at(5), at(6)],
            begins_run: false,
        };
        assert!(close(window_density(&window, sensor), 10_000.0));
    }
}
