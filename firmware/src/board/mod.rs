//! Machines. Each file sets one up and has the same items; the STM32F405 has a choice of two links.

#[cfg(all(feature = "mps2", not(feature = "an547")))]
mod cmsdk_watchdog;
#[cfg(feature = "microbit")]
mod microbit;
#[cfg(all(feature = "mps2", not(feature = "simulated")))]
mod mps2;
#[cfg(feature = "usb")]
mod otg;
#[cfg(feature = "simulated")]
mod simulated;
#[cfg(feature = "stm32f405")]
mod stm32f405;
#[cfg(all(feature = "stm32f405", not(feature = "usb")))]
mod usart;

#[cfg(feature = "microbit")]
pub use microbit::*;
#[cfg(all(feature = "mps2", not(feature = "simulated")))]
pub use mps2::*;
#[cfg(feature = "usb")]
pub use otg::*;
#[cfg(feature = "simulated")]
pub use simulated::*;
#[cfg(feature = "stm32f405")]
pub use stm32f405::*;
#[cfg(all(feature = "stm32f405", not(feature = "usb")))]
pub use usart::*;
