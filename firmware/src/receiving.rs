//! Turns bytes from the link into windows: the interrupts' side.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use eecvs_nostd::Window;
use eecvs_nostd::event_link::Setup;
#[cfg(any(feature = "usb", not(feature = "sensor")))]
use eecvs_nostd::ingest::from_link::Link;
#[cfg(feature = "sensor")]
use eecvs_nostd::ingest::from_sensor::SensorSource;
use eecvs_nostd::ingest::{Exchange, Ingest, Poll, Work};

use crate::board;
#[cfg(not(feature = "usb"))]
use crate::clock::ShortStopwatch;
use crate::clock::Stopwatch;
use crate::memory::WINDOWS;
use crate::queue::{Queue, Ring};
#[cfg(feature = "sensor")]
use crate::sensor;

/// Bytes between the link's interrupt and PendSV: two of the longest packets, or where there is one window, 2,048
/// words, nearly as many as it holds events at 320 x 320.
const RING_BYTES: usize = if HAS_TWO_WINDOWS { 1024 } else { 8192 };
/// Whether one window is filled while another is encoded.
const HAS_TWO_WINDOWS: bool = WINDOWS > 1;
/// With more bytes in the ring, events for which there is no window are dropped, if the setup says so: the rest of the
/// ring takes requests.
const WAITING_BYTES: usize = RING_BYTES / 4 * 3;
/// Number of bytes in the ring from which on PendSV is triggered, and of those that come then while it cannot go on.
const MANY_BYTES: usize = 128;
/// The lowest priority.
const LOWEST: u8 = 0xff;

static BYTES: Ring<RING_BYTES> = Ring::new();
/// Number of bytes in the ring from which on PendSV is triggered next. Without a free window it would run with each byte
/// and leave no time to encode the one that it waits for.
static PEND_AT_BYTES: AtomicU32 = AtomicU32::new(MANY_BYTES as u32);
/// Windows that wait to be filled.
static FREE: Queue<Window<'static>, 2> = Queue::new();
/// Work that waits for `main`.
static WORK: Queue<Work<'static>, 4> = Queue::new();
/// Setups that `main` has done, and how many windows they have.
static SET_UP: Queue<(Setup, usize), 1> = Queue::new();
/// Counts of [`Link`], for the status.
static DAMAGED_BYTES: AtomicU32 = AtomicU32::new(0);
static IGNORED: AtomicU32 = AtomicU32::new(0);

/// Number of runs of PendSV; wraps.
static RUNS: AtomicU32 = AtomicU32::new(0);

struct Queues;

impl Exchange<'static> for Queues {
    fn free(&mut self) -> Option<Window<'static>> {
        FREE.take()
    }

    fn has_room(&self) -> bool {
        !WORK.is_full()
    }

    fn hand_over(&mut self, work: Work<'static>) {
        WORK.put(work);
    }

    fn may_wait(&self) -> bool {
        // A sensor's words wait in their blocks; what finds none is dropped there, which takes fewer instructions.
        cfg!(feature = "sensor") || !HAS_TWO_WINDOWS && BYTES.len() < WAITING_BYTES
    }
}

/// Whether PendSV waits for a window or for room in the queue of work; whatever gives it either triggers it.
static STALLED: AtomicBool = AtomicBool::new(false);

/// Returns whether PendSV could do nothing with more words.
#[must_use]
pub fn is_stalled() -> bool {
    STALLED.load(Ordering::Relaxed)
}

/// Returns the number of runs of PendSV so far; wraps.
#[must_use]
pub fn runs() -> u32 {
    RUNS.load(Ordering::Relaxed)
}

/// Returns the next piece of work for `main`.
pub fn work() -> Option<Work<'static>> {
    let was_full = WORK.is_full();
    let work = WORK.take();
    if was_full {
        SCB::set_pendsv();
    }
    work
}

/// Sleeps until an interrupt, unless there is work.
pub fn wait() {
    // An interrupt that comes before the sleep stays pending and ends it.
    cortex_m::interrupt::disable();
    if WORK.is_empty() {
        cortex_m::asm::wfi();
    }
    // SAFETY: interrupts were enabled before, and no critical section is open here.
    unsafe { cortex_m::interrupt::enable() };
}

/// Gives a window back to be filled.
pub fn free(window: Window<'static>) {
    FREE.put(window);
    SCB::set_pendsv();
}

/// Reports that the setup is done and that `windows` windows follow.
pub fn set_up(setup: &Setup, windows: usize) {
    SET_UP.put((*setup, windows));
    SCB::set_pendsv();
}

/// Returns how many bytes of the link belonged to no packet.
pub fn damaged_bytes() -> u32 {
    DAMAGED_BYTES.load(Ordering::Relaxed)
}

/// Returns how many packets came twice or were invalid, plus bytes left over.
pub fn ignored() -> u32 {
    IGNORED.load(Ordering::Relaxed)
}

/// Sets the priority of PendSV and starts the interrupts.
pub fn start(core: &mut Peripherals) {
    // SAFETY: nothing relies on priorities for exclusion.
    unsafe { core.SCB.set_priority(SystemHandler::PendSV, LOWEST) };
    if cfg!(feature = "sensor") {
        // The setup is there already.
        SCB::set_pendsv();
    }
    // A host that only takes frames has requests too.
    if cfg!(any(not(feature = "sensor"), feature = "usb")) {
        board::resume_receiving();
    }
}

/// Body of the UART's interrupt: takes the byte that is there. PendSV runs once there are many, or with the timer's
/// next interrupt.
#[cfg(not(feature = "usb"))]
#[inline]
pub fn on_receive() {
    let stopwatch = ShortStopwatch::start();
    // With a full ring, bytes stay in the UART, whose flow control then holds the sender.
    if !BYTES.is_full()
        && let Some(byte) = board::read_byte()
    {
        BYTES.put(byte);
    }
    pend_if_many();
    if BYTES.is_full() {
        board::hold_receiving();
    }
    stopwatch.stop_interrupt();
}

/// Triggers PendSV where there are many bytes.
#[inline]
fn pend_if_many() {
    if BYTES.len() >= PEND_AT_BYTES.load(Ordering::Relaxed) as usize {
        SCB::set_pendsv();
    }
}

/// Whether the USB link has begun a session that PendSV has not seen yet.
#[cfg(feature = "usb")]
static RESTARTED: AtomicBool = AtomicBool::new(false);
/// Place in the ring where that session's bytes begin.
#[cfg(feature = "usb")]
static SESSION_BEGIN: AtomicU32 = AtomicU32::new(0);

/// Returns how many bytes [`put`] takes; called from the USB link's interrupt.
#[cfg(feature = "usb")]
#[must_use]
pub fn room() -> usize {
    RING_BYTES.saturating_sub(BYTES.len())
}

/// Takes a packet's bytes, for which there is room; called from the USB link's interrupt.
#[cfg(feature = "usb")]
pub fn put(bytes: &[u8]) {
    for byte in bytes {
        if !BYTES.is_full() {
            BYTES.put(*byte);
        }
    }
    pend_if_many();
}

/// Marks everything put so far as part of a session that is over; called from the USB link's interrupt.
#[cfg(feature = "usb")]
pub fn restart() {
    SESSION_BEGIN.store(BYTES.end(), Ordering::Relaxed);
    RESTARTED.store(true, Ordering::Release);
    SCB::set_pendsv();
}

/// Returns the next byte; `None` also where a session ends, until PendSV has seen that.
#[cfg(feature = "usb")]
#[inline]
fn next_byte() -> Option<u8> {
    // In this order: a byte that is there before the session is checked is handled correctly even if the interrupt
    // begins a session in between.
    if BYTES.is_empty() {
        return None;
    }
    match RESTARTED.load(Ordering::Acquire) {
        true => BYTES.take_before(SESSION_BEGIN.load(Ordering::Relaxed)),
        false => BYTES.take(),
    }
}

/// Returns the next byte.
#[cfg(not(any(feature = "usb", feature = "sensor")))]
#[inline]
fn next_byte() -> Option<u8> {
    BYTES.take()
}

/// State that belongs to PendSV: packets, words, events, windows.
pub struct Receiving {
    #[cfg(any(feature = "usb", not(feature = "sensor")))]
    link: Link,
    #[cfg(feature = "sensor")]
    sensor: Option<SensorSource<'static, 'static>>,
    /// Whether the sensor's end is known.
    #[cfg(feature = "simulated")]
    has_ended: bool,
    ingest: Ingest<'static>,
}

impl Receiving {
    /// Returns the state before the first byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            #[cfg(any(feature = "usb", not(feature = "sensor")))]
            link: Link::new(),
            #[cfg(feature = "sensor")]
            sensor: None,
            #[cfg(feature = "simulated")]
            has_ended: false,
            ingest: Ingest::new(),
        }
    }

    /// Body of PendSV: processes received bytes, and takes over finished setups.
    pub fn on_pend(&mut self) {
        let stopwatch = Stopwatch::start();
        // No other code writes it.
        RUNS.store(runs().wrapping_add(1), Ordering::Relaxed);
        if self.ingest.is_setting_up()
            && let Some((setup, windows)) = SET_UP.take()
        {
            self.ingest.set_up(&setup, windows);
        }
        #[cfg(feature = "usb")]
        self.restart();
        let polled = self.poll();
        STALLED.store(polled == Poll::Stalled, Ordering::Relaxed);
        let from = match polled {
            Poll::Idle => 0,
            Poll::Stalled => BYTES.len().min(RING_BYTES - MANY_BYTES),
        };
        PEND_AT_BYTES.store((from + MANY_BYTES) as u32, Ordering::Relaxed);
        // Also while the ring is full: requests have to be answered however long the encoder is busy.
        #[cfg(feature = "usb")]
        board::resume_receiving();
        stopwatch.stop_interrupt();
    }

    #[cfg(feature = "sensor")]
    fn poll(&mut self) -> Poll {
        if self.sensor.is_none() {
            self.sensor = sensor::start();
        }
        let Some(sensor) = &mut self.sensor else {
            return Poll::Idle;
        };
        #[cfg(feature = "simulated")]
        if sensor::simulated::ended() && !self.has_ended {
            self.has_ended = true;
            sensor.flush();
        }
        // On USB a host may set up how the sensor's events are encoded.
        #[cfg(feature = "usb")]
        let sensor = &mut sensor.with_host(self.link.source(next_byte));
        let polled = self.ingest.poll(sensor, &mut Queues);
        #[cfg(feature = "usb")]
        self.count();
        polled
    }

    /// Skips what is left of a session that is over.
    #[cfg(feature = "usb")]
    fn restart(&mut self) {
        if RESTARTED.swap(false, Ordering::Acquire) {
            let bytes = BYTES.skip_to(SESSION_BEGIN.load(Ordering::Relaxed));
            self.link.restart(bytes);
        }
    }

    #[cfg(not(feature = "sensor"))]
    fn poll(&mut self) -> Poll {
        let mut source = self.link.source(next_byte);
        let polled = self.ingest.poll(&mut source, &mut Queues);
        self.count();
        #[cfg(not(feature = "usb"))]
        if BYTES.len() < RING_BYTES / 2 {
            board::resume_receiving();
        }
        polled
    }

    #[cfg(any(feature = "usb", not(feature = "sensor")))]
    fn count(&self) {
        DAMAGED_BYTES.store(self.link.damaged_bytes(), Ordering::Relaxed);
        IGNORED.store(self.link.ignored(), Ordering::Relaxed);
    }
}

impl Default for Receiving {
    fn default() -> Self {
        Self::new()
    }
}
