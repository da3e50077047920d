//! Simulated cameras: an endpoint that sends a stream, and the registers that control it.

use super::registers::RegisterFile;
use crate::device::{Due, Stream};
use crate::link::control::Request;
use crate::peripheral::descriptors::{Device, Endpoint, Interface};
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// The stream that an endpoint sends.
pub struct Source {
    stream: Box<dyn Stream>,
    ended: bool,
    halted: bool,
}

impl Source {
    pub fn new(stream: Box<dyn Stream>) -> Self {
        Self {
            stream,
            ended: false,
            halted: false,
        }
    }

    /// Sends what is due while the camera is `started`. After the end of the recording the camera stays quiet, like
    /// one that sees nothing; if the recording cannot be read, the endpoint halts.
    pub fn send(&mut self, started: bool, room: usize, data: &mut Vec<u8>) -> Bulk {
        if self.halted {
            return Bulk::Stall;
        }
        if !started || self.ended || room == 0 {
            return Bulk::Wait;
        }
        let before = data.len();
        match self.stream.take(room, data) {
            Ok(due) => self.ended = due == Due::Ended,
            Err(_) => {
                self.ended = true;
                self.halted = true;
            }
        }
        match (data.len() > before, self.halted) {
            (true, _) => Bulk::Data,
            (false, true) => Bulk::Stall,
            (false, false) => Bulk::Wait,
        }
    }

    pub fn clear_halt(&mut self) {
        self.halted = false;
    }
}

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
    source: Source,
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
            source: Source::new(stream),
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
        self.registers.control(request, data, length)
    }

    fn bulk_out(&mut self, _: u8, _: &[u8]) -> bool {
        false
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != self.endpoint {
            // The endpoint for the firmware's own messages has none to send.
            return Bulk::Wait;
        }
        let started = (self.runs)(&self.registers);
        self.source.send(started, room, data)
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == self.endpoint {
            self.source.clear_halt();
        }
    }

    fn reset(&mut self) {
        self.registers.reset();
        self.source.clear_halt();
    }
}
