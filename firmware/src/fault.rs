//! How a panic, a fault, or a stack that crossed its floor ends: a board restarts, an emulator exits with an error.

use core::arch::global_asm;

use cortex_m::peripheral::SCB;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE};

use crate::{board, stack};

// After an overflow the stack pointer is outside of RAM, and nothing may be pushed before it is reset. Hence this
// is not a Rust function, which might begin with a push.
global_asm!(
    ".syntax unified",
    ".section .HardFault.own, \"ax\"",
    ".global HardFault",
    ".type HardFault, %function",
    ".thumb_func",
    "HardFault:",
    "mrs r0, msp",
    "ldr r1, =_stack_start",
    "msr msp, r1",
    "bl {report}",
    ".pool",
    report = sym report,
);

/// Reports a fault; `pointer` is the stack pointer at that time.
extern "C" fn report(pointer: u32) -> ! {
    if stack::is_overflow(pointer) {
        defmt::error!("stack overflow: the stack pointer was {=u32:#x}", pointer);
    } else {
        defmt::error!("hard fault");
    }
    stop()
}

/// Restarts the board, or ends the emulator with an error.
pub fn stop() -> ! {
    loop {
        if board::is_emulated() {
            debug::exit(EXIT_FAILURE);
        } else {
            SCB::sys_reset();
        }
    }
}
