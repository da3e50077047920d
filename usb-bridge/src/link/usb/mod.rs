//! USB devices, through libusb.
//!
//! [`Bus`] finds devices. [`Device`] is an opened one, with a [`control`](Device::control) side and a
//! [`stream`](Device::stream) that keeps several bulk transfers in flight. [`Watch`] reports arrivals and removals.
//!
//! To stop a device without loss, stop the device itself first, receive what it sent before until it is quiet, and
//! only then drop the stream, which cancels the transfers in flight. Cancelling a transfer while bytes arrive may
//! lose them.

mod bus;
mod choose;
mod control;
mod device;
mod errors;
mod outlet;
mod ring;
mod stream;
mod watch;

pub use bus::{Attached, Bus, Use, speed_name};
pub use choose::{Candidate, absent, choose};
pub use control::UsbControl;
pub use device::{Device, Drivers};
pub use errors::RULES_FILE;
pub use stream::UsbLink;
pub use watch::{Change, Watch, wait_for};
