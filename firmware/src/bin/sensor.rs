//! The image to flash with a simulated sensor in the link's place: plays the host's file `sensor.words`, writes
//! `sensor.frames`, and ends with the sensor. `cargo xtask sensor` builds and runs this; `cargo xtask flips` flips bits of it
//! and reads what ended it after the restart.
#![no_std]
#![no_main]

use cortex_m::peripheral::SCB;
use cortex_m_rt::{entry, exception};
use cortex_m_semihosting::debug::{self, EXIT_SUCCESS};
use cortex_m_semihosting::hprintln;
use eecvs_firmware::encoding::Encoding;
use eecvs_firmware::receiving::Receiving;
use eecvs_firmware::sensor::simulated;
use eecvs_firmware::{clock, fault};

#[entry]
fn main() -> ! {
    hprintln!("start");
    if let Some(record) = fault::Record::take() {
        hprintln!("ended: {:?}", record);
        debug::exit(EXIT_SUCCESS);
    }
    fault::restart_in_emulators();
    let mut encoding = Encoding::start(None);
    while !encoding.work() {}
    // After what the log may have printed on its line.
    hprintln!("\n{{\"overrun\":{}}}", simulated::overrun());
    loop {
        debug::exit(EXIT_SUCCESS);
    }
}

#[exception]
fn PendSV() {
    static mut RECEIVING: Receiving = Receiving::new();
    RECEIVING.on_pend();
}

#[exception]
fn SysTick() {
    clock::on_wrap();
    SCB::set_pendsv();
}
