//! Memory that an input asks for by its sensor's size: looked for before the work begins, so that too little is an
//! error, where a refused allocation in the middle of the work would abort the program.

use std::hint::black_box;

use anyhow::{Result, anyhow};
use eecvs_nostd::Sensor;

/// Bytes per pixel of the sensor that a command may need at once: sums, pictures and packed coefficients of a window.
const BYTES_PER_PIXEL: usize = 32;

/// Checks that the memory for a sensor of this size can be had; messages name the recording `name`.
///
/// # Errors
/// The system refuses the memory.
pub fn look_for(sensor: Sensor, name: &str) -> Result<()> {
    let bytes = sensor.pixels() as usize * BYTES_PER_PIXEL;
    let mut room: Vec<u8> = Vec::new();
    let found = room.try_reserve_exact(bytes);
    // Without this the compiler may leave the allocation out, since nobody uses it.
    black_box(&mut room);
    found.map_err(|_| {
        anyhow!(
            "{name}: its sensor of {} x {} asks for {} MiB of memory, which the system refuses: raise the limit, or crop \
             the recording by `eecvs convert --crop`",
            sensor.width,
            sensor.height,
            bytes >> 20
        )
    })
}
