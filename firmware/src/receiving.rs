//! Bytes from the link to windows: the interrupts' side.

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::SCB;
use cortex_m::peripheral::scb::SystemHandler;
use critical_section::Mutex;
use eecvs_nostd::Window;
use eecvs_nostd::event_link::Setup;
use eecvs_nostd::ingest::{Exchange, Ingest, Work};
#[cfg(not(feature = "sensor"))]
use eecvs_nostd::link_source::Link;
#[cfg(feature = "sensor")]
use eecvs_nostd::sensor_source::SensorSource;
use heapless::spsc::{Consumer, Producer, Queue};

use crate::board;
use crate::clock::{ShortStopwatch, Stopwatch};
#[cfg(feature = "sensor")]
use crate::sensor;

/// Bytes between the UART's interrupt and PendSV: two of the longest packets.
#[cfg(not(feature = "sensor"))]
const RING_BYTES: usize = 1024;
/// Bytes in the ring that PendSV is asked to look at.
const MANY_BYTES: usize = 128;
/// The lowest priority there is.
const LOWEST: u8 = 0xff;

/// Where the UART's interrupt puts bytes.
pub type Bytes = Producer<'static, u8>;

/// PendSV's ends of the queues.
pub struct Receiving {
    source: Source,
    ingest: Ingest<'static>,
    queues: Queues,
}

/// Where events come from.
struct Source {
    #[cfg(not(feature = "sensor"))]
    bytes: Consumer<'static, u8>,
    #[cfg(not(feature = "sensor"))]
    link: Link,
    #[cfg(feature = "sensor")]
    sensor: SensorSource<'static>,
}

impl Source {
    #[cfg(feature = "sensor")]
    fn poll(&mut self, ingest: &mut Ingest<'static>, queues: &mut Queues) {
        ingest.poll(&mut self.sensor, queues);
    }

    #[cfg(not(feature = "sensor"))]
    fn poll(&mut self, ingest: &mut Ingest<'static>, queues: &mut Queues) {
        ingest.poll(&mut self.link.source(|| self.bytes.dequeue()), queues);
        DAMAGED_BYTES.store(self.link.damaged_bytes(), Ordering::Relaxed);
        IGNORED.store(self.link.ignored(), Ordering::Relaxed);
        if self.bytes.len() < RING_BYTES / 2 {
            board::resume_receiving();
        }
    }
}

struct Queues {
    free: Consumer<'static, Window<'static>>,
    work: Producer<'static, Work<'static>>,
    set_up: Consumer<'static, (Setup, usize)>,
}

impl Exchange<'static> for Queues {
    fn free(&mut self) -> Option<Window<'static>> {
        self.free.dequeue()
    }

    fn has_room(&self) -> bool {
        self.work.ready()
    }

    fn hand_over(&mut self, work: Work<'static>) {
        // There is room.
        let _ = self.work.enqueue(work);
    }
}

/// `main`'s ends of the queues.
pub struct Receiver {
    free: Producer<'static, Window<'static>>,
    work: Consumer<'static, Work<'static>>,
    set_up: Producer<'static, (Setup, usize)>,
}

impl Receiver {
    /// What is to be done next.
    pub fn work(&mut self) -> Option<Work<'static>> {
        self.work.dequeue()
    }

    /// Sleeps until an interrupt, unless there is work.
    pub fn wait(&self) {
        // An interrupt that comes before the sleep stays pending and ends it.
        cortex_m::interrupt::disable();
        if !self.work.ready() {
            cortex_m::asm::wfi();
        }
        // SAFETY: enabled before, and no critical section is open here.
        unsafe { cortex_m::interrupt::enable() };
    }

    /// Gives a window back.
    pub fn free(&mut self, window: Window<'static>) {
        // There is room for every window.
        let _ = self.free.enqueue(window);
        SCB::set_pendsv();
    }

    /// Tells that the setup is done and `windows` windows follow.
    pub fn set_up(&mut self, setup: &Setup, windows: usize) {
        // One setup at a time.
        let _ = self.set_up.enqueue((*setup, windows));
        SCB::set_pendsv();
    }
}

/// Ends of the queues on their way to the interrupts that use them.
static BYTES: Mutex<RefCell<Option<Bytes>>> = Mutex::new(RefCell::new(None));
static RECEIVING: Mutex<RefCell<Option<Receiving>>> = Mutex::new(RefCell::new(None));

/// What [`Link`] counts, for the status.
static DAMAGED_BYTES: AtomicU32 = AtomicU32::new(0);
static IGNORED: AtomicU32 = AtomicU32::new(0);

/// Bytes of the link that belonged to no packet.
pub fn damaged_bytes() -> u32 {
    DAMAGED_BYTES.load(Ordering::Relaxed)
}

/// Packets that came twice or made no sense, and left-over bytes.
pub fn ignored() -> u32 {
    IGNORED.load(Ordering::Relaxed)
}

/// Sets the queues up and starts the interrupts. `None` when called again.
pub fn start(core: &mut Peripherals) -> Option<Receiver> {
    #[cfg(feature = "sensor")]
    let source = Source {
        sensor: sensor::start()?,
    };
    #[cfg(not(feature = "sensor"))]
    let source = {
        let (into_ring, bytes) =
            cortex_m::singleton!(: Queue<u8, RING_BYTES> = Queue::new())?.split();
        critical_section::with(|token| BYTES.borrow(token).replace(Some(into_ring)));
        Source {
            bytes,
            link: Link::new(),
        }
    };
    let (give_free, free) =
        cortex_m::singleton!(: Queue<Window<'static>, 4> = Queue::new())?.split();
    let (hand_over, work) = cortex_m::singleton!(: Queue<Work<'static>, 5> = Queue::new())?.split();
    let (tell, set_up) = cortex_m::singleton!(: Queue<(Setup, usize), 2> = Queue::new())?.split();
    critical_section::with(|token| {
        RECEIVING.borrow(token).replace(Some(Receiving {
            source,
            ingest: Ingest::new(),
            queues: Queues {
                free,
                work: hand_over,
                set_up,
            },
        }))
    });
    // SAFETY: nothing here relies on priorities for exclusion: every queue has one user at each
    // end.
    unsafe { core.SCB.set_priority(SystemHandler::PendSV, LOWEST) };
    if cfg!(feature = "sensor") {
        // The setup is there already.
        SCB::set_pendsv();
    } else {
        board::resume_receiving();
    }
    Some(Receiver {
        free: give_free,
        work,
        set_up: tell,
    })
}

/// The UART's interrupt: takes every byte that is there. PendSV runs when there are many, or with
/// the timer's next interrupt.
///
/// `bytes` is the interrupt's own; the first call fetches it.
pub fn on_receive(bytes: &mut Option<Bytes>) {
    let stopwatch = ShortStopwatch::start();
    if bytes.is_none() {
        *bytes = critical_section::with(|token| BYTES.borrow(token).take());
    }
    if let Some(bytes) = bytes {
        // A full ring leaves bytes in the UART, whose flow control then holds the sender.
        while bytes.ready() {
            let Some(byte) = board::read_byte() else {
                break;
            };
            let _ = bytes.enqueue(byte);
        }
        if bytes.len() >= MANY_BYTES {
            SCB::set_pendsv();
            if !bytes.ready() {
                board::hold_receiving();
            }
        }
    }
    stopwatch.stop_interrupt();
}

/// PendSV: packets, words, events, windows. `receiving` is its own; the first call fetches it.
pub fn on_pend(receiving: &mut Option<Receiving>) {
    let stopwatch = Stopwatch::start();
    if receiving.is_none() {
        *receiving = critical_section::with(|token| RECEIVING.borrow(token).take());
    }
    if let Some(Receiving {
        source,
        ingest,
        queues,
    }) = receiving
    {
        if ingest.is_setting_up()
            && let Some((setup, windows)) = queues.set_up.dequeue()
        {
            ingest.set_up(&setup, windows);
        }
        source.poll(ingest, queues);
    }
    stopwatch.stop_interrupt();
}
