//! Time in ticks of the processor clock, from the SysTick timer. The time that interrupts take is counted
//! separately.

use core::sync::atomic::Ordering;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
// Adds also on cores without an instruction for that.
use portable_atomic::AtomicU32;

use crate::board;

/// Ticks between two of the timer's interrupts: 0.8 ms at 168 MHz. Divides 2^32.
const WRAP_TICKS: u32 = 1 << 17;

/// Number of wraps so far.
static WRAPS: AtomicU32 = AtomicU32::new(0);
/// Ticks that interrupts took; wraps.
static INTERRUPT_TICKS: AtomicU32 = AtomicU32::new(0);

/// Starts the SysTick timer and its interrupt, from which all other items here get the time.
pub fn start(timer: &mut SYST) {
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(WRAP_TICKS - 1);
    timer.clear_current();
    timer.enable_counter();
    timer.enable_interrupt();
}

/// Counts a wrap; called by the timer's interrupt.
pub fn on_wrap() {
    // No other code writes it; a load and a store also work on cores without compare-and-swap.
    WRAPS.store(
        WRAPS.load(Ordering::Relaxed).wrapping_add(1),
        Ordering::Relaxed,
    );
}

/// Returns the number of the timer's interrupts so far; wraps.
#[must_use]
pub fn wraps() -> u32 {
    WRAPS.load(Ordering::Relaxed)
}

/// Returns the ticks since the start, modulo 2^32: differences are valid up to 25 s at 168 MHz.
#[must_use]
pub fn ticks() -> u32 {
    loop {
        let wraps = WRAPS.load(Ordering::Relaxed);
        let pending_before = SCB::is_pendst_pending();
        // The timer counts down; its interrupt comes with the 0, which thus begins a period.
        let past = SYST::get_current().wrapping_neg() % WRAP_TICKS;
        let pending = SCB::is_pendst_pending();
        // Read again if the timer wrapped between the reads, and also at 0, where the wrap is pending one tick
        // before the timer starts over. A wrap that no interrupt has counted yet, as one of at least its priority
        // is running, is counted here.
        let is_steady = pending == pending_before && wraps == WRAPS.load(Ordering::Relaxed);
        if is_steady && past < WRAP_TICKS - 1 {
            let wraps = wraps.wrapping_add(u32::from(pending));
            return wraps.wrapping_mul(WRAP_TICKS).wrapping_add(past);
        }
    }
}

/// Returns the ticks that interrupts took since the start; wraps.
#[must_use]
pub fn interrupt_ticks() -> u32 {
    INTERRUPT_TICKS.load(Ordering::Relaxed)
}

/// Converts ticks of the processor clock to nanoseconds.
#[must_use]
pub fn nanoseconds(ticks: u64) -> u64 {
    const NS_PER_S: u64 = 1_000_000_000;
    const CLOCK_HZ: u64 = board::CLOCK_HZ as u64;
    // In two parts, so that nothing overflows for centuries.
    (ticks / CLOCK_HZ)
        .wrapping_mul(NS_PER_S)
        .wrapping_add(ticks % CLOCK_HZ * NS_PER_S / CLOCK_HZ)
}

/// Measures a short interrupt that nothing interrupts: less than one period of the timer.
#[derive(Debug)]
pub struct ShortStopwatch {
    current: u32,
}

impl ShortStopwatch {
    /// Starts measuring.
    #[inline]
    #[must_use]
    pub fn start() -> Self {
        Self {
            current: SYST::get_current(),
        }
    }

    /// Ends the interrupt and counts its ticks as taken by interrupts.
    #[inline]
    pub fn stop_interrupt(self) {
        let own = self.current.wrapping_sub(SYST::get_current()) % WRAP_TICKS;
        INTERRUPT_TICKS.fetch_add(own, Ordering::Relaxed);
    }
}

/// Measures a stretch of code, without the interrupts that come in between.
#[derive(Debug)]
pub struct Stopwatch {
    ticks: u32,
    interrupt_ticks: u32,
}

impl Stopwatch {
    /// Starts measuring.
    #[must_use]
    pub fn start() -> Self {
        loop {
            let interrupt_ticks = INTERRUPT_TICKS.load(Ordering::Relaxed);
            let ticks = ticks();
            // An interrupt in between would be in only one of the two, and a short stretch of code would seem to
            // take a negative time.
            if interrupt_ticks == INTERRUPT_TICKS.load(Ordering::Relaxed) {
                return Self {
                    ticks,
                    interrupt_ticks,
                };
            }
        }
    }

    /// Returns the ticks since the start, without those of interrupts.
    #[must_use]
    pub fn stop(self) -> u32 {
        let now = Self::start();
        let interrupts = now.interrupt_ticks.wrapping_sub(self.interrupt_ticks);
        now.ticks.wrapping_sub(self.ticks).wrapping_sub(interrupts)
    }

    /// Ends an interrupt and counts its own ticks as taken by interrupts. Returns them.
    pub fn stop_interrupt(self) -> u32 {
        let own = self.stop();
        INTERRUPT_TICKS.fetch_add(own, Ordering::Relaxed);
        own
    }
}
