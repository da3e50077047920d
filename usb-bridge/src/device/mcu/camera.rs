//! A simulated encoder whose sensor has its own port. It accepts a setup that asks for what it does anyway, and
//! refuses others. Between a host's restart and setup it is silent; its stream then begins anew.

use std::collections::VecDeque;

use eecvs_nostd::Sensor;
use eecvs_nostd::event_link::{
    FIELDS_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, Receiver, Refusal, Setup, Status,
};

use super::write;
use super::{COUNTS, COUNTS_BYTES, COUNTS_LAYOUT, FROM_HOST, IDENTITY, RESTART, TO_HOST};
use crate::device::Stream;
use crate::device::stream_endpoint::StreamEndpoint;
use crate::link::control::Request;
use crate::peripheral::descriptors::{Device, Endpoint, Interface};
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// Most bytes of answers that wait for the host; further answers are dropped.
const ANSWERS_MAX: usize = 1 << 14;

/// A simulated encoder.
pub struct McuCamera {
    descriptors: Descriptors,
    stream: StreamEndpoint,
    sensor: Sensor,
    receiver: Receiver,
    /// Answers that wait for the host.
    answers: VecDeque<u8>,
    sessions: u32,
    bytes_sent: u32,
    bytes_received: u32,
}

impl McuCamera {
    /// Creates an encoder that sends `stream`, with a sensor of this size.
    #[must_use]
    pub fn new(sensor: Sensor, stream: Box<dyn Stream>) -> Self {
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
        let mut stream = StreamEndpoint::new(stream);
        stream.set_running(true);
        Self {
            descriptors,
            stream,
            sensor,
            receiver: Receiver::new(),
            answers: VecDeque::new(),
            sessions: 1,
            bytes_sent: 0,
            bytes_received: 0,
        }
    }

    /// Takes a packet of the event link; only setups are answered.
    fn take(&mut self, kind: Kind, body: &[u8]) {
        let Some(setup) = Setup::parse(body).filter(|_| kind == Kind::Setup) else {
            return;
        };
        let own = write::config(self.sensor);
        let refusal = match setup.config() {
            Err(refusal) => Some(refusal),
            Ok(asked) if asked.window.sensor != own.window.sensor => Some(Refusal::Sensor),
            Ok(asked) if asked.window != own.window => Some(Refusal::Windows),
            // Settings of the coefficients do not matter for this stream.
            Ok(asked) if asked.mode != own.mode || asked.bytes_per_second.is_some() => {
                Some(Refusal::Mode)
            }
            Ok(asked) if asked.filter != own.filter => Some(Refusal::Mode),
            Ok(_) => None,
        };
        self.stream.set_running(refusal.is_none());
        let status = Status {
            answers: kind as u8,
            running: refusal.is_none(),
            refusal,
            window_events: write::WINDOW_EVENTS as u32,
            frame_bytes: write::FRAME_BYTES as u32,
            ..Status::default()
        };
        let (mut body, mut packet) = ([0; FIELDS_BYTES_MAX], [0; PACKET_BYTES_MAX]);
        let Ok(length) = status.write(&mut body) else {
            return;
        };
        let status = Packet {
            kind: Kind::Status,
            position: 0,
            body: &body[..length],
        };
        if let Ok(length) = status.write(&mut packet)
            && self.answers.len() < ANSWERS_MAX
        {
            self.answers.extend(&packet[..length]);
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
                self.sessions = self.sessions.wrapping_add(1);
                self.answers.clear();
                self.stream.set_running(false);
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
        if endpoint != FROM_HOST {
            return false;
        }
        self.bytes_received = self.bytes_received.wrapping_add(data.len() as u32);
        for byte in data {
            let packet = self.receiver.push(*byte);
            if let Some((kind, body)) = packet.map(|packet| (packet.kind, packet.body.to_vec())) {
                self.take(kind, &body);
            }
        }
        true
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != TO_HOST {
            return Bulk::Stall;
        }
        if !self.answers.is_empty() {
            let length = self.answers.len().min(room);
            data.extend(self.answers.drain(..length));
            self.bytes_sent = self.bytes_sent.wrapping_add(length as u32);
            return Bulk::Data;
        }
        let before = data.len();
        let sent = self.stream.send(room, data);
        self.bytes_sent = self.bytes_sent.wrapping_add((data.len() - before) as u32);
        sent
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == TO_HOST {
            self.stream.clear_halt();
        }
    }

    fn reset(&mut self) {
        self.sessions = self.sessions.wrapping_add(1);
        self.receiver.restart();
        self.answers.clear();
        self.stream.set_running(false);
        self.stream.set_running(true);
    }
}
