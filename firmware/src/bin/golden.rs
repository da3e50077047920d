//! The golden vectors on the target.
#![no_std]
#![no_main]

use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_SUCCESS};
use eecvs_firmware::stack;

#[entry]
fn main() -> ! {
    defmt::info!("stack {} bytes", stack::used_bytes());
    debug::exit(EXIT_SUCCESS);
    loop {
        cortex_m::asm::wfi();
    }
}
