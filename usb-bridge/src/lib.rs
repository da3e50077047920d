//! USB links to event cameras and to the encoder's own microcontroller (MCU): capture, forward, simulate.
//!
//! The modules follow the path of the bytes:
//!
//! ```text
//! camera or MCU -> link -> device (bytes to events) -> encoder -> frames -> consumers
//! recording -> device (events to bytes) -> peripheral -> link -> ...        (a simulated camera)
//! ```
//!
//! [`device`] holds what is known of each model: how to find, start and stop it, how to parse its stream and how to
//! write that stream, so that any recording can be played by a simulated camera. [`link`] moves bytes: over libusb,
//! a serial port or TCP, or inside the process. Fault injection and traces can wrap any link. [`peripheral`] is the
//! device end of a USB cable, for simulated devices. [`session`] runs a device, [`live`] reads its events and
//! [`forward`] sends frames or raw packets to consumers.

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
pub mod resolve;
pub mod session;
pub mod source;
pub mod stop;
pub mod unix_socket;
pub mod usage;
