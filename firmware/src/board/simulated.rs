//! An MPS2 board in QEMU with a simulated sensor (`sensor/simulated.rs`) and a simulated link, whose frames go to the
//! host's file `sensor.frames`.

use cortex_m::Peripherals;
use cortex_m_rt::exception;
use cortex_m_semihosting::{nr, syscall};

use crate::sensor::simulated;
use crate::{clock, fault, watchdog};

/// Name of the machine.
pub const NAME: &str = "mps2 with a simulated sensor";
/// Ticks of the timers in a second; the processor does as many instructions as QEMU is asked for.
pub const CLOCK_HZ: u32 = 25_000_000;
/// Ends with the 0 that semihosting expects.
const FILE: &[u8] = b"sensor.frames\0";

/// Returns whether this is an emulator, which takes semihosting calls.
#[must_use]
pub fn is_emulated() -> bool {
    true
}

/// A link that sends frames by itself, at its own rate, as a DMA does: it has room for one.
#[derive(Debug)]
pub struct Sender {
    file: usize,
    /// The clock's ticks when what was sent last has left, and whether it is still leaving.
    left: u32,
    is_leaving: bool,
}

/// Opens the file and returns the sending half of the link.
pub fn set_up(_: &mut Peripherals) -> Option<Sender> {
    // SAFETY: the call reads its name, which ends with 0.
    let file = unsafe {
        syscall!(
            OPEN,
            FILE.as_ptr(),
            nr::open::W_TRUNC_BINARY,
            FILE.len() - 1
        )
    };
    (file != usize::MAX).then_some(Sender {
        file,
        left: 0,
        is_leaving: false,
    })
}

impl Sender {
    /// Does nothing, as there is one host.
    pub fn follow(&mut self) {}

    /// Sends all bytes; returns once what was sent before has left.
    pub fn send(&mut self, bytes: &[u8]) {
        while self.is_leaving && (self.left.wrapping_sub(clock::ticks()) as i32) > 0 {
            watchdog::feed();
            cortex_m::asm::wfi();
        }
        // SAFETY: the host reads these bytes alone.
        let _ = unsafe { syscall!(WRITE, self.file, bytes.as_ptr(), bytes.len()) };
        let rate = u64::from(simulated::link_bytes_per_second());
        let ticks = bytes.len() as u64 * u64::from(CLOCK_HZ) / rate;
        self.left = clock::ticks().wrapping_add(ticks as u32);
        self.is_leaving = true;
    }
}

pub use super::cmsdk_watchdog::{UNMASKED_IS_WATCHDOG, feed_watchdog, start_watchdog};

/// Receives nothing.
pub fn read_byte() -> Option<u8> {
    None
}

/// Returns how often bytes were lost because they were not read in time.
pub fn overruns() -> u32 {
    0
}

/// Does nothing, as nothing is received.
pub fn hold_receiving() {}

/// Does nothing, as nothing is received.
pub fn resume_receiving() {}

/// Handles every exception without a handler of its own: without a device's vector table there is one for all of the
/// board's interrupts.
#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    match interrupt {
        simulated::INTERRUPT => simulated::on_timer(),
        _ => fault::unexpected(interrupt),
    }
}
