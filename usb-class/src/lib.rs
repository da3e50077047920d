//! USB on the encoder's microcontroller: frames and packets to the host, packets from it.
//!
//! One device with two functions, of which one at a time has the encoder:
//!
//! | function | interfaces | endpoints | for |
//! |---|---|---|---|
//! | vendor's own (0xFF) | 0 | bulk IN 0x81, bulk OUT 0x01 | libusb, WinUSB |
//! | serial port (CDC-ACM) | 1, 2 | interrupt IN 0x82, bulk IN 0x83, bulk OUT 0x02 | programs that know only serial ports |
//!
//! Both carry the same bytes: docs/wire-format.md, "Frame" and "Event link". A setup packet at the start
//! of a USB packet gives the encoder to the function it comes on; what comes on the other one is refused
//! and counted. Both fit the least controller this runs on, an STM32F405's with three endpoints to the
//! host beside the control endpoint, so that one image serves both.
//!
//! | file | what |
//! |---|---|
//! | `identity.rs` | numbers and strings that a host knows the device by |
//! | `microsoft.rs` | descriptors that let Windows load WinUSB by itself |
//! | `requests.rs` | the vendor's control requests, and what the device counts |
//! | `outgoing.rs` | messages to packets: the queue between the encoder and the bus |
//! | `function.rs` | the vendor's function: its interface, endpoints and requests |
//! | `device.rs` | the whole device, polled from its interrupt |
//!
//! The stack below is `usb-device`, over any controller that it has a `UsbBus` for. No byte and no
//! request of a host makes this crate panic, wait or allocate.
//!
//! A *session* is what one host does with the encoder: it begins with a bus reset, with a set
//! configuration, with a restart by request, and where the encoder changes its function. What was on its
//! way before is dropped then, and counted.
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

/// Largest packet of a bulk endpoint at full speed (12 Mbit/s).
pub const PACKET_BYTES: usize = 64;
/// Bulk endpoint of the vendor's function to the host.
pub const TO_HOST: u8 = 0x81;
/// Bulk endpoint of the vendor's function from the host.
pub const FROM_HOST: u8 = 0x01;
