//! Arm's MPS2 and MPS3 boards, in QEMU only: AN385 (Cortex-M3), AN386 (M4), AN500 (M7), AN505 (M33) and AN547 (M55).
//!
//! The last two have the same UART in the secure part of their memory.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::NVIC;
use cortex_m_rt::exception;

use crate::{fault, receiving, watchdog};

/// Name of the machine.
pub const NAME: &str = "mps2";
/// Processor clock in hertz.
pub const CLOCK_HZ: u32 = if cfg!(feature = "an505") {
    20_000_000
} else if cfg!(feature = "an547") {
    32_000_000
} else {
    25_000_000
};

/// Receive interrupt of UART 0.
#[derive(Clone, Copy)]
struct Uart0Receive;

/// Base address and receive interrupt of UART 0.
#[cfg(not(any(feature = "an505", feature = "an547")))]
const UART0_AT: (usize, u16) = (0x4000_4000, 0);
/// Base address and receive interrupt of UART 0.
#[cfg(feature = "an505")]
const UART0_AT: (usize, u16) = (0x5020_0000, 32);
/// Base address and receive interrupt of UART 0.
#[cfg(feature = "an547")]
const UART0_AT: (usize, u16) = (0x5930_3000, 33);

// SAFETY: this is the number of the interrupt on the image's board.
unsafe impl cortex_m::interrupt::InterruptNumber for Uart0Receive {
    fn number(self) -> u16 {
        UART0_AT.1
    }
}

/// Registers of UART 0 (CMSDK APB UART), from its base address on.
const UART0: *mut u32 = core::ptr::with_exposed_provenance_mut(UART0_AT.0);
const DATA: usize = 0;
const STATE: usize = 1;
const CONTROL: usize = 2;
const INTERRUPT_CLEAR: usize = 3;
const BAUD_DIVIDER: usize = 4;

const SEND_FULL: u32 = 1;
const RECEIVE_FULL: u32 = 1 << 1;
const RECEIVE_OVERRUN: u32 = 1 << 3;
const SEND_ENABLE: u32 = 1;
const RECEIVE_ENABLE: u32 = 1 << 1;
const RECEIVE_INTERRUPT: u32 = 1 << 3;
const RECEIVE_INTERRUPT_CLEAR: u32 = 1 << 1;

static OVERRUNS: AtomicU32 = AtomicU32::new(0);

fn read(register: usize) -> u32 {
    // SAFETY: this is one of the UART's five registers, which are words; only this module uses the UART.
    unsafe { UART0.add(register).read_volatile() }
}

fn write(register: usize, value: u32) {
    // SAFETY: as for `read`.
    unsafe { UART0.add(register).write_volatile(value) }
}

/// Returns whether this is an emulator, which takes semihosting calls.
#[must_use]
pub fn is_emulated() -> bool {
    true
}

/// Sending half of the link.
#[derive(Debug)]
pub struct Sender(());

/// Sets up the UART and returns the sending half of the link.
pub fn set_up(_: &mut Peripherals) -> Option<Sender> {
    write(BAUD_DIVIDER, 16);
    write(CONTROL, SEND_ENABLE | RECEIVE_ENABLE | RECEIVE_INTERRUPT);
    Some(Sender(()))
}

impl Sender {
    /// Does nothing: all that is sent is for the current host, as this link has only one.
    pub fn follow(&mut self) {}

    /// Sends all bytes; returns once the UART has taken the last one.
    pub fn send(&mut self, bytes: &[u8]) {
        for byte in bytes {
            while read(STATE) & SEND_FULL != 0 {
                watchdog::feed();
            }
            write(DATA, u32::from(*byte));
        }
    }
}

/// Returns the next received byte, if there is one.
pub fn read_byte() -> Option<u8> {
    let state = read(STATE);
    if state & RECEIVE_OVERRUN != 0 {
        write(STATE, RECEIVE_OVERRUN);
        // No other code writes it.
        OVERRUNS.store(
            OVERRUNS.load(Ordering::Relaxed).wrapping_add(1),
            Ordering::Relaxed,
        );
    }
    if state & RECEIVE_FULL == 0 {
        return None;
    }
    write(INTERRUPT_CLEAR, RECEIVE_INTERRUPT_CLEAR);
    Some(read(DATA) as u8)
}

/// Returns how often bytes were lost because they were not read in time.
pub fn overruns() -> u32 {
    OVERRUNS.load(Ordering::Relaxed)
}

#[cfg(not(feature = "an547"))]
pub use super::cmsdk_watchdog::{UNMASKED_IS_WATCHDOG, feed_watchdog, start_watchdog};

/// Whether the interrupt that cannot be masked is the watchdog's.
#[cfg(feature = "an547")]
pub const UNMASKED_IS_WATCHDOG: bool = false;

/// Does nothing: QEMU's model of the board has another watchdog, with clocks of its own.
#[cfg(feature = "an547")]
pub fn start_watchdog() {}

/// Does nothing.
#[cfg(feature = "an547")]
pub fn feed_watchdog() {}

/// Masks the receive interrupt, so that received bytes stay in the UART.
pub fn hold_receiving() {
    NVIC::mask(Uart0Receive);
}

/// Unmasks the receive interrupt, after [`hold_receiving`] or at the start.
pub fn resume_receiving() {
    // SAFETY: the interrupt shares data only through queues.
    unsafe { NVIC::unmask(Uart0Receive) };
}

/// Handles every exception without a handler of its own: without a device's vector table there is one for all of the
/// board's interrupts.
#[exception]
unsafe fn DefaultHandler(interrupt: i16) {
    if interrupt == UART0_AT.1 as i16 {
        receiving::on_receive();
    } else {
        fault::unexpected(interrupt);
    }
}
