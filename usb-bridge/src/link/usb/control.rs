//! The control side of a USB device.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use super::device::Opened;
use crate::link::LinkError;
use crate::link::control::{Control, Request};

/// A device that does not answer within this time has failed: the longest that USB 2.0 allows (9.2.6.1), which a host
/// that is busy may take as well.
const ANSWER: Duration = Duration::from_secs(5);

/// Sends control requests and commands to an opened device.
#[derive(Debug, Clone)]
pub struct UsbControl {
    opened: Arc<Opened>,
}

impl UsbControl {
    pub(super) fn new(opened: Arc<Opened>) -> Self {
        Self { opened }
    }

    fn error(&self, step: &str, error: rusb::Error) -> LinkError {
        self.opened.error(step, error)
    }

    fn short(&self, step: &str, sent: usize, of: usize) -> LinkError {
        LinkError::Failed {
            link: self.opened.name.clone(),
            cause: format!("{step}: the device accepted {sent} of {of} bytes"),
        }
    }
}

/// Formats a request for messages.
fn step(request: Request) -> String {
    format!(
        "request {:#04x} (value {:#06x}, index {:#06x})",
        request.request, request.value, request.index
    )
}

/// Formats a command's endpoint for messages.
fn command(endpoint: u8) -> String {
    format!("command over endpoint {endpoint:#04x}")
}

impl Control for UsbControl {
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError> {
        let Request {
            kind,
            request: number,
            value,
            index,
        } = request;
        let sent = self
            .opened
            .handle
            .write_control(kind, number, value, index, data, ANSWER)
            .map_err(|error| self.error(&step(request), error))?;
        if sent == data.len() {
            Ok(())
        } else {
            Err(self.short(&step(request), sent, data.len()))
        }
    }

    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        let Request {
            kind,
            request: number,
            value,
            index,
        } = request;
        self.opened
            .handle
            .read_control(kind, number, value, index, data, ANSWER)
            .map_err(|error| self.error(&step(request), error))
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError> {
        let sent = self
            .opened
            .handle
            .write_bulk(endpoint, data, ANSWER)
            .map_err(|error| self.error(&command(endpoint), error))?;
        if sent == data.len() {
            Ok(())
        } else {
            Err(self.short(&command(endpoint), sent, data.len()))
        }
    }

    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError> {
        self.opened
            .handle
            .read_bulk(endpoint, data, ANSWER)
            .map_err(|error| self.error(&command(endpoint), error))
    }

    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError> {
        self.opened
            .handle
            .clear_halt(endpoint)
            .map_err(|error| self.error("clearing a halt", error))
    }

    fn wait(&mut self, duration: Duration) {
        thread::sleep(duration);
    }

    fn release(&self) -> u16 {
        self.opened.release
    }

    fn serial(&mut self) -> Option<String> {
        if let Some(serial) = &self.opened.serial {
            return Some(serial.clone());
        }
        let handle = &self.opened.handle;
        let descriptor = handle.device().device_descriptor().ok()?;
        handle.read_serial_number_string_ascii(&descriptor).ok()
    }

    fn name(&self) -> &str {
        &self.opened.name
    }
}
