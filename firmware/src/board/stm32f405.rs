//! STM32F405 (Cortex-M4F, 168 MHz).

use stm32f4::stm32f405::RCC;

/// Whether this is an emulator, which takes semihosting calls: the real chip runs from its
/// internal oscillator when it leaves reset, and says so; QEMU's reset and clock control reads 0.
#[must_use]
pub fn is_emulated() -> bool {
    // SAFETY: a read of a register that has no side effects.
    let rcc = unsafe { &*RCC::ptr() };
    rcc.cr().read().hsirdy().bit_is_clear()
}
