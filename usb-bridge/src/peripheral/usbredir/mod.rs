//! usbredir: a device for QEMU's `usb-redir`; this is the side that has the device (its "usb-host").
//!
//! A packet consists of a header and a body, in little-endian:
//!
//! | bytes | header |
//! |---|---|
//! | 4 | type |
//! | 4 | length of the body |
//! | 4, or 8 once both sides have announced `64bits_ids` | id, which an answer repeats |
//!
//! Each side begins with a hello; then the device's side describes the device and connects it. Transfers to the
//! host may wait as long as the device has no data: each is answered when its data is due, and many can wait.
//! Interrupt endpoints are silent; isochronous endpoints, streams and buffered receiving are refused.

mod wire;

use anyhow::{Result, bail};

use super::attached::{Attached, Status};
use super::descriptors::Transfer;
use super::socket::{Change, Input, Report, Session};
use super::{Peripheral, Reply, Speed};
use crate::link::control::Request;
use wire::{capability, packet, status};

/// Most bytes in the body of a packet; a longer one is a protocol error.
pub const BODY_MAX: usize = 1 << 20;

/// Number of entries in the tables of interfaces and endpoints.
const TABLE: usize = 32;

/// Size of the name in the hello, in bytes.
const NAME: usize = 64;

/// State of the cable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plug {
    /// No device is connected.
    Out,
    /// The host was informed that the device left, and has not acknowledged it.
    Leaving,
    /// The device is connected.
    In,
}

/// A session with a host, and the device that it has.
pub struct UsbRedir {
    device: Option<Attached>,
    plug: Plug,
    /// The host's capabilities, once its hello has arrived.
    peer: Option<u32>,
    input: Input,
    output: Vec<u8>,
    data: Vec<u8>,
    /// Counts of devices that are gone.
    report: Report,
}

impl UsbRedir {
    /// Starts a session without a device; the hello is queued for sending.
    #[must_use]
    pub fn new() -> Self {
        let mut session = Self {
            device: None,
            plug: Plug::Out,
            peer: None,
            input: Input::default(),
            output: Vec::new(),
            data: Vec::new(),
            report: Report::default(),
        };
        let mut name = [0; NAME];
        let text = concat!("usb-bridge ", env!("CARGO_PKG_VERSION")).as_bytes();
        name[..text.len()].copy_from_slice(text);
        session.send(packet::HELLO, 0, &[&name, &capability::OURS.to_le_bytes()]);
        session
    }

    /// Starts a session like [`UsbRedir::new`], with a device that is connected after the host's hello.
    #[must_use]
    pub fn with(peripheral: Box<dyn Peripheral>) -> Self {
        let mut session = Self::new();
        session.device = Some(Attached::new(peripheral));
        session
    }

    /// Returns whether both sides have announced a capability.
    fn both(&self, capability: u32) -> bool {
        self.peer.unwrap_or(0) & capability::OURS & capability != 0
    }

    fn send(&mut self, kind: u32, id: u64, parts: &[&[u8]]) {
        let length: usize = parts.iter().map(|part| part.len()).sum();
        self.output.extend(kind.to_le_bytes());
        self.output.extend((length as u32).to_le_bytes());
        if self.both(capability::LONG_IDS) {
            self.output.extend(id.to_le_bytes());
        } else {
            self.output.extend((id as u32).to_le_bytes());
        }
        for part in parts {
            self.output.extend_from_slice(part);
        }
    }

    /// Announces the device to the host, once its hello has arrived and it has acknowledged that the previous
    /// device left.
    fn connect(&mut self) {
        if self.peer.is_none() || self.plug != Plug::Out || self.device.is_none() {
            return;
        }
        self.send_interfaces();
        self.send_endpoints();
        let Some(device) = &self.device else { return };
        let descriptors = device.peripheral().descriptors();
        let speed = match descriptors.speed {
            Speed::Full => 1,
            Speed::High => 2,
            Speed::Super => 3,
        };
        let mut body = [0; 10];
        body[0] = speed;
        // Class, subclass, protocol; vendor, product, release.
        if let Some(fields) = descriptors.device.get(4..7) {
            body[1..4].copy_from_slice(fields);
        }
        if let Some(fields) = descriptors.device.get(8..14) {
            body[4..10].copy_from_slice(fields);
        }
        let length = if self.both(capability::DEVICE_VERSION) {
            10
        } else {
            8
        };
        self.send(packet::DEVICE_CONNECT, 0, &[&body[..length]]);
        self.plug = Plug::In;
    }

    /// Removes the device.
    fn disconnect(&mut self) {
        if let Some(device) = self.device.take() {
            self.report.traffic.add(device.traffic());
        }
        if self.plug == Plug::In {
            self.send(packet::DEVICE_DISCONNECT, 0, &[]);
            self.plug = if self.both(capability::DISCONNECT_ACK) {
                Plug::Leaving
            } else {
                Plug::Out
            };
        }
    }

    fn send_interfaces(&mut self) {
        let Some(device) = &self.device else { return };
        let mut count = 0_u32;
        let mut body = [[0_u8; TABLE]; 4];
        for one in &device.layout().interfaces {
            let is_active = device.standard().setting(one.number) == Some(one.setting);
            if !is_active || count as usize == TABLE {
                continue;
            }
            let place = count as usize;
            body[0][place] = one.number;
            for (row, part) in (1..).zip(one.class) {
                body[row][place] = part;
            }
            count += 1;
        }
        let parts = [&count.to_le_bytes()[..], body.as_flattened()];
        self.send(packet::INTERFACE_INFO, 0, &parts);
    }

    fn send_endpoints(&mut self) {
        let Some(device) = &self.device else { return };
        let mut transfers = [255; TABLE];
        let mut intervals = [0; TABLE];
        let mut interfaces = [0; TABLE];
        let mut packets = [0; 2 * TABLE];
        // Endpoint 0, in both directions.
        transfers[0] = Transfer::Control as u8;
        transfers[16] = Transfer::Control as u8;
        for one in &device.layout().endpoints {
            if device.standard().setting(one.interface) != Some(one.setting) {
                continue;
            }
            let place = usize::from(one.address & 0x0F | (one.address & 0x80) >> 3);
            transfers[place] = one.transfer as u8;
            // 0 is not a valid interval for a polled endpoint.
            let is_polled = one.transfer == Transfer::Interrupt;
            intervals[place] = if is_polled { one.interval.max(1) } else { 0 };
            interfaces[place] = one.interface;
            packets[2 * place..2 * place + 2].copy_from_slice(&one.packet.to_le_bytes());
        }
        let packets: &[u8] = if self.both(capability::ENDPOINT_PACKETS) {
            &packets
        } else {
            &[]
        };
        let parts = [&transfers[..], &intervals, &interfaces, packets];
        self.send(packet::ENDPOINT_INFO, 0, &parts);
    }

    /// Takes the next packet; returns `false` if it is incomplete.
    fn packet(&mut self) -> Result<bool> {
        let is_long = self.both(capability::LONG_IDS);
        let header = if is_long { 16 } else { 12 };
        let rest = self.input.rest();
        let Some((fields, _)) = rest.split_at_checked(header) else {
            return Ok(false);
        };
        let word = |at: usize| {
            let bytes = [fields[at], fields[at + 1], fields[at + 2], fields[at + 3]];
            u32::from_le_bytes(bytes)
        };
        let (kind, length) = (word(0), word(4) as usize);
        let id = u64::from(word(8))
            | if is_long {
                u64::from(word(12)) << 32
            } else {
                0
            };
        if length > BODY_MAX {
            bail!(
                "usbredir: received a packet of type {kind} with {length} bytes: the host speaks \
                 another protocol"
            );
        }
        if self.peer.is_none() && kind != packet::HELLO {
            bail!(
                "usbredir: received a packet of type {kind} before the hello: the host speaks another protocol"
            );
        }
        if rest.len() < header + length {
            return Ok(false);
        }
        let mut input = std::mem::take(&mut self.input);
        if let Some(bytes) = input.take(header + length) {
            self.answer(kind, id, &bytes[header..]);
        }
        self.input = input;
        Ok(true)
    }

    fn answer(&mut self, kind: u32, id: u64, body: &[u8]) {
        let is_understood = match kind {
            packet::HELLO => self.hello(body),
            packet::DISCONNECT_ACK if self.plug == Plug::Leaving => {
                self.plug = Plug::Out;
                self.connect();
                true
            }
            packet::FILTER => true,
            packet::FILTER_REJECT => {
                self.report.is_rejected = true;
                true
            }
            // Sent by the host before it knew that the device had left.
            _ if self.plug != Plug::In => true,
            _ => self.ask_device(kind, id, body),
        };
        self.report.packets_odd += u64::from(!is_understood);
    }

    fn hello(&mut self, body: &[u8]) -> bool {
        let Some((_, capabilities)) = body.split_at_checked(NAME) else {
            return false;
        };
        if self.peer.is_some() {
            return false;
        }
        let first = match *capabilities {
            [a, b, c, d, ..] => u32::from_le_bytes([a, b, c, d]),
            _ => 0,
        };
        self.peer = Some(first);
        self.connect();
        true
    }

    /// Handles a packet for the device; returns `false` if it is not understood.
    fn ask_device(&mut self, kind: u32, id: u64, body: &[u8]) -> bool {
        let Some(device) = &mut self.device else {
            return true;
        };
        match (kind, body) {
            (packet::RESET, _) => {
                let waiting = device.cancel_all();
                device.reset();
                for (id, endpoint) in waiting {
                    self.send_bulk(id, endpoint, status::CANCELLED, 0);
                }
            }
            (packet::SET_CONFIGURATION, &[value]) => {
                let done = request(device, 0x00, 9, u16::from(value), 0).is_some();
                let now = device.standard().configuration();
                self.send_interfaces();
                self.send_endpoints();
                self.send(
                    packet::CONFIGURATION_STATUS,
                    id,
                    &[&[stall_unless(done), now]],
                );
            }
            (packet::GET_CONFIGURATION, _) => {
                let now = device.standard().configuration();
                self.send(packet::CONFIGURATION_STATUS, id, &[&[status::SUCCESS, now]]);
            }
            (packet::SET_SETTING, &[interface, setting]) => {
                let index = u16::from(interface);
                let done = request(device, 0x01, 11, u16::from(setting), index).is_some();
                let now = device.standard().setting(interface).unwrap_or(0);
                if done {
                    self.send_interfaces();
                    self.send_endpoints();
                }
                let answer = [stall_unless(done), interface, now];
                self.send(packet::SETTING_STATUS, id, &[&answer]);
            }
            (packet::GET_SETTING, &[interface]) => {
                let now = device.standard().setting(interface);
                let answer = [stall_unless(now.is_some()), interface, now.unwrap_or(0)];
                self.send(packet::SETTING_STATUS, id, &[&answer]);
            }
            (packet::START_INTERRUPT | packet::STOP_INTERRUPT, &[endpoint]) => {
                let is_there = device
                    .standard()
                    .endpoint(endpoint)
                    .is_some_and(|one| one.transfer == Transfer::Interrupt);
                let answer = if is_there {
                    status::SUCCESS
                } else {
                    status::INVALID
                };
                self.send(packet::INTERRUPT_STATUS, id, &[&[answer, endpoint]]);
            }
            (packet::START_ISOCHRONOUS | packet::STOP_ISOCHRONOUS, &[endpoint, ..]) => {
                let answer = [status::INVALID, endpoint];
                self.send(packet::ISOCHRONOUS_STATUS, id, &[&answer]);
            }
            (packet::ALLOCATE_STREAMS | packet::FREE_STREAMS, &[a, b, c, d, ..]) => {
                let answer = [a, b, c, d, 0, 0, 0, 0, status::INVALID];
                self.send(packet::STREAMS_STATUS, id, &[&answer]);
            }
            (packet::CANCEL, _) => {
                // If the transfer has ended already, its answer is on the way.
                if let Some(endpoint) = device.cancel(id) {
                    self.send_bulk(id, endpoint, status::CANCELLED, 0);
                }
            }
            (packet::CONTROL, _) => return self.control(id, body),
            (packet::BULK, _) => return self.bulk(id, body),
            (packet::INTERRUPT, &[endpoint, _, low, high, ..]) => {
                let answer = [endpoint, status::INVALID, low, high];
                self.send(packet::INTERRUPT, id, &[&answer]);
            }
            _ => return false,
        }
        true
    }

    fn control(&mut self, id: u64, body: &[u8]) -> bool {
        let Some((&[endpoint, asked, kind, _, v0, v1, i0, i1, l0, l1], data)) =
            body.split_first_chunk()
        else {
            return false;
        };
        let Some(device) = &mut self.device else {
            return true;
        };
        let length = u16::from_le_bytes([l0, l1]);
        let asked = Request {
            kind,
            request: asked,
            value: u16::from_le_bytes([v0, v1]),
            index: u16::from_le_bytes([i0, i1]),
        };
        // A request to the host comes without data; one from the host with all the data it announces.
        let expected = if asked.is_in() {
            0
        } else {
            usize::from(length)
        };
        let (answer, bytes) = if data.len() != expected || endpoint & 0x0F != 0 {
            (status::INVALID, Vec::new())
        } else {
            match device.control(asked, data, length) {
                Reply::Data(bytes) => (status::SUCCESS, bytes),
                Reply::Stall => (status::STALL, Vec::new()),
            }
        };
        let done = match (answer, asked.is_in()) {
            (status::SUCCESS, false) => length,
            // At most the length that was requested.
            _ => bytes.len() as u16,
        };
        let mut header = [0; 10];
        header.copy_from_slice(&body[..10]);
        header[3] = answer;
        header[8..10].copy_from_slice(&done.to_le_bytes());
        self.send(packet::CONTROL, id, &[&header, &bytes]);
        answer != status::INVALID
    }

    fn bulk(&mut self, id: u64, body: &[u8]) -> bool {
        let header = if self.both(capability::LONG_BULK) {
            10
        } else {
            8
        };
        let Some((fields, data)) = body.split_at_checked(header) else {
            return false;
        };
        let Some(device) = &mut self.device else {
            return true;
        };
        let endpoint = fields[0];
        let [high0, high1] = fields.get(8..10).map_or([0; 2], |high| [high[0], high[1]]);
        let length = u32::from_le_bytes([fields[2], fields[3], high0, high1]) as usize;
        if endpoint & 0x80 != 0 {
            let is_good = data.is_empty();
            if !is_good || !device.submit(id, endpoint, length) {
                self.send_bulk(id, endpoint, status::STALL, 0);
            }
            return is_good;
        }
        if data.len() != length {
            self.send_bulk(id, endpoint, status::INVALID, 0);
            return false;
        }
        let (answer, done) = match device.bulk_out(endpoint, data) {
            Status::Done => (status::SUCCESS, length),
            _ => (status::STALL, 0),
        };
        self.send_bulk(id, endpoint, answer, done);
        true
    }

    /// Ends a bulk transfer without data.
    fn send_bulk(&mut self, id: u64, endpoint: u8, answer: u8, length: usize) {
        self.send_bulk_data(id, endpoint, answer, length, &[]);
    }

    fn send_bulk_data(&mut self, id: u64, endpoint: u8, answer: u8, length: usize, data: &[u8]) {
        let [low0, low1, high0, high1] = (length as u32).to_le_bytes();
        let fields = [endpoint, answer, low0, low1, 0, 0, 0, 0, high0, high1];
        let header = if self.both(capability::LONG_BULK) {
            10
        } else {
            8
        };
        self.send(packet::BULK, id, &[&fields[..header], data]);
    }

    /// Ends the next transfer whose data is due.
    fn transfer(&mut self) -> bool {
        let Some(device) = &mut self.device else {
            return false;
        };
        if self.plug != Plug::In {
            return false;
        }
        let mut data = std::mem::take(&mut self.data);
        let done = device.poll(&mut data);
        if let Some(done) = done {
            let answer = match done.status {
                Status::Done => status::SUCCESS,
                Status::Stalled => status::STALL,
                Status::Overflow => status::BABBLE,
            };
            self.send_bulk_data(done.ticket, done.endpoint, answer, data.len(), &data);
        }
        self.data = data;
        done.is_some()
    }
}

impl Default for UsbRedir {
    fn default() -> Self {
        Self::new()
    }
}

impl Session for UsbRedir {
    fn receive(&mut self, bytes: &[u8]) {
        self.input.append(bytes);
    }

    fn step(&mut self) -> Result<bool> {
        Ok(self.packet()? || self.transfer())
    }

    fn output(&mut self) -> &mut Vec<u8> {
        &mut self.output
    }

    fn waits(&self) -> bool {
        self.device.as_ref().is_some_and(|one| one.waiting() > 0)
    }

    fn change(&mut self, change: Change) -> bool {
        self.disconnect();
        match change {
            Change::Plug(peripheral) => {
                self.device = Some(Attached::new(peripheral));
                self.connect();
                true
            }
            Change::Unplug => true,
            Change::End => false,
        }
    }

    fn report(&self) -> Report {
        let mut report = self.report;
        if let Some(device) = &self.device {
            report.traffic.add(device.traffic());
        }
        report
    }
}

/// Sends a standard request without data to the device.
fn request(device: &mut Attached, kind: u8, asked: u8, value: u16, index: u16) -> Option<()> {
    let asked = Request {
        kind,
        request: asked,
        value,
        index,
    };
    (device.control(asked, &[], 0) != Reply::Stall).then_some(())
}

fn stall_unless(done: bool) -> u8 {
    if done { status::SUCCESS } else { status::STALL }
}
