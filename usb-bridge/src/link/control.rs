//! Control requests: how a device is asked and told things beside its stream.

use std::time::Duration;

use super::LinkError;

/// The eight bytes of a control request but for its length (USB 2.0, 9.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Request {
    /// Direction, type and recipient.
    pub kind: u8,
    /// `bRequest`.
    pub request: u8,
    /// `wValue`.
    pub value: u16,
    /// `wIndex`.
    pub index: u16,
}

impl Request {
    /// To the device, vendor's.
    pub const VENDOR_OUT: u8 = 0x40;
    /// From the device, vendor's.
    pub const VENDOR_IN: u8 = 0xC0;

    /// A vendor's request that sends.
    #[must_use]
    pub const fn vendor_out(request: u8, value: u16, index: u16) -> Self {
        Self {
            kind: Self::VENDOR_OUT,
            request,
            value,
            index,
        }
    }

    /// A vendor's request that asks.
    #[must_use]
    pub const fn vendor_in(request: u8, value: u16, index: u16) -> Self {
        Self {
            kind: Self::VENDOR_IN,
            request,
            value,
            index,
        }
    }

    /// Whether data goes to the host.
    #[must_use]
    pub const fn is_in(self) -> bool {
        self.kind & 0x80 != 0
    }
}

/// The control side of a device: endpoint 0, and bulk endpoints that carry commands.
pub trait Control {
    /// Sends `data` with a request.
    ///
    /// # Errors
    /// The device refused it, or is gone.
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError>;

    /// Asks for up to `data.len()` bytes; returns how many came.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError>;

    /// Sends `data` to a bulk endpoint of commands.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError>;

    /// Takes an answer from a bulk endpoint of commands; returns how many bytes came.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError>;

    /// Ends the halt of an endpoint.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError>;

    /// Waits, as a device asks for between steps; a simulated one may skip it.
    fn wait(&mut self, duration: Duration);

    /// `bcdDevice`, the release of the device.
    fn release(&self) -> u16;

    /// The device's own string of its serial number, where it has one.
    fn serial(&mut self) -> Option<String>;

    /// Name for messages.
    fn name(&self) -> &str;
}
