//! A simulated DVS128 camera.

use super::{
    BIAS_BYTES, BIASES, ENDPOINT, MASTER, PRODUCT, RESET_PIXELS, RESET_TIME, START, STOP, VENDOR,
};
use crate::device::Stream;
use crate::device::inivation::camera::descriptors;
use crate::device::inivation::registers::{DROP_DATA, LOG_LEVEL};
use crate::device::stream_endpoint::StreamEndpoint;
use crate::link::control::Request;
use crate::peripheral::descriptors::Endpoint;
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// Firmware version that the camera reports.
const RELEASE: u16 = 14;

/// A DVS128 that sends a [`Stream`] between start and stop.
pub struct Dvs128Camera {
    descriptors: Descriptors,
    stream: StreamEndpoint,
}

impl Dvs128Camera {
    /// Creates a camera as just plugged in.
    #[must_use]
    pub fn new(stream: Box<dyn Stream>) -> Self {
        Self {
            descriptors: descriptors(
                Speed::High,
                (VENDOR, PRODUCT, RELEASE),
                ["iniLabs", "DVS128", "00000001"],
                &[Endpoint::bulk(ENDPOINT)],
            ),
            stream: StreamEndpoint::new(stream),
        }
    }
}

impl Peripheral for Dvs128Camera {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, data: &[u8], _: usize) -> Reply {
        if request.kind != Request::VENDOR_OUT {
            return Reply::Stall;
        }
        let wanted = if request.request == BIASES {
            BIAS_BYTES
        } else {
            0
        };
        if data.len() != wanted {
            return Reply::Stall;
        }
        match request.request {
            START => self.stream.set_running(true),
            STOP => self.stream.set_running(false),
            RESET_TIME => self.stream.reset_time(),
            BIASES | RESET_PIXELS | MASTER | LOG_LEVEL | DROP_DATA => {}
            _ => return Reply::Stall,
        }
        Reply::Data(Vec::new())
    }

    fn bulk_out(&mut self, _: u8, _: &[u8]) -> bool {
        false
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != ENDPOINT {
            return Bulk::Stall;
        }
        self.stream.send(room, data)
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == ENDPOINT {
            self.stream.clear_halt();
        }
    }

    fn reset(&mut self) {
        self.stream.set_running(false);
        self.stream.clear_halt();
    }
}
