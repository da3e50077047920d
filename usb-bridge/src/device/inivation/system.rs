//! Identifies a camera by its registers.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::Sensor;

use super::registers::{
    CHIP, DVS_COLUMNS, DVS_ORIENTATION, DVS_ROWS, ENDPOINT, LOGIC_KNOWN, LOGIC_PATCH,
    LOGIC_VERSION, Register, are_long, clear_all, read,
};
use crate::link::control::Control;

/// Oldest versions whose stream is known.
#[derive(Debug, Clone, Copy)]
pub struct Versions {
    /// Firmware version: the low byte of the device's release.
    pub firmware_min: u16,
    /// Patch level of the logic.
    pub patch_min: u32,
}

/// Orientation bit that exchanges columns and rows.
const EXCHANGED: u32 = 1 << 2;

/// Checks the camera's versions against the known ones; returns them as text.
///
/// # Errors
/// The versions are too old, or the logic has another version.
fn check_versions(known: &Versions, control: &mut dyn Control) -> Result<String> {
    let firmware = control.release() & 0xFF;
    if are_long(control.release()) {
        // Its firmware has the stream to itself.
        return Ok(format!("firmware {firmware}"));
    }
    let logic = read(control, LOGIC_VERSION)?;
    let patch = read(control, LOGIC_PATCH)?;
    ensure!(
        firmware >= known.firmware_min && logic == LOGIC_KNOWN && patch >= known.patch_min,
        "{}: has firmware {firmware} and logic {logic}.{patch}, but needs firmware {} or later and \
         logic {LOGIC_KNOWN}.{} or a later patch: update the camera with its vendor's tool",
        control.name(),
        known.firmware_min,
        known.patch_min
    );
    Ok(format!("firmware {firmware}, logic {logic}.{patch}"))
}

/// Identity that a camera's registers report.
#[derive(Debug)]
pub struct Found {
    /// Versions, as text.
    pub firmware: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Whether the logic exchanges columns and rows.
    pub inverted: bool,
    /// Number of the chip, if the camera reports it.
    pub chip: Option<u32>,
}

/// Time in which the logic's buffers drain.
const EMPTY: Duration = Duration::from_millis(10);

/// Identifies a camera and leaves it silent: it may still be running for a program that crashed. `runs` lists the
/// registers that make it send, in the order in which they are cleared.
///
/// # Errors
/// The camera does not answer, or its stream is unknown.
pub fn found(
    name: &str,
    known: &Versions,
    runs: &[Register],
    control: &mut dyn Control,
) -> Result<Found> {
    let firmware = check_versions(known, control)?;
    let (sensor, inverted) = sensor(control)?;
    let chip = if are_long(control.release()) {
        None
    } else {
        Some(read(control, CHIP)?)
    };
    clear_all(control, runs)?;
    control.wait(EMPTY);
    control
        .clear_halt(ENDPOINT)
        .with_context(|| format!("{name}: cannot clear the halt of endpoint {ENDPOINT:#04x}"))?;
    Ok(Found {
        firmware,
        sensor,
        inverted,
        chip,
    })
}

/// Returns the size of the sensor in the coordinates of its events, and whether the logic exchanges columns and
/// rows.
///
/// # Errors
/// The camera reports a size that no sensor has.
fn sensor(control: &mut dyn Control) -> Result<(Sensor, bool)> {
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
            "{name}: it reports a sensor of {width} x {height} pixels, which is not a possible \
             size: reconnect the camera"
        )
    })?;
    Ok((sensor, inverted))
}
