//! Simulated cameras that are controlled by the registers of their logic.

use super::registers::RegisterFile;
use crate::device::Stream;
use crate::device::stream_endpoint::StreamEndpoint;
use crate::link::control::Request;
use crate::peripheral::descriptors::{Device, Endpoint, Interface};
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// Creates the descriptors of a camera with one vendor-class interface. `ids` are vendor, product and release;
/// `names` are manufacturer, product and serial number.
pub fn descriptors(
    speed: Speed,
    ids: (u16, u16, u16),
    names: [&str; 3],
    endpoints: &[Endpoint],
) -> Descriptors {
    let (vendor, product, release) = ids;
    Device {
        speed,
        vendor,
        product,
        release,
        class: [0xFF, 0, 0],
        names,
        interfaces: &[Interface::vendor(0, endpoints)],
        ..Device::default()
    }
    .describe()
}

/// Returns the interrupt endpoint for the firmware's own messages, polled every 125 us.
pub const fn messages(address: u8) -> Endpoint {
    Endpoint::interrupt(address, 64, 1)
}

/// A camera controlled by registers of its logic.
pub struct LogicCamera {
    descriptors: Descriptors,
    registers: RegisterFile,
    stream: StreamEndpoint,
    endpoint: u8,
    /// Returns whether the registers let the camera send.
    runs: fn(&RegisterFile) -> bool,
}

impl LogicCamera {
    pub fn new(
        speed: Speed,
        ids: (u16, u16, u16),
        product: &str,
        endpoints: &[Endpoint],
        registers: RegisterFile,
        runs: fn(&RegisterFile) -> bool,
        stream: Box<dyn Stream>,
    ) -> Self {
        let names = ["iniVation", product, "00000001"];
        Self {
            descriptors: descriptors(speed, ids, names, endpoints),
            registers,
            stream: StreamEndpoint::new(stream),
            endpoint: super::registers::ENDPOINT,
            runs,
        }
    }
}

impl Peripheral for LogicCamera {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        let reply = self.registers.control(request, data, length);
        self.stream.set_running((self.runs)(&self.registers));
        if self.registers.take_time_reset() {
            self.stream.reset_time();
        }
        reply
    }

    fn bulk_out(&mut self, _: u8, _: &[u8]) -> bool {
        false
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != self.endpoint {
            // The endpoint for the firmware's own messages has none to send.
            return Bulk::Wait;
        }
        self.stream.send(room, data)
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == self.endpoint {
            self.stream.clear_halt();
        }
    }

    fn reset(&mut self) {
        self.registers.reset();
        self.stream.set_running(false);
        self.stream.clear_halt();
    }
}
