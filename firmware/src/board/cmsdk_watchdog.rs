//! The watchdog of Arm's MPS2 boards (CMSDK APB watchdog): its first timeout is an NMI, which keeps a record and restarts
//! the board, its second a reset.

/// Registers of the watchdog, from its base address on.
#[cfg(not(feature = "an505"))]
const WATCHDOG: *mut u32 = core::ptr::with_exposed_provenance_mut(0x4000_8000);
/// Registers of the watchdog, from its base address on: the one of the secure part.
#[cfg(feature = "an505")]
const WATCHDOG: *mut u32 = core::ptr::with_exposed_provenance_mut(0x5008_1000);
const LOAD: usize = 0;
const CONTROL: usize = 2;
const INTERRUPT_CLEAR: usize = 3;
const LOCK: usize = 0xc00 / 4;
const INTERRUPT_ENABLE: u32 = 1;
const RESET_ENABLE: u32 = 1 << 1;
const UNLOCK: u32 = 0x1acc_e551;
/// Half a second.
const TICKS: u32 = super::CLOCK_HZ / 2;

/// Whether the interrupt that cannot be masked is the watchdog's.
pub const UNMASKED_IS_WATCHDOG: bool = true;

fn write(register: usize, value: u32) {
    // SAFETY: this is one of the watchdog's registers, which are words; only this module uses the watchdog.
    unsafe { WATCHDOG.add(register).write_volatile(value) }
}

/// Starts the watchdog.
pub fn start_watchdog() {
    write(LOCK, UNLOCK);
    write(LOAD, TICKS);
    write(CONTROL, INTERRUPT_ENABLE | RESET_ENABLE);
}

/// Lets the watchdog begin anew.
pub fn feed_watchdog() {
    write(INTERRUPT_CLEAR, 1);
}
