//! The place to plug in a sensor, here a Prophesee GENX320 whose 8-bit parallel port sends EVT 2.0 words. The
//! feature `sensor` builds the image with it instead of the link: events come from the port, frames leave on the
//! UART.
//!
//! Everything is here but the transfer itself, which depends on the board. On a chip with a camera interface
//! (DCMI), let its DMA fill the two halves of a buffer of words in turn. On the STM32F405, which has none, let the
//! port's clock trigger a timer's capture channel, and that trigger a DMA stream from the GPIO's input register,
//! one byte per clock. In either case the DMA's half-complete and complete interrupts have a half of the buffer
//! that nobody writes to, and do
//!
//! ```ignore
//! #[interrupt]
//! fn DMA2_STREAM1() {
//!     static mut PORT: Option<Port<'static>> = None;
//!     sensor::on_transfer(PORT, |port| port.take(half));
//! }
//! ```
//!
//! with the interrupt's priority above that of PendSV, which is the lowest. A word is the four bytes in the order
//! in which they arrived (little-endian). After an overrun, call [`Port::count_lost`] with at most the events of a
//! half buffer: frames then report them.

use core::cell::RefCell;

use cortex_m::peripheral::SCB;
use critical_section::Mutex;
use eecvs_nostd::event_link::Setup;
use eecvs_nostd::ingest::from_sensor::{Port, SensorSource};
use heapless::spsc::Queue;

use crate::clock::Stopwatch;

/// Number of words between the transfer's interrupt and PendSV.
const QUEUE_WORDS: usize = 512;

/// 320 x 320 pixels, windows of 32,768 us, events coded losslessly by the fast coder (see `Mode` of the core). With
/// 0 in place of 1 for `mode` it codes coefficients: M = 16 and the DCT for every window; calibrated thresholds
/// would go here. A sensor cannot be held, so events that find no free window are dropped and counted.
pub const SETUP: Setup = Setup {
    width: 320,
    height: 320,
    window_us: 32_768,
    tau_low_pico: 0,
    tau_high_pico: 0,
    transform: 0,
    m: 16,
    grid: 0,
    step_log2: -6,
    mode: 1,
    fidelity: 0,
    key_windows: 1,
    region: [0; 4],
    options: 0,
    bytes_per_second: 0,
    scan_period_q16: 0,
    scan_slope_q16: 0,
    scan_axis: 0,
    time_base_us: 0,
    when_full: Setup::DROP,
};

/// The port, until the interrupt that uses it takes it.
static PORT: Mutex<RefCell<Option<Port<'static>>>> = Mutex::new(RefCell::new(None));

/// Creates the queue. Returns the end for PendSV; the other end waits for the transfer's interrupt.
pub fn start() -> Option<SensorSource<'static>> {
    let (producer, consumer) =
        cortex_m::singleton!(: Queue<u32, QUEUE_WORDS> = Queue::new())?.split();
    critical_section::with(|token| PORT.borrow(token).replace(Some(Port::new(producer))));
    Some(SensorSource::new(consumer, SETUP))
}

/// Body of the transfer's interrupt: passes `port`, which belongs to the interrupt, to `take`. The first call
/// fetches it.
pub fn on_transfer(port: &mut Option<Port<'static>>, take: impl FnOnce(&mut Port<'static>)) {
    let stopwatch = Stopwatch::start();
    if port.is_none() {
        *port = critical_section::with(|token| PORT.borrow(token).take());
    }
    if let Some(port) = port {
        take(port);
    }
    SCB::set_pendsv();
    stopwatch.stop_interrupt();
}
