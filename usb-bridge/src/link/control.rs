//! Control requests: queries and commands to a device, apart from its stream.

use std::time::Duration;

use super::LinkError;

/// The setup packet of a control request without its length field (USB 2.0, 9.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Request {
    /// `bmRequestType`: direction, type and recipient.
    pub kind: u8,
    /// `bRequest`.
    pub request: u8,
    /// `wValue`.
    pub value: u16,
    /// `wIndex`.
    pub index: u16,
}

impl Request {
    /// `bmRequestType` of a vendor request to the device.
    pub const VENDOR_OUT: u8 = 0x40;
    /// `bmRequestType` of a vendor request from the device.
    pub const VENDOR_IN: u8 = 0xC0;

    /// Creates a vendor request that sends data to the device.
    #[must_use]
    pub const fn vendor_out(request: u8, value: u16, index: u16) -> Self {
        Self {
            kind: Self::VENDOR_OUT,
            request,
            value,
            index,
        }
    }

    /// Creates a vendor request that reads data from the device.
    #[must_use]
    pub const fn vendor_in(request: u8, value: u16, index: u16) -> Self {
        Self {
            kind: Self::VENDOR_IN,
            request,
            value,
            index,
        }
    }

    /// Returns whether data flows to the host.
    #[must_use]
    pub const fn is_in(self) -> bool {
        self.kind & 0x80 != 0
    }
}

/// The control side of a device: endpoint 0, and bulk endpoints that carry commands.
pub trait Control {
    /// Sends `data` with a request.
    /// Sends `data` with a control request.
    ///
    /// # Errors
    /// The device refused the request, or is gone.
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError>;

    /// Reads up to `data.len()` bytes with a control request; returns the number of bytes received.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError>;

    /// Sends `data` to a bulk endpoint that takes commands.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError>;

    /// Reads an answer from a bulk endpoint for commands; returns the number of bytes received.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError>;

    /// Clears the halt of an endpoint.
    ///
    /// # Errors
    /// As for [`Control::control_out`].
    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError>;

    /// Waits between two steps, as the device requires; a simulated device may skip the wait.
    fn wait(&mut self, duration: Duration);

    /// Returns `bcdDevice`, the release number of the device.
    fn release(&self) -> u16;

    /// Returns the serial number from the device's string descriptor, if it has one.
    fn serial(&mut self) -> Option<String>;

    /// Returns the name used in messages.
    fn name(&self) -> &str;
}
