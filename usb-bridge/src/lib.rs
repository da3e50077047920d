//! The USB link of event cameras and of the encoder's own microcontroller: capture, forward, simulate.
//!
//! The files follow the bytes:
//!
//! ```text
//! camera or MCU -> link -> device (bytes to events) -> encoder -> frames -> consumers
//! recording -> device (events to bytes) -> peripheral -> link -> ...        (a simulated camera)
//! ```
//!
//! [`device`] has what is known of each model: how it is found, started and stopped, how its stream
//! is read, and how it is written, which makes a simulated camera of any recording. [`link`] moves
//! bytes: over libusb, a serial port, TCP, or inside the process, with faults and traces around any
//! of them. [`peripheral`] is the other end of a USB cable, for devices that are only simulated.

pub mod clock;
pub mod cmd;
pub mod device;
pub mod encoder;
pub mod forward;
pub mod link;
pub mod live;
pub mod peripheral;
pub mod pump;
pub mod queue;
pub mod record;
pub mod session;
pub mod source;
pub mod stop;
pub mod usage;
