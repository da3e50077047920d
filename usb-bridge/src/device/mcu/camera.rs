//! A simulated encoder with a sensor on a port of its own: what a host sends it, it takes and leaves.

use super::{COUNTS, COUNTS_BYTES, COUNTS_LAYOUT, FROM_HOST, IDENTITY, RESTART, TO_HOST};
use crate::device::{Due, Stream};
use crate::link::control::Request;
use crate::peripheral::descriptors::{Device, Endpoint, Interface};
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// A simulated encoder.
pub struct McuCamera {
    descriptors: Descriptors,
    stream: Box<dyn Stream>,
    has_ended: bool,
    is_halted: bool,
    sessions: u32,
    bytes_sent: u32,
    bytes_received: u32,
}

impl McuCamera {
    /// An encoder that sends `stream`.
    #[must_use]
    pub fn new(stream: Box<dyn Stream>) -> Self {
        let endpoints = [Endpoint::bulk(TO_HOST), Endpoint::bulk(FROM_HOST)];
        let descriptors = Device {
            speed: Speed::Full,
            vendor: IDENTITY.vendor,
            product: IDENTITY.product,
            release: 0x0010,
            names: ["EECVS", "EECVS event encoder", "000000000000000000000001"],
            interfaces: &[Interface::vendor(0, &endpoints)],
            ..Device::default()
        }
        .describe();
        Self {
            descriptors,
            stream,
            has_ended: false,
            is_halted: false,
            sessions: 1,
            bytes_sent: 0,
            bytes_received: 0,
        }
    }
}

impl Peripheral for McuCamera {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, _: &[u8], length: usize) -> Reply {
        match (request.kind, request.request) {
            (Request::VENDOR_IN, COUNTS) => {}
            (Request::VENDOR_OUT, RESTART) => {
                self.reset();
                return Reply::Data(Vec::new());
            }
            _ => return Reply::Stall,
        }
        let mut counts = [0; COUNTS_BYTES];
        counts[0] = COUNTS_LAYOUT;
        for (at, count) in [
            (4, self.sessions),
            (12, self.bytes_sent),
            (24, self.bytes_received),
        ] {
            counts[at..at + 4].copy_from_slice(&count.to_le_bytes());
        }
        Reply::Data(counts[..length.min(COUNTS_BYTES)].to_vec())
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        self.bytes_received = self.bytes_received.wrapping_add(data.len() as u32);
        endpoint == FROM_HOST
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != TO_HOST || self.is_halted {
            return Bulk::Stall;
        }
        if self.has_ended {
            return Bulk::Wait;
        }
        let before = data.len();
        match self.stream.take(room, data) {
            Ok(Due::More) => {}
            Ok(Due::Ended) => self.has_ended = true,
            Err(_) => {
                self.is_halted = true;
                return Bulk::Stall;
            }
        }
        self.bytes_sent = self.bytes_sent.wrapping_add((data.len() - before) as u32);
        if data.len() == before {
            Bulk::Wait
        } else {
            Bulk::Data
        }
    }

    fn clear_halt(&mut self, _: u8) {}

    fn reset(&mut self) {
        self.sessions = self.sessions.wrapping_add(1);
    }
}
