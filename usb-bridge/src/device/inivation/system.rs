//! What the cameras' registers tell of themselves.

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Sensor;

use super::registers::{
    DVS_COLUMNS, DVS_ORIENTATION, DVS_ROWS, LOGIC_KNOWN, LOGIC_PATCH, LOGIC_VERSION, read,
};
use crate::link::control::Control;

/// Oldest versions whose stream is known.
#[derive(Debug, Clone, Copy)]
pub struct Versions {
    /// Firmware: low byte of the device's release.
    pub firmware_min: u16,
    /// Patch level of the logic.
    pub patch_min: u32,
}

/// Bit of the orientation that exchanges columns and rows.
const EXCHANGED: u32 = 1 << 2;

/// Compares the camera's versions with what is known; returns them for people.
///
/// # Errors
/// They are too old, or the logic is another one.
pub fn check_versions(known: &Versions, control: &mut dyn Control) -> Result<String> {
    let firmware = control.release() & 0xFF;
    let logic = read(control, LOGIC_VERSION)?;
    let patch = read(control, LOGIC_PATCH)?;
    ensure!(
        firmware >= known.firmware_min && logic == LOGIC_KNOWN && patch >= known.patch_min,
        "{}: firmware {firmware}, logic {logic}.{patch}; firmware {} and logic {LOGIC_KNOWN}.{} or \
         later patches of both are needed: update the camera with its vendor's tool",
        control.name(),
        known.firmware_min,
        known.patch_min
    );
    Ok(format!("firmware {firmware}, logic {logic}.{patch}"))
}

/// Size of the sensor as its events have it, and whether the logic calls its columns rows.
///
/// # Errors
/// The camera has no such sensor.
pub fn sensor(control: &mut dyn Control) -> Result<(Sensor, bool)> {
    let columns = read(control, DVS_COLUMNS)?;
    let rows = read(control, DVS_ROWS)?;
    let inverted = read(control, DVS_ORIENTATION)? & EXCHANGED != 0;
    let (width, height) = if inverted {
        (rows, columns)
    } else {
        (columns, rows)
    };
    let sensor = match (width.try_into(), height.try_into()) {
        (Ok(width), Ok(height)) => Sensor::new(width, height),
        _ => None,
    };
    let name = control.name();
    let sensor = sensor.with_context(|| {
        format!(
            "{name}: its sensor has {width} x {height} pixels, which no known one has: reconnect it"
        )
    })?;
    Ok((sensor, inverted))
}
