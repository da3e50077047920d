//! Prophesee's cameras: EVK2, EVK3, EVK4 and those built on them.
pub mod high_time;
pub mod parse_evt21;
pub mod parse_evt3;
pub mod write_evt21;
pub mod write_evt3;

use anyhow::{Result, ensure};
use eecvs_nostd::{Event, Sensor};

/// Refuses to write event number `index` where it lies outside of the sensor.
fn check_inside(index: u64, event: &Event, sensor: Sensor) -> Result<()> {
    ensure!(
        sensor.contains(event.x, event.y),
        "event {index} at x = {}, y = {} is outside of the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// Message for a time that no words of time lead to.
fn time_refused(index: u64, t_us: u64) -> String {
    format!(
        "event {index}: the camera's clock cannot go to {t_us} us (it counts from 0; steps back and \
         gaps have their limits): subtract the recording's first time, or cut it there"
    )
}
