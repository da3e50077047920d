//! The machines. Each file sets one up and has the same items.

#[cfg(feature = "microbit")]
mod microbit;
#[cfg(feature = "mps2")]
mod mps2;
#[cfg(feature = "stm32f405")]
mod stm32f405;

#[cfg(feature = "microbit")]
pub use microbit::*;
#[cfg(feature = "mps2")]
pub use mps2::*;
#[cfg(feature = "stm32f405")]
pub use stm32f405::*;
