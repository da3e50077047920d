//! The other end of the cable: devices that are simulated, down to their descriptors.
//!
//! A [`Peripheral`] answers what a host asks. What carries the questions stands beside it: inside the
//! process, over usbredir to a virtual machine, over USB/IP to a kernel.
//!
//! ```text
//! descriptors  what a device says of itself, from a few lines
//! standard     the requests of chapter 9, for any device
//! attached     a device on its bus: requests, halts, transfers in flight
//! usbredir     ... for QEMU's usb-redir device
//! usbip        ... for Linux' vhci-hcd
//! socket       one host at the other end of a socket
//! server       hosts that come and go, over TCP; unix_server over a Unix socket
//! stream       a recording as the bytes that a device sends, in its time
//! sequence     a device with a known stream, for tests
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
pub mod usbip;
pub mod usbredir;

pub mod class_bus;
pub mod wire;

use crate::link::control::Request;

/// Speed of a bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Speed {
    /// 12 Mbit/s.
    Full,
    /// 480 Mbit/s.
    High,
    /// 5 Gbit/s.
    Super,
}

/// What a device says of itself on a bus, as the bytes of USB 2.0, 9.6 and USB 3.2, 9.6.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Descriptors {
    /// Device descriptor.
    pub device: Vec<u8>,
    /// Its only configuration, with interfaces and endpoints.
    pub configuration: Vec<u8>,
    /// Binary object store, where it has one.
    pub bos: Vec<u8>,
    /// Strings from number 1 on, in English.
    pub strings: Vec<String>,
    /// Speed at which it connects.
    pub speed: Speed,
}

/// Answer to a control request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// Data for a request that asks; empty for one that sends.
    Data(Vec<u8>),
    /// The request is refused: a protocol stall.
    Stall,
}

/// What a bulk endpoint to the host has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bulk {
    /// Bytes were appended; a short or empty last packet ends the transfer where they are fewer than
    /// its room.
    Data,
    /// Nothing yet: the transfer waits (NAK).
    Wait,
    /// The endpoint is halted.
    Stall,
}

/// A device that is simulated.
pub trait Peripheral: Send {
    /// Its descriptors.
    fn descriptors(&self) -> &Descriptors;

    /// A request that is not the standard's own, with the bytes that were sent; `length` is how many
    /// it may answer with.
    fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply;

    /// Whether a bulk endpoint takes bytes now; where not, the host is held (NAK).
    fn is_ready(&self, _endpoint: u8) -> bool {
        true
    }

    /// Bytes for one of its bulk endpoints; `false` where that is halted.
    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool;

    /// A transfer of at most `room` bytes from one of its bulk endpoints.
    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk;

    /// The host has ended a halt.
    fn clear_halt(&mut self, endpoint: u8);

    /// The host has set the configuration anew, or the bus was reset.
    fn reset(&mut self);
}
