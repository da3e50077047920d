//! USB on the encoder's microcontroller: carries frames and packets to the host, and packets from it.
//!
//! The device has two functions, one of which has the encoder at a time:
//!
//! | function | interfaces | endpoints | for |
//! |---|---|---|---|
//! | vendor's own (0xFF) | 0 | bulk IN 0x81, bulk OUT 0x01 | libusb, WinUSB |
//! | serial port (CDC-ACM) | 1, 2 | interrupt IN 0x82, bulk IN 0x83, bulk OUT 0x02 | programs for serial ports only |
//!
//! Both carry the same bytes: docs/wire-format.md, "Frame" and "Event link". A setup packet at the start of a USB
//! packet gives the encoder to the function on which it arrives; whatever arrives on the other function is refused
//! and counted. Both functions fit the smallest controller supported, that of an STM32F405, which has three
//! endpoints to the host besides the control endpoint, so one image serves both.
//!
//! | file | content |
//! |---|---|
//! | `identity.rs` | numbers and strings by which a host recognises the device |
//! | `microsoft.rs` | descriptors by which Windows loads WinUSB without being asked |
//! | `requests.rs` | the vendor's control requests, and what the device counts |
//! | `outgoing.rs` | messages to packets: the queue between the encoder and the bus |
//! | `function.rs` | the vendor's function: its interface, endpoints and requests |
//! | `device.rs` | the whole device, polled from its interrupt |
//!
//! The USB stack is `usb-device`, on any controller for which there is a `UsbBus`. No byte and no request from a
//! host makes this crate panic, wait or allocate.
//!
//! A *session* is what one host does with the encoder. It begins with a bus reset, when the configuration is set,
//! with a restart request, and when the encoder moves to the other function. Anything still under way is then
//! dropped and counted.
#![no_std]

mod device;
mod function;
mod identity;
mod microsoft;
mod outgoing;
mod requests;

pub use device::{Device, Port};
pub use identity::{
    DEVICE_INTERFACE, MANUFACTURER, PRODUCT, RELEASE, SERIAL_BYTES, SERIAL_NAME,
    VENDOR_AND_PRODUCT, VENDOR_NAME, serial_number,
};
pub use microsoft::{DESCRIPTOR_SET, PLATFORM_CAPABILITY};
pub use outgoing::{Fetcher, Outgoing, QUEUE_PACKETS, Sender};
pub use requests::{COUNTS, COUNTS_BYTES, Counts, DESCRIPTORS, RESTART};

/// Size in bytes of the largest packet of a bulk endpoint at full speed (12 Mbit/s).
pub const PACKET_BYTES: usize = 64;
/// Address of the vendor's bulk endpoint to the host.
pub const TO_HOST: u8 = 0x81;
/// Address of the vendor's bulk endpoint from the host.
pub const FROM_HOST: u8 = 0x01;
