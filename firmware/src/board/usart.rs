//! The STM32F405's link over USART1: 3 Mbaud with hardware flow control.
//!
//! | pin | signal |
//! |---|---|
//! | PA9 | TX |
//! | PA10 | RX |
//! | PA11 | CTS, pulled down: unconnected, the link sends without asking |
//! | PA12 | RTS |

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use stm32f4::stm32f405::{Interrupt, Peripherals, USART1, interrupt};

use super::stm32f405::{is_emulated, start_clock};
use crate::{receiving, watchdog};

/// 84 MHz / 28 = 3 Mbaud, in sixteenths of a bit.
const BAUD_DIVIDER: u16 = 28;
/// Alternate function of USART1 on port A.
const AF7: u8 = 7;

static OVERRUNS: AtomicU32 = AtomicU32::new(0);

fn usart() -> &'static stm32f4::stm32f405::usart1::RegisterBlock {
    // SAFETY: each register used here is a single word, read or written at once. The interrupt reads data, `main`
    // writes data, and the rest is set once before both.
    unsafe { &*USART1::ptr() }
}

/// Sending half of the link.
#[derive(Debug)]
pub struct Sender(());

/// Sets up clocks, pins and the UART. Returns `None` on a second call.
pub fn set_up(_: &mut cortex_m::Peripherals) -> Option<Sender> {
    let device = Peripherals::take()?;
    if !is_emulated() {
        start_clock(&device);
    }
    device.RCC.ahb1enr().modify(|_, w| w.gpioaen().enabled());
    device.RCC.apb2enr().modify(|_, w| w.usart1en().enabled());
    let port = &device.GPIOA;
    port.afrh().modify(|_, w| {
        // SAFETY: every value of four bits is an alternate function.
        unsafe {
            w.afrh9().bits(AF7);
            w.afrh10().bits(AF7);
            w.afrh11().bits(AF7);
            w.afrh12().bits(AF7)
        }
    });
    port.pupdr()
        .modify(|_, w| w.pupdr10().pull_up().pupdr11().pull_down());
    port.ospeedr()
        .modify(|_, w| w.ospeedr9().high_speed().ospeedr12().high_speed());
    port.moder().modify(|_, w| {
        w.moder9().alternate().moder10().alternate();
        w.moder11().alternate().moder12().alternate()
    });
    let usart = usart();
    // SAFETY: with the clock above, this divider gives the baud rate.
    usart
        .brr()
        .write(|w| unsafe { w.div_mantissa().bits(BAUD_DIVIDER).div_fraction().bits(0) });
    usart.cr3().write(|w| w.rtse().enabled().ctse().enabled());
    usart.cr1().write(|w| {
        w.te().enabled().re().enabled();
        w.rxneie().enabled().ue().enabled()
    });
    Some(Sender(()))
}

impl Sender {
    /// Does nothing: all that is sent is for the current host, as this link has only one.
    pub fn follow(&mut self) {}

    /// Sends all bytes; returns once the UART has taken the last one.
    pub fn send(&mut self, bytes: &[u8]) {
        let usart = usart();
        for byte in bytes {
            while usart.sr().read().txe().bit_is_clear() {
                watchdog::feed();
            }
            usart.dr().write(|w| w.dr().set(u16::from(*byte)));
        }
    }
}

/// Returns the next received byte, if there is one.
pub fn read_byte() -> Option<u8> {
    let usart = usart();
    let status = usart.sr().read();
    if status.ore().bit_is_set() {
        // No other code writes it. Reading the data below clears the flag.
        OVERRUNS.store(
            OVERRUNS.load(Ordering::Relaxed).wrapping_add(1),
            Ordering::Relaxed,
        );
    }
    if status.rxne().bit_is_clear() {
        if status.ore().bit_is_set() {
            let _ = usart.dr().read();
        }
        return None;
    }
    Some(usart.dr().read().dr().bits() as u8)
}

/// Returns how often bytes were lost because they were not read in time.
pub fn overruns() -> u32 {
    OVERRUNS.load(Ordering::Relaxed)
}

/// Masks the receive interrupt, so that received bytes stay in the UART, whose flow control then holds the sender.
pub fn hold_receiving() {
    NVIC::mask(Interrupt::USART1);
}

/// Unmasks the receive interrupt, after [`hold_receiving`] or at the start.
pub fn resume_receiving() {
    // SAFETY: the interrupt shares data only through queues.
    unsafe { NVIC::unmask(Interrupt::USART1) };
}

#[interrupt]
fn USART1() {
    receiving::on_receive();
}
