//! The device end of a USB cable: simulated devices, down to their descriptors.
//!
//! A [`Peripheral`] answers a host's requests. Separate modules carry those requests: inside the process, over
//! usbredir to a virtual machine, over USB/IP to a kernel, or to a program whose libusb has a library before it.
//!
//! ```text
//! descriptors  a device's descriptors, from a few lines
//! standard     the requests of chapter 9, for any device
//! attached     a device on its bus: requests, halts, transfers in flight
//! usbredir     ... for QEMU's usb-redir device
//! usbip        ... for Linux's vhci-hcd
//! usbfs        ... for a program on this machine, through umockdev's library
//! socket       one host at the other end of a socket
//! server       hosts that come and go, over TCP; unix_server over a Unix socket
//! stream       a recording as the bytes that a device sends, at its pace
//! sequence     a device with a known stream, for tests
//! class_bus    the firmware's own USB class as a device, on the bus in memory of wire
//! ```

pub mod attached;
pub mod descriptors;
pub mod sequence;
pub mod server;
pub mod socket;
pub mod standard;
pub mod stream;
#[cfg(unix)]
pub mod unix_server;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub mod usbfs;
pub mod usbip;
pub mod usbredir;

pub mod class_bus;
pub mod wire;

use crate::link::control::Request;

/// Speed of a USB bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Speed {
    /// 12 Mbit/s.
    Full,
    /// 480 Mbit/s.
    High,
    /// 5 Gbit/s.
    Super,
}

/// Descriptors of a device, as the bytes of USB 2.0, 9.6 and USB 3.2, 9.6.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Descriptors {
    /// Device descriptor.
    pub device: Vec<u8>,
    /// The only configuration, with its interfaces and endpoints.
    pub configuration: Vec<u8>,
    /// Binary object store; empty if the device has none.
    pub bos: Vec<u8>,
    /// Strings from number 1 on, in English.
    pub strings: Vec<String>,
    /// Speed at which the device connects.
    pub speed: Speed,
}

/// Answer to a control request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// Data of a request that reads; empty for a request that sends.
    Data(Vec<u8>),
    /// The request is refused with a protocol stall.
    Stall,
}

/// Result of a bulk transfer to the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bulk {
    /// Bytes were appended. If they are fewer than the room, a short or empty last packet ends the transfer.
    Data,
    /// No data yet: the transfer waits (NAK).
    Wait,
    /// The endpoint is halted.
    Stall,
}

/// A simulated device.
pub trait Peripheral: Send {
    /// Returns the descriptors of the device.
    fn descriptors(&self) -> &Descriptors;

    /// Answers a request that is not a standard request. `data` are the bytes sent with it; the answer may have at
    /// most `length` bytes.
    fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply;

    /// Returns whether a bulk endpoint accepts bytes now; if not, the host is held off (NAK).
    fn is_ready(&self, _endpoint: u8) -> bool {
        true
    }

    /// Accepts bytes for a bulk endpoint; returns `false` if the endpoint is halted.
    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool;

    /// Fills a transfer of at most `room` bytes from a bulk endpoint.
    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk;

    /// Informs the device that the host has cleared a halt.
    fn clear_halt(&mut self, endpoint: u8);

    /// Informs the device that the host has set the configuration again, or has reset the bus.
    fn reset(&mut self);
}
