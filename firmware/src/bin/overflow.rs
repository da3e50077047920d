//! Overflows its stack on purpose: `fault.rs` must report it and no memory above the stack may
//! have changed. For QEMU; exits with an error either way, and says which.
#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m_rt::entry;
use cortex_m_semihosting::debug;
use eecvs_firmware as _;

#[entry]
fn main() -> ! {
    let sum = descend(u32::MAX);
    defmt::error!("no overflow: {=u32}", sum);
    loop {
        debug::exit(debug::EXIT_FAILURE);
    }
}

/// A frame of at least 256 bytes at each level.
#[inline(never)]
fn descend(levels: u32) -> u32 {
    let frame = black_box([levels; 64]);
    if levels == 0 {
        return 0;
    }
    descend(levels - 1).wrapping_add(black_box(frame)[levels as usize % 64])
}
