//! The STM32F405's link over USB: its OTG controller at full speed, 12 Mbit/s.
//!
//! | pin | signal |
//! |---|---|
//! | PA11 | D- |
//! | PA12 | D+ |
//!
//! The controller's interrupt moves packets: from an endpoint to the ring that PendSV reads, and from the queue
//! that `main` fills to an endpoint. All endpoints from the host share one queue in the controller, and its first
//! packet blocks all others, control requests included, until it is taken. So a packet is always taken, and the
//! host is held before there is no room: with NAK, on the endpoint itself.

use core::cell::Cell;
use core::{mem, str};

use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use eecvs_usb_class::{
    Device, FROM_HOST, Outgoing, PACKET_BYTES, Port, SERIAL_BYTES, TO_HOST, serial_number,
};
use static_cell::{ConstStaticCell, StaticCell};
use stm32f4::stm32f405::{Interrupt, OTG_FS_DEVICE, OTG_FS_GLOBAL, Peripherals, RCC, interrupt};
use synopsys_usb_otg::{UsbBus, UsbPeripheral};
use usb_device::bus::UsbBusAllocator;
use usb_device::endpoint::EndpointAddress;

use super::stm32f405::{CLOCK_HZ, is_emulated, start_clock};
use crate::clock::ShortStopwatch;
use crate::{receiving, watchdog};

/// Words for packets from the host: one packet for each endpoint, and one for the control endpoint.
const RECEIVE_WORDS: usize = 3 * PACKET_BYTES / 4;
/// Room that is kept free: the controller may take a packet between the two packets that it reports, and between
/// its driver's "go on" and the hold that follows it.
const RESERVE_BYTES: usize = 4 * PACKET_BYTES;
/// Size of the controller's own memory in words, 1.25 KiB.
const CONTROLLER_WORDS: usize = 320;
/// Words of it that the driver uses: packets from the host with what belongs to them, and a packet for each of the
/// four endpoints to the host, of at least 16 words.
const USED_WORDS: usize = RECEIVE_WORDS + 30 + 4 * 16;
const _: () = assert!(USED_WORDS <= CONTROLLER_WORDS);
/// Alternate function of the OTG controller on port A.
const AF10: u8 = 10;
/// Address of the chip's unique number of 96 bits.
const UNIQUE_NUMBER: *const [u32; 3] = 0x1FFF_7A10 as *const _;

/// The controller, as its driver needs it.
#[derive(Debug)]
struct Otg(());

// SAFETY: the registers are those of the OTG controller, which only its driver and this module use; this module
// uses them such that the driver's use is not disturbed. The figures are the chip's.
unsafe impl UsbPeripheral for Otg {
    const REGISTERS: *const () = OTG_FS_GLOBAL::ptr().cast();
    const HIGH_SPEED: bool = false;
    const FIFO_DEPTH_WORDS: usize = CONTROLLER_WORDS;
    const ENDPOINT_COUNT: usize = 4;

    fn enable() {
        // SAFETY: called once, while the driver is created, before any interrupt uses these registers.
        let rcc = unsafe { &*RCC::ptr() };
        rcc.ahb2enr().modify(|_, w| w.otgfsen().enabled());
        rcc.ahb2rstr().modify(|_, w| w.otgfsrst().reset());
        rcc.ahb2rstr().modify(|_, w| w.otgfsrst().clear_bit());
    }

    fn ahb_frequency_hz(&self) -> u32 {
        CLOCK_HZ
    }
}

type Bus = UsbBus<Otg>;
type Link = Device<'static, Bus, ToEncoder>;

/// The link, until the interrupt takes it.
static LINK: Mutex<Cell<Option<&'static mut Link>>> = Mutex::new(Cell::new(None));

/// The way from the USB class to PendSV.
struct ToEncoder {
    /// Whether the endpoints from the host are held.
    held: bool,
}

fn endpoints() -> &'static stm32f4::stm32f405::otg_fs_device::RegisterBlock {
    // SAFETY: this module changes these registers only in the controller's interrupt, where the driver runs too,
    // one after the other.
    unsafe { &*OTG_FS_DEVICE::ptr() }
}

impl ToEncoder {
    /// Holds the host if there may be no room for what it sends, else lets it go on.
    fn hold(&mut self) {
        let hold = receiving::room() < RESERVE_BYTES;
        // Repeated while it is held, as the driver lets the endpoint go on after each packet.
        if hold || self.held {
            let endpoints = endpoints();
            for endpoint in [endpoints.doep1(), endpoints.doep2()] {
                // Enabling and disabling happen only where 1 is written, whatever the bits read as.
                endpoint.ctl().modify(|_, w| {
                    w.epena().clear_bit().epdis().clear_bit();
                    match hold {
                        true => w.snak().set_bit(),
                        false => w.cnak().set_bit(),
                    }
                });
            }
            self.held = hold;
        }
    }
}

impl Port for ToEncoder {
    fn room(&self) -> usize {
        receiving::room()
    }

    fn put(&mut self, bytes: &[u8]) {
        receiving::put(bytes);
    }

    fn restart(&mut self) {
        receiving::restart();
    }

    fn renumber(&mut self, endpoint: EndpointAddress) {
        let endpoints = endpoints();
        match (endpoint.is_in(), endpoint.index()) {
            (true, at @ (1 | 3)) => {
                let endpoint = match at {
                    1 => endpoints.diep1(),
                    _ => endpoints.diep3(),
                };
                endpoint.ctl().modify(|_, w| {
                    w.epena().clear_bit().epdis().clear_bit();
                    w.sd0pid_sevnfrm().set_bit()
                });
            }
            (false, at @ (1 | 2)) => {
                let endpoint = match at {
                    1 => endpoints.doep1(),
                    _ => endpoints.doep2(),
                };
                endpoint.ctl().modify(|_, w| {
                    w.epena().clear_bit().epdis().clear_bit();
                    w.sd0pid_sevnfrm().set_bit()
                });
            }
            _ => {}
        }
    }
}

/// Sending half of the link.
pub struct Sender(eecvs_usb_class::Sender<'static>);

/// Sets up clocks, pins and the controller. Returns `None` on a second call, and in an emulator, which has no such
/// controller.
pub fn set_up(_: &mut cortex_m::Peripherals) -> Option<Sender> {
    let device = Peripherals::take()?;
    if is_emulated() {
        defmt::error!("this image needs a board: QEMU has no USB controller of the STM32F405");
        return None;
    }
    start_clock(&device);
    device.RCC.ahb1enr().modify(|_, w| w.gpioaen().enabled());
    let port = &device.GPIOA;
    port.afrh().modify(|_, w| {
        // SAFETY: every value of four bits is an alternate function.
        unsafe { w.afrh11().bits(AF10).afrh12().bits(AF10) }
    });
    port.ospeedr().modify(|_, w| {
        w.ospeedr11()
            .very_high_speed()
            .ospeedr12()
            .very_high_speed()
    });
    port.moder()
        .modify(|_, w| w.moder11().alternate().moder12().alternate());
    let (link, sender) = connect()?;
    critical_section::with(|token| LINK.borrow(token).set(Some(link)));
    Some(Sender(sender))
}

#[inline(never)]
fn connect() -> Option<(&'static mut Link, eecvs_usb_class::Sender<'static>)> {
    static RECEIVED: ConstStaticCell<[u32; RECEIVE_WORDS]> =
        ConstStaticCell::new([0; RECEIVE_WORDS]);
    static OUTGOING: ConstStaticCell<Outgoing> = ConstStaticCell::new(Outgoing::new());
    static SERIAL: ConstStaticCell<[u8; SERIAL_BYTES]> = ConstStaticCell::new([0; SERIAL_BYTES]);
    static ALLOCATOR: StaticCell<UsbBusAllocator<Bus>> = StaticCell::new();
    static DEVICE: StaticCell<Link> = StaticCell::new();

    // SAFETY: these are three words of the chip's own memory, which can always be read.
    let unique = unsafe { UNIQUE_NUMBER.read_volatile() };
    let serial = SERIAL.try_take()?;
    *serial = serial_number(unique);
    let serial: &'static str = str::from_utf8(serial).ok()?;
    let (sender, fetcher) = OUTGOING.try_take()?.split();
    let allocator = ALLOCATOR.try_init(UsbBus::new(Otg(()), RECEIVED.try_take()?))?;
    let port = ToEncoder { held: false };
    let link = Device::new(allocator, fetcher, port, serial)?;
    Some((DEVICE.try_init(link)?, sender))
}

impl Sender {
    /// Makes later messages belong to the host's current session.
    pub fn follow(&mut self) {
        self.0.follow();
    }

    /// Sends all bytes as one message; returns once the queue has taken the last one. If nobody is there to listen,
    /// they are dropped and counted. If a host is there but does not read, this waits, and the setup decides what
    /// happens to events meanwhile.
    pub fn send(&mut self, bytes: &[u8]) {
        if cfg!(feature = "sensor") {
            // No host begins with a setup here.
            self.0.follow();
        }
        let mut asked = false;
        self.0.send(bytes, || {
            // Once started, the interrupt continues by itself with each packet that the host takes.
            if !mem::replace(&mut asked, true) {
                NVIC::pend(Interrupt::OTG_FS);
            }
            watchdog::feed();
            // The timer's interrupt ends the sleep at the latest.
            cortex_m::asm::wfi();
            true
        });
        NVIC::pend(Interrupt::OTG_FS);
    }
}

/// Returns how often bytes were lost because they were not read in time: never, as the host is held.
pub fn overruns() -> u32 {
    0
}

/// Takes received packets, also after these were held.
pub fn resume_receiving() {
    NVIC::pend(Interrupt::OTG_FS);
    // SAFETY: the interrupt shares data only through queues.
    unsafe { NVIC::unmask(Interrupt::OTG_FS) };
}

#[interrupt]
fn OTG_FS() {
    static mut OWN: Option<&'static mut Link> = None;
    let stopwatch = ShortStopwatch::start();
    if OWN.is_none() {
        *OWN = critical_section::with(|token| LINK.borrow(token).take());
    }
    if let Some(link) = OWN {
        link.poll();
        link.port().hold();
        if link.port().room() < PACKET_BYTES {
            // A packet that cannot be taken would raise this interrupt for ever. PendSV, which runs at least with
            // every interrupt of the timer, raises it again.
            NVIC::mask(Interrupt::OTG_FS);
        }
    }
    stopwatch.stop_interrupt();
}

const _: () = assert!(TO_HOST == 0x81 && FROM_HOST == 0x01);
