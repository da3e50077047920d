//! STM32F405 (Cortex-M4F, 168 MHz). Its link is in `usart.rs`, or with the feature `usb` in `otg.rs`.

use stm32f4::stm32f405::{IWDG, Peripherals, RCC};

use crate::fault;

/// Name of the machine.
pub const NAME: &str = "stm32f405";
/// Processor clock in hertz.
pub const CLOCK_HZ: u32 = 168_000_000;

/// Frequency of the board's crystal in MHz, from which the 48 MHz of USB are made: 12 on the pyboard 1.1 and on the
/// Feather STM32F405 Express. `EECVS_CRYSTAL_MHZ` at build time sets another one.
#[cfg(feature = "usb")]
const CRYSTAL_MHZ: u8 = crystal(option_env!("EECVS_CRYSTAL_MHZ"));

/// Reads of the clock control after which a crystal counts as missing: over 100 ms; data sheets say 2 ms.
#[cfg(feature = "usb")]
const CRYSTAL_READS: u32 = 1_000_000;

/// Reads of the clock control after which the multiplier counts as broken: some 100 ms; data sheets say 300 us.
const CLOCK_READS: u32 = 1_000_000;

#[cfg(feature = "usb")]
const fn crystal(text: Option<&str>) -> u8 {
    let Some(text) = text else { return 12 };
    let mhz = match text.as_bytes() {
        [ones] if ones.is_ascii_digit() => *ones - b'0',
        [tens, ones] if tens.is_ascii_digit() && ones.is_ascii_digit() => {
            (*tens - b'0') * 10 + (*ones - b'0')
        }
        _ => 0,
    };
    assert!(
        mhz >= 4 && mhz <= 26,
        "EECVS_CRYSTAL_MHZ must be a whole number from 4 to 26"
    );
    mhz
}

/// Returns whether this is an emulator, which takes semihosting calls. The real chip runs from its internal
/// oscillator after a reset and says so in the clock control; in QEMU that register reads 0.
#[must_use]
pub fn is_emulated() -> bool {
    // SAFETY: this reads a register without side effects.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.cr().read().hsirdy().bit_is_clear()
}

/// Whether the interrupt that cannot be masked is the watchdog's: it is the clock's, when a crystal fails.
pub const UNMASKED_IS_WATCHDOG: bool = false;

/// Ticks of the watchdog's clock, nominally 1 kHz: from 0.34 to 0.94 s, as its oscillator has 17 to 47 kHz.
const WATCHDOG_TICKS: u16 = 500;

/// Starts the independent watchdog, which nothing but a reset stops; a debugger holds it.
pub fn start_watchdog() {
    // SAFETY: nothing else uses this peripheral, nor these bits of the debug unit.
    let device = unsafe { Peripherals::steal() };
    device
        .DBGMCU
        .apb1_fz()
        .modify(|_, w| w.dbg_iwdg_stop().set_bit());
    watchdog_key(START);
    watchdog_key(CHANGE);
    device.IWDG.pr().write(|w| w.pr().divide_by32());
    device.IWDG.rlr().write(|w| w.rl().set(WATCHDOG_TICKS));
    feed_watchdog();
}

/// Lets the watchdog begin anew.
pub fn feed_watchdog() {
    watchdog_key(FEED);
}

/// Keys of the watchdog: it starts; its clock may be set; it begins anew.
const START: u16 = 0xcccc;
const CHANGE: u16 = 0x5555;
const FEED: u16 = 0xaaaa;

fn watchdog_key(key: u16) {
    // SAFETY: a write of this register has no effect but that of its key, and these are keys.
    unsafe { (*IWDG::ptr()).kr().write(|w| w.key().bits(key)) };
}

/// Returns whether the watchdog, which leaves no record, restarted the chip; forgets it.
#[must_use]
pub fn take_watchdog_reset() -> bool {
    // SAFETY: nothing else uses this register after a reset.
    let csr = unsafe { &*RCC::ptr() }.csr();
    let is_it = csr.read().wdgrstf().bit_is_set();
    csr.modify(|_, w| w.rmvf().set_bit());
    is_it
}

/// Source of the main clock's 168 MHz.
#[derive(Debug, Clone, Copy)]
struct Source {
    is_crystal: bool,
    /// Divides the source down to at most 2 MHz, which `multiplier` makes 336 MHz.
    divider: u8,
    multiplier: u16,
}

/// 168 MHz from the internal oscillator, which every board has: 16 MHz / 8 * 168 / 2. The 48 MHz made of it are too
/// inaccurate for USB.
const INTERNAL: Source = Source {
    is_crystal: false,
    divider: 8,
    multiplier: 168,
};

/// Starts 168 MHz, and 48 MHz for USB, from the crystal: 1 MHz * 336 / 2 and / 7. Without a crystal, starts as
/// without the feature `usb`.
#[cfg(feature = "usb")]
pub(super) fn start_clock(device: &Peripherals) {
    let rcc = &device.RCC;
    rcc.cr().modify(|_, w| w.hseon().on());
    let is_there = (0..CRYSTAL_READS).any(|_| rcc.cr().read().hserdy().is_ready());
    if is_there {
        start(
            device,
            Source {
                is_crystal: true,
                divider: CRYSTAL_MHZ,
                multiplier: 336,
            },
        );
    } else {
        start(device, INTERNAL);
        defmt::error!(
            "no crystal found: USB may fail; the image was built for a crystal of {=u8} MHz",
            CRYSTAL_MHZ
        );
    }
}

/// Starts 168 MHz from the internal oscillator.
#[cfg(not(feature = "usb"))]
pub(super) fn start_clock(device: &Peripherals) {
    start(device, INTERNAL);
}

fn start(device: &Peripherals, source: Source) {
    let rcc = &device.RCC;
    // Five wait states at 168 MHz and 3.3 V; instruction cache, data cache and prefetch.
    device.FLASH.acr().write(|w| {
        w.latency().ws5();
        w.icen().enabled().dcen().enabled().prften().enabled()
    });
    rcc.cfgr().modify(|_, w| {
        // Peripheral buses: at most 42 MHz and 84 MHz.
        w.ppre1().div4().ppre2().div2()
    });
    rcc.pllcfgr().write(|w| {
        w.pllsrc().bit(source.is_crystal);
        // SAFETY: the values are within 2..=63, 50..=432 and 2..=15.
        unsafe {
            w.pllm().bits(source.divider);
            w.plln().bits(source.multiplier);
            w.pllq().bits(7)
        };
        w.pllp().div2()
    });
    rcc.cr().modify(|_, w| w.pllon().on());
    wait(|| rcc.cr().read().pllrdy().is_ready());
    rcc.cfgr().modify(|_, w| w.sw().pll());
    wait(|| rcc.cfgr().read().sws().is_pll());
}

/// Waits for the clock; without it the link has no rate, and another start may have more luck.
fn wait(is_done: impl Fn() -> bool) {
    if !(0..CLOCK_READS).any(|_| is_done()) {
        defmt::error!("the clock does not start");
        fault::stop();
    }
}
