//! The place to plug in a sensor, here a Prophesee GENX320 whose 8-bit parallel port sends EVT 2.0 words. The
//! feature `sensor` builds the image with it instead of the link: events come from the port, frames leave on the
//! UART.
//!
//! | file | content |
//! |---|---|
//! | `simulated.rs` | a transfer in QEMU, which plays a recording's words at the times of their events |
//!
//! Everything is here but the transfer itself, which depends on the board. On a chip with a camera interface
//! (DCMI), let its DMA fill two blocks of memory in turn. On the STM32F405, which has none, let the
//! port's clock trigger a timer's capture channel, and that trigger a DMA stream from the GPIO's input register,
//! one byte per clock. In either case the interrupt of a filled block exchanges it for the one that is filled after
//! the next:
//!
//! ```ignore
//! #[interrupt]
//! fn DMA2_STREAM1() {
//!     static mut TRANSFER: Option<sensor::Transfer> = None;
//!     if TRANSFER.is_none() {
//!         *TRANSFER = sensor::transfer();
//!     }
//!     sensor::on_transfer(|| { /* exchange the filled block by TRANSFER's port, give the other to the DMA */ });
//! }
//! ```
//!
//! with the interrupt's priority above that of PendSV, which is the lowest. A word is the four bytes in the order
//! in which they arrived (little-endian). After an overrun, where both blocks were filled before the interrupt came, call
//! [`Port::count_lost`] with at most the events of a block: frames then report them.
//!
//! A sensor that falls silent for half a second restarts the board (`watchdog.rs`): let the port's timeout, which a GENX320
//! has, send what there is at least ten times a second, be it nothing but a time.

#[cfg(feature = "simulated")]
pub mod simulated;

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::SCB;
use critical_section::Mutex;
use eecvs_nostd::event_link::Setup;
use eecvs_nostd::ingest::from_sensor::{Block, Filled, Port, SensorSource};
use heapless::spsc::Queue;

use crate::clock::Stopwatch;
use crate::receiving;

/// Number of blocks: the one that the transfer fills, and those that wait while `main` encodes.
const BLOCKS: usize = 16;
/// Words of a block.
pub const BLOCK_WORDS: usize = 128;

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

/// The interrupt's side: the port, and the block that the transfer fills first.
pub type Transfer = (Port<'static, 'static>, Block<'static>);

/// The interrupt's side, until the interrupt takes it.
static TRANSFER: Mutex<RefCell<Option<Transfer>>> = Mutex::new(RefCell::new(None));

/// Creates blocks and queues. Returns the end for PendSV, which begins with [`SETUP`]; the other end waits for the
/// transfer's interrupt. `None` on a second call.
pub fn start() -> Option<SensorSource<'static, 'static>> {
    let blocks =
        cortex_m::singleton!(: [[[u8; 4]; BLOCK_WORDS]; BLOCKS] = [[[0; 4]; BLOCK_WORDS]; BLOCKS])?;
    let filled = cortex_m::singleton!(: Queue<Filled<'static>, BLOCKS> = Queue::new())?;
    let free = cortex_m::singleton!(: Queue<Block<'static>, BLOCKS> = Queue::new())?;
    let ((put_filled, take_filled), (mut put_free, take_free)) = (filled.split(), free.split());
    let (first, others) = blocks.split_first_mut()?;
    for block in others {
        // There is room for all but one.
        put_free.enqueue(block).ok()?;
    }
    let transfer = (Port::new(put_filled, take_free), &mut first[..]);
    critical_section::with(|token| TRANSFER.borrow(token).replace(Some(transfer)));
    #[cfg(feature = "simulated")]
    let setup = simulated::open()?;
    #[cfg(not(feature = "simulated"))]
    let setup = SETUP;
    Some(SensorSource::new(take_filled, put_free, setup))
}

/// Returns the interrupt's side, once it is there; the first call gets it.
pub fn transfer() -> Option<Transfer> {
    critical_section::with(|token| TRANSFER.borrow(token).take())
}

/// Number of blocks that the transfer has filled; wraps.
static TRANSFERS: AtomicU32 = AtomicU32::new(0);

/// Returns the number of blocks that the transfer has filled so far; wraps.
#[must_use]
pub fn transfers() -> u32 {
    TRANSFERS.load(Ordering::Relaxed)
}

/// Body of the transfer's interrupt: runs `exchange`, which returns whether it handed the filled block over; `None` if there
/// was none.
pub fn on_transfer(exchange: impl FnOnce() -> Option<bool>) {
    let stopwatch = Stopwatch::start();
    let exchanged = exchange();
    if exchanged.is_some() {
        // No other code writes it.
        TRANSFERS.store(transfers().wrapping_add(1), Ordering::Relaxed);
    }
    if exchanged == Some(true) && !receiving::is_stalled() {
        SCB::set_pendsv();
    }
    stopwatch.stop_interrupt();
}
