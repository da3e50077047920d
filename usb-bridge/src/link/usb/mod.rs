//! Devices on USB, through libusb.
//!
//! [`Bus`] finds them, [`Device`] is one that is opened: its [`control`](Device::control) side and its
//! [`stream`](Device::stream), which has several bulk transfers in flight. [`Watch`] tells of arrivals
//! and removals.
//!
//! A device is stopped without loss in this order: the device stops, what it sent before is received
//! until it is quiet, and only then the stream is dropped, which cancels what is in flight. A transfer
//! that is cancelled while bytes arrive may lose them.

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
