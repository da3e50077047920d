//! The image to flash: events in over the link, frames out.
//!
//! | runs in | does |
//! |---|---|
//! | the link's interrupt, highest priority | byte -> ring; holds the link when the ring is full |
//! | PendSV, lowest priority | ring -> packets -> words -> events -> the open window |
//! | `main` | closed window -> frames -> link |
//!
//! Two windows take turns, so the next one is received while this one is encoded and sent.
#![no_std]
#![no_main]

use cortex_m::peripheral::SCB;
use cortex_m_rt::{entry, exception};
use eecvs_firmware::encoding::Encoding;
use eecvs_firmware::receiving::Receiving;
use eecvs_firmware::{board, clock, fault};

#[entry]
fn main() -> ! {
    let ended = fault::Record::take();
    if let Some(record) = &ended {
        defmt::error!("started again after {}", record);
    }
    let restart = ended.as_ref().map(fault::Record::restart);
    let mut encoding = Encoding::start(restart);
    defmt::info!("ready on {=str}", board::NAME);
    encoding.greet();
    loop {
        encoding.work();
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
    // The last bytes of a packet may be too few to trigger PendSV.
    SCB::set_pendsv();
}
