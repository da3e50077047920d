//! USB/IP: a device for a Linux host with vhci-hcd, over TCP.
//!
//! A connection begins with one operation, in big-endian: a list of the devices, after which the connection ends,
//! or the import of a device, which the connection carries from then on. Every packet from the host then has 48
//! bytes, followed by any data to the device; every answer has 48 bytes, followed by any data to the host.
//!
//! | bytes | every packet | then, in a submission | in its answer |
//! |---|---|---|---|
//! | 4 | command: 1 submit, 2 unlink, 3 and 4 their answers | flags | status, as -errno |
//! | 4 | number | length | bytes done |
//! | 4 | device | first frame | first frame |
//! | 4 | direction: 1 to the host | isochronous packets | isochronous packets |
//! | 4 | endpoint | interval | errors |
//! | 8 | | request of endpoint 0 | |

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use anyhow::{Context, Result, bail};

use super::attached::{Attached, Status};
use super::descriptors::Layout;
use super::socket::{Change, Input, Report, Session};
use super::{Descriptors, Peripheral, Reply, Speed};
use crate::link::control::Request;

/// TCP port that hosts try by default.
pub const PORT: u16 = 3240;

/// Bus ID of the only device: the first port of the first bus.
pub const BUS_ID: &str = "1-1";

/// Most bytes of data in a transfer to the device.
pub const DATA_MAX: usize = 1 << 20;

/// Time within which the operation must arrive.
const OPERATION_TIME: Duration = Duration::from_secs(2);

/// Version 1.1.1 of the protocol.
const VERSION: u16 = 0x0111;
const ASK_LIST: u16 = 0x8005;
const LIST: u16 = 0x0005;
const ASK_IMPORT: u16 = 0x8003;
const IMPORT: u16 = 0x0003;

/// `busnum` and `devnum`, of which the kernel composes a device's number.
const BUS: u32 = 1;
const NUMBER: u32 = 2;

const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const SUBMITTED: u32 = 3;
const UNLINKED: u32 = 4;

/// Bytes of a packet without its data.
const HEADER: usize = 48;
/// Bytes that describe an isochronous packet.
const ISOCHRONOUS: usize = 16;
/// Most isochronous packets per transfer (the kernel's limit).
const ISOCHRONOUS_MAX: usize = 1024;

/// Flag: a transfer that ends short is an error.
const SHORT_NOT_OK: u32 = 1;

/// Marks the ticket of a transfer that must not end short, beside the transfer's number.
const STRICT: u64 = 1 << 32;

/// Status codes of an answer.
mod status {
    pub const DONE: i32 = 0;
    pub const STALL: i32 = -32;
    pub const OVERFLOW: i32 = -75;
    pub const UNLINKED: i32 = -104;
    pub const SHORT: i32 = -121;
}

/// What a connection asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// It listed the devices, and ends.
    Listed,
    /// It has imported the device.
    Imported,
    /// It asked for a device that does not exist or is taken, and ends.
    Refused,
}

/// Answers the operation at the beginning of a connection; `is_free` says whether the device may be imported.
///
/// # Errors
/// No operation arrives in time, or it is unknown.
pub fn operation(
    socket: &mut TcpStream,
    descriptors: &Descriptors,
    is_free: bool,
) -> Result<Operation> {
    socket.set_nonblocking(false).context("socket")?;
    socket
        .set_read_timeout(Some(OPERATION_TIME))
        .context("socket")?;
    let mut head = [0; 8];
    socket
        .read_exact(&mut head)
        .context("USB/IP: no operation arrived")?;
    let code = u16::from_be_bytes([head[2], head[3]]);
    let mut answer = Vec::new();
    let done = match code {
        ASK_LIST => {
            begin(&mut answer, LIST, 0);
            answer.extend(1_u32.to_be_bytes());
            describe(&mut answer, descriptors);
            for one in &Layout::of(&descriptors.configuration).interfaces {
                if one.setting == 0 {
                    answer.extend(one.class);
                    answer.push(0);
                }
            }
            Operation::Listed
        }
        ASK_IMPORT => {
            let mut bus_id = [0; 32];
            socket
                .read_exact(&mut bus_id)
                .context("USB/IP: the import request does not name its device")?;
            let mut ours = [0; 32];
            ours[..BUS_ID.len()].copy_from_slice(BUS_ID.as_bytes());
            if is_free && bus_id == ours {
                begin(&mut answer, IMPORT, 0);
                describe(&mut answer, descriptors);
                Operation::Imported
            } else {
                // 2: busy. 4: no such device.
                begin(&mut answer, IMPORT, if bus_id == ours { 2 } else { 4 });
                Operation::Refused
            }
        }
        code => {
            bail!("USB/IP: unknown operation {code:#06x}: the host speaks another protocol")
        }
    };
    socket
        .write_all(&answer)
        .context("USB/IP: cannot send the answer")?;
    Ok(done)
}

fn begin(answer: &mut Vec<u8>, code: u16, status: u32) {
    answer.extend(VERSION.to_be_bytes());
    answer.extend(code.to_be_bytes());
    answer.extend(status.to_be_bytes());
}

/// Writes the device's description without its interfaces, for an operation's answer.
fn describe(answer: &mut Vec<u8>, descriptors: &Descriptors) {
    let text = |answer: &mut Vec<u8>, text: &str, length: usize| {
        let end = answer.len() + length;
        answer.extend_from_slice(text.as_bytes());
        answer.resize(end, 0);
    };
    text(answer, "/sys/devices/simulated/usb1/1-1", 256);
    text(answer, BUS_ID, 32);
    let speed: u32 = match descriptors.speed {
        Speed::Full => 2,
        Speed::High => 3,
        Speed::Super => 5,
    };
    for number in [BUS, NUMBER, speed] {
        answer.extend(number.to_be_bytes());
    }
    let device = &descriptors.device;
    let byte = |at: usize| device.get(at).copied().unwrap_or(0);
    // Vendor, product and release, which are little-endian in the descriptor.
    for at in [8, 10, 12] {
        answer.extend([byte(at + 1), byte(at)]);
    }
    answer.extend([byte(4), byte(5), byte(6)]);
    let of_configuration = |at: usize| descriptors.configuration.get(at).copied().unwrap_or(0);
    // Value of the configuration, number of configurations, number of interfaces.
    answer.extend([of_configuration(5), byte(17), of_configuration(4)]);
}

/// A host that has imported the device.
pub struct UsbIp {
    device: Attached,
    input: Input,
    output: Vec<u8>,
    data: Vec<u8>,
    packets_odd: u64,
}

impl UsbIp {
    /// Starts a session before its first packet.
    #[must_use]
    pub fn new(peripheral: Box<dyn Peripheral>) -> Self {
        Self {
            device: Attached::new(peripheral),
            input: Input::default(),
            output: Vec::new(),
            data: Vec::new(),
            packets_odd: 0,
        }
    }

    /// Takes the next packet; returns `false` if it is incomplete.
    fn packet(&mut self) -> Result<bool> {
        let Some((header, rest)) = self.input.rest().split_first_chunk::<HEADER>() else {
            return Ok(false);
        };
        let packet = Packet::of(header);
        let (data, descriptions) = packet.after()?;
        if rest.len() < data + descriptions {
            return Ok(false);
        }
        let mut input = std::mem::take(&mut self.input);
        if let Some(bytes) = input.take(HEADER + data + descriptions) {
            self.answer(&packet, &bytes[HEADER..HEADER + data], descriptions != 0);
        }
        self.input = input;
        Ok(true)
    }

    fn answer(&mut self, packet: &Packet, data: &[u8], is_isochronous: bool) {
        let number = packet.number;
        if packet.command == UNLINK {
            // If the transfer has ended already, its answer was sent before this one.
            let ticket = u64::from(packet.flags);
            let found = self.device.cancel(ticket);
            let found = found.or_else(|| self.device.cancel(ticket | STRICT));
            let status = found.map_or(status::DONE, |_| status::UNLINKED);
            self.send(UNLINKED, number, status, 0, &[]);
            return;
        }
        if is_isochronous || packet.endpoint > 15 {
            self.packets_odd += 1;
            self.send(SUBMITTED, number, status::STALL, 0, &[]);
            return;
        }
        if packet.endpoint == 0 {
            self.control(packet, data);
        } else if packet.is_in {
            let endpoint = 0x80 | packet.endpoint as u8;
            let is_strict = packet.flags & SHORT_NOT_OK != 0;
            let ticket = u64::from(number) | if is_strict { STRICT } else { 0 };
            if !self.device.submit(ticket, endpoint, packet.length) {
                self.send(SUBMITTED, number, status::STALL, 0, &[]);
            }
        } else {
            let (status, length) = match self.device.bulk_out(packet.endpoint as u8, data) {
                Status::Done => (status::DONE, data.len()),
                _ => (status::STALL, 0),
            };
            self.send(SUBMITTED, number, status, length, &[]);
        }
    }

    fn control(&mut self, packet: &Packet, data: &[u8]) {
        let [kind, request, v0, v1, i0, i1, l0, l1] = packet.setup;
        let asked = Request {
            kind,
            request,
            value: u16::from_le_bytes([v0, v1]),
            index: u16::from_le_bytes([i0, i1]),
        };
        let length = u16::from_le_bytes([l0, l1]);
        // A request without data goes to the device, whatever its direction bit says.
        let is_good = asked.is_in() == packet.is_in || length == 0;
        let is_whole = asked.is_in() || data.len() == usize::from(length);
        if !is_good || !is_whole {
            self.packets_odd += 1;
            self.send(SUBMITTED, packet.number, status::STALL, 0, &[]);
            return;
        }
        let room = packet.length.min(usize::from(length));
        match self.device.control(asked, data, length) {
            Reply::Data(mut bytes) if packet.is_in => {
                bytes.truncate(room);
                let is_short = packet.flags & SHORT_NOT_OK != 0 && bytes.len() < room;
                let status = if is_short {
                    status::SHORT
                } else {
                    status::DONE
                };
                self.send(SUBMITTED, packet.number, status, bytes.len(), &bytes);
            }
            Reply::Data(_) => self.send(SUBMITTED, packet.number, status::DONE, data.len(), &[]),
            Reply::Stall => self.send(SUBMITTED, packet.number, status::STALL, 0, &[]),
        }
    }

    /// Ends the next transfer whose data is due.
    fn transfer(&mut self) -> bool {
        let mut data = std::mem::take(&mut self.data);
        let done = self.device.poll(&mut data);
        if let Some(done) = done {
            let is_strict = done.ticket & STRICT != 0;
            let status = match done.status {
                Status::Done if is_strict && data.len() < done.asked => status::SHORT,
                Status::Done => status::DONE,
                Status::Stalled => status::STALL,
                Status::Overflow => status::OVERFLOW,
            };
            self.send(SUBMITTED, done.ticket as u32, status, data.len(), &data);
        }
        self.data = data;
        done.is_some()
    }

    fn send(&mut self, command: u32, number: u32, status: i32, length: usize, data: &[u8]) {
        let start = self.output.len();
        for word in [command, number, 0, 0, 0, status as u32, length as u32] {
            self.output.extend(word.to_be_bytes());
        }
        self.output.resize(start + HEADER, 0);
        self.output.extend_from_slice(data);
    }
}

impl Session for UsbIp {
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
        self.device.waiting() > 0
    }

    /// Ends the session at any change of the cable, because a connection carries only one device.
    fn change(&mut self, _change: Change) -> bool {
        false
    }

    fn report(&self) -> Report {
        Report {
            traffic: self.device.traffic(),
            packets_odd: self.packets_odd,
            is_rejected: false,
        }
    }
}

/// A packet from the host.
#[derive(Debug, Clone, Copy)]
struct Packet {
    command: u32,
    number: u32,
    is_in: bool,
    endpoint: u32,
    /// In an unlink packet, the number of the transfer to unlink.
    flags: u32,
    length: usize,
    isochronous: u32,
    setup: [u8; 8],
}

impl Packet {
    fn of(header: &[u8; HEADER]) -> Self {
        let word = |at: usize| {
            let at = 4 * at;
            u32::from_be_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]])
        };
        let mut setup = [0; 8];
        setup.copy_from_slice(&header[40..]);
        Self {
            command: word(0),
            number: word(1),
            is_in: word(3) != 0,
            endpoint: word(4),
            flags: word(5),
            length: word(6) as usize,
            isochronous: word(8),
            setup,
        }
    }

    /// Returns the number of bytes of data and of isochronous descriptions that follow.
    fn after(&self) -> Result<(usize, usize)> {
        match self.command {
            UNLINK => return Ok((0, 0)),
            SUBMIT => {}
            other => bail!("USB/IP: unknown packet type {other}: the host speaks another protocol"),
        }
        let descriptions = match self.isochronous {
            // In all other transfers, some kernels send 0, others -1.
            0 | u32::MAX => 0,
            number => number as usize,
        };
        let data = if self.is_in { 0 } else { self.length };
        if data > DATA_MAX || descriptions > ISOCHRONOUS_MAX {
            bail!(
                "USB/IP: a transfer of {data} bytes and {descriptions} isochronous packets to the \
                 device is too large: at most {DATA_MAX} bytes and {ISOCHRONOUS_MAX} packets are \
                 possible"
            );
        }
        Ok((data, descriptions * ISOCHRONOUS))
    }
}
