//! Bytes from the link to windows: the interrupts' side.

#[cfg(feature = "usb")]
use core::sync::atomic::AtomicBool;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use eecvs_nostd::Window;
use eecvs_nostd::event_link::Setup;
#[cfg(any(feature = "usb", not(feature = "sensor")))]
use eecvs_nostd::ingest::from_link::Link;
#[cfg(feature = "sensor")]
use eecvs_nostd::ingest::from_sensor::SensorSource;
use eecvs_nostd::ingest::{Exchange, Ingest, Work};

use crate::board;
#[cfg(not(feature = "usb"))]
use crate::clock::ShortStopwatch;
use crate::clock::Stopwatch;
use crate::queue::{Queue, Ring};
#[cfg(feature = "sensor")]
use crate::sensor;

/// Bytes between the link's interrupt and PendSV: two of the longest packets.
const RING_BYTES: usize = 1024;
/// Bytes in the ring that PendSV is asked to look at.
const MANY_BYTES: usize = 128;
/// The lowest priority there is.
const LOWEST: u8 = 0xff;

static BYTES: Ring<RING_BYTES> = Ring::new();
/// Windows that wait to be filled.
static FREE: Queue<Window<'static>, 2> = Queue::new();
/// What waits for `main`.
static WORK: Queue<Work<'static>, 4> = Queue::new();
/// Setups that `main` has done, and how many windows they have.
static SET_UP: Queue<(Setup, usize), 1> = Queue::new();
/// What [`Link`] counts, for the status.
static DAMAGED_BYTES: AtomicU32 = AtomicU32::new(0);
static IGNORED: AtomicU32 = AtomicU32::new(0);

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
}

/// What is to be done next.
pub fn work() -> Option<Work<'static>> {
    WORK.take()
}

/// Sleeps until an interrupt, unless there is work.
pub fn wait() {
    // An interrupt that comes before the sleep stays pending and ends it.
    cortex_m::interrupt::disable();
    if WORK.is_empty() {
        cortex_m::asm::wfi();
    }
    // SAFETY: enabled before, and no critical section is open here.
    unsafe { cortex_m::interrupt::enable() };
}

/// Gives a window back.
pub fn free(window: Window<'static>) {
    FREE.put(window);
    SCB::set_pendsv();
}

/// Tells that the setup is done and `windows` windows follow.
pub fn set_up(setup: &Setup, windows: usize) {
    SET_UP.put((*setup, windows));
    SCB::set_pendsv();
}

/// Bytes of the link that belonged to no packet.
pub fn damaged_bytes() -> u32 {
    DAMAGED_BYTES.load(Ordering::Relaxed)
}

/// Packets that came twice or made no sense, and left-over bytes.
pub fn ignored() -> u32 {
    IGNORED.load(Ordering::Relaxed)
}

/// Lets the interrupts run.
pub fn start(core: &mut Peripherals) {
    // SAFETY: nothing relies on priorities for exclusion.
    unsafe { core.SCB.set_priority(SystemHandler::PendSV, LOWEST) };
    if cfg!(feature = "sensor") {
        // The setup is there already.
        SCB::set_pendsv();
    }
    // A host that only takes frames has requests, too.
    if cfg!(any(not(feature = "sensor"), feature = "usb")) {
        board::resume_receiving();
    }
}

/// The UART's interrupt: takes the byte that is there. PendSV runs when there are many, or with the
/// timer's next interrupt.
#[cfg(not(feature = "usb"))]
#[inline]
pub fn on_receive() {
    let stopwatch = ShortStopwatch::start();
    // A full ring leaves bytes in the UART, whose flow control then holds the sender.
    if !BYTES.is_full()
        && let Some(byte) = board::read_byte()
    {
        BYTES.put(byte);
    }
    if BYTES.len() >= MANY_BYTES {
        SCB::set_pendsv();
        if BYTES.is_full() {
            board::hold_receiving();
        }
    }
    stopwatch.stop_interrupt();
}

/// Whether a session of the USB link has begun that PendSV has not seen yet.
#[cfg(feature = "usb")]
static RESTARTED: AtomicBool = AtomicBool::new(false);
/// Where its bytes begin.
#[cfg(feature = "usb")]
static SESSION_BEGIN: AtomicU32 = AtomicU32::new(0);

/// The USB link's interrupt: bytes that [`put`] takes.
#[cfg(feature = "usb")]
#[must_use]
pub fn room() -> usize {
    RING_BYTES.saturating_sub(BYTES.len())
}

/// The USB link's interrupt: takes a packet's bytes, for which there is room.
#[cfg(feature = "usb")]
pub fn put(bytes: &[u8]) {
    for byte in bytes {
        if !BYTES.is_full() {
            BYTES.put(*byte);
        }
    }
    if BYTES.len() >= MANY_BYTES {
        SCB::set_pendsv();
    }
}

/// The USB link's interrupt: what was put is of a session that is over.
#[cfg(feature = "usb")]
pub fn restart() {
    SESSION_BEGIN.store(BYTES.end(), Ordering::Relaxed);
    RESTARTED.store(true, Ordering::Release);
    SCB::set_pendsv();
}

/// The next byte; at the end of a session PendSV has to see that first.
#[cfg(feature = "usb")]
#[inline]
fn next_byte() -> Option<u8> {
    // In this order: a byte that is there before the session is looked at is taken rightly, even where
    // the interrupt begins one in between.
    if BYTES.is_empty() {
        return None;
    }
    match RESTARTED.load(Ordering::Acquire) {
        true => BYTES.take_before(SESSION_BEGIN.load(Ordering::Relaxed)),
        false => BYTES.take(),
    }
}

/// The next byte.
#[cfg(not(any(feature = "usb", feature = "sensor")))]
#[inline]
fn next_byte() -> Option<u8> {
    BYTES.take()
}

/// PendSV's own: packets, words, events, windows.
pub struct Receiving {
    #[cfg(any(feature = "usb", not(feature = "sensor")))]
    link: Link,
    #[cfg(feature = "sensor")]
    sensor: Option<SensorSource<'static>>,
    ingest: Ingest<'static>,
}

impl Receiving {
    /// Before the first byte.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            #[cfg(any(feature = "usb", not(feature = "sensor")))]
            link: Link::new(),
            #[cfg(feature = "sensor")]
            sensor: None,
            ingest: Ingest::new(),
        }
    }

    /// PendSV.
    pub fn on_pend(&mut self) {
        let stopwatch = Stopwatch::start();
        if self.ingest.is_setting_up()
            && let Some((setup, windows)) = SET_UP.take()
        {
            self.ingest.set_up(&setup, windows);
        }
        #[cfg(feature = "usb")]
        self.restart();
        self.poll();
        // Also where the ring stays full: requests are to be answered however long the encoder is busy.
        #[cfg(feature = "usb")]
        board::resume_receiving();
        stopwatch.stop_interrupt();
    }

    #[cfg(feature = "sensor")]
    fn poll(&mut self) {
        if self.sensor.is_none() {
            self.sensor = sensor::start();
        }
        let Some(sensor) = &mut self.sensor else {
            return;
        };
        // On USB a host may set up how the sensor's events are encoded.
        #[cfg(feature = "usb")]
        let sensor = &mut sensor.with_host(self.link.source(next_byte));
        self.ingest.poll(sensor, &mut Queues);
        #[cfg(feature = "usb")]
        self.count();
    }

    /// Leaves out what is left of a session that is over.
    #[cfg(feature = "usb")]
    fn restart(&mut self) {
        if RESTARTED.swap(false, Ordering::Acquire) {
            let bytes = BYTES.skip_to(SESSION_BEGIN.load(Ordering::Relaxed));
            self.link.restart(bytes);
        }
    }

    #[cfg(not(feature = "sensor"))]
    fn poll(&mut self) {
        let mut source = self.link.source(next_byte);
        self.ingest.poll(&mut source, &mut Queues);
        self.count();
        #[cfg(not(feature = "usb"))]
        if BYTES.len() < RING_BYTES / 2 {
            board::resume_receiving();
        }
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
