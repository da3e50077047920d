//! Overflows its stack on purpose: `fault.rs` must report it, which ends the emulator with an error. Without an
//! overflow the image exits with success, which the test counts as a failure.
#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m_rt::entry;
use cortex_m_semihosting::debug;
use eecvs_firmware as _;

#[entry]
fn main() -> ! {
    black_box(descend(u32::MAX));
    loop {
        debug::exit(debug::EXIT_SUCCESS);
    }
}

/// Recurses with a frame of at least 256 bytes per level.
#[inline(never)]
fn descend(levels: u32) -> u32 {
    let frame = black_box([levels; 64]);
    if levels == 0 {
        return 0;
    }
    descend(levels - 1).wrapping_add(black_box(frame)[levels as usize % 64])
}
