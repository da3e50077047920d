//! The encoder on a microcontroller: code that its images share.
//!
//! | file | content |
//! |---|---|
//! | `board/` | set-up of a machine: clocks, pins, the UART or the USB controller of the link |
//! | `receiving.rs` | the interrupts' side: bytes to windows |
//! | `queue.rs` | queues between the two sides |
//! | `sensor/` | the place to plug in a sensor |
//! | `encoding.rs` | `main`'s side: windows to frames |
//! | `memory.rs` | the memory that a setup divides |
//! | `clock.rs` | time, and how much of it interrupts took |
//! | `log.rs` | defmt over RTT on a board, over semihosting in QEMU |
//! | `stack.rs` | how much of the stack was used |
//! | `watchdog.rs` | a restart after half a second without progress |
//! | `fault.rs` | what happens on a panic, a fault, or when the stack's floor is crossed |
//! | `bin/encoder.rs` | the image to flash: events in, frames out |
//! | `bin/golden.rs` | the golden vectors, on the target |
//! | `bin/sensor.rs` | the image to flash with a simulated sensor in the link's place |
//! | `bin/faults.rs` | every kind of end, whose record must be there after a restart |
//! | `bin/instructions.rs` | instructions per event and stage |
//! | `bin/kernels.rs` | instructions per event of every kernel of the accumulate stage |
#![no_std]

use panic_probe as _;

pub mod board;
#[cfg(not(feature = "microbit"))]
pub mod clock;
#[cfg(not(feature = "microbit"))]
pub mod encoding;
pub mod fault;
pub mod log;
#[cfg(not(feature = "microbit"))]
pub mod memory;
#[cfg(not(feature = "microbit"))]
pub mod queue;
#[cfg(not(feature = "microbit"))]
pub mod receiving;
#[cfg(feature = "sensor")]
pub mod sensor;
pub mod stack;
#[cfg(not(feature = "microbit"))]
pub mod watchdog;
