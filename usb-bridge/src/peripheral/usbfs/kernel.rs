//! The kernel's usbfs as libusb sees it, for one device: transfers (URBs) and the other ioctls.

use std::collections::VecDeque;

use crate::link::control::Request;
use crate::peripheral::{Bulk, Peripheral, Reply};

/// Errors of Linux.
const ENOENT: i32 = 2;
const EAGAIN: i32 = 11;
const ENOMEM: i32 = 12;
const EBUSY: i32 = 16;
const ENODEV: i32 = 19;
const EINVAL: i32 = 22;
const ENOTTY: i32 = 25;
const EPIPE: i32 = 32;
const ENODATA: i32 = 61;
const EPROTO: i32 = 71;
const EOVERFLOW: i32 = 75;
const ESHUTDOWN: i32 = 108;

/// Type of an interrupt transfer.
pub const INTERRUPT: u8 = 1;
/// Type of a control transfer.
pub const CONTROL: u8 = 2;
/// Type of a bulk transfer.
pub const BULK: u8 = 3;

/// Bytes of a setup packet.
const SETUP_BYTES: usize = 8;

/// What the next transfer to the host meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The endpoint halts, until the host ends that.
    Stall,
    /// More bytes came than were asked for.
    Overflow,
    /// An error on the wire.
    Wire,
}

/// One device of usbfs.
pub struct Usbfs {
    peripheral: Box<dyn Peripheral>,
    /// URBs to the host that wait, in order.
    waiting: Vec<Submitted>,
    /// URBs that have ended, until they are reaped.
    ended: VecDeque<Ended>,
    halted: Vec<u8>,
    gone: bool,
    /// Another program has the interface.
    pub taken: bool,
    /// URBs to the host that the kernel has memory for.
    pub urbs_max: usize,
    /// Faults to come, each for one transfer to the host, `None` for one without.
    pub faults: VecDeque<Option<Fault>>,
    /// Whether a halt is there again as soon as it was ended.
    pub stays_halted: bool,
    /// The device goes after so many transfers to the host.
    pub unplug_after: Option<usize>,
    /// The most URBs to the host that waited at once.
    pub waiting_max: usize,
    /// Ends of halts.
    pub halts_ended: usize,
    /// URBs that were taken back.
    pub discarded: usize,
    scratch: Vec<u8>,
}

/// A transfer that a program submits.
#[derive(Debug)]
pub struct Submitted {
    /// Address of the URB in the program, by which the program knows it.
    pub address: u64,
    /// Type: [`INTERRUPT`], [`CONTROL`] or [`BULK`].
    pub kind: u8,
    /// Endpoint, with the direction bit.
    pub endpoint: u8,
    /// Flags of usbfs.
    pub flags: u32,
    /// Address of the buffer in the program.
    pub buffer: u64,
    /// Bytes of the buffer, with the setup packet of a control transfer.
    pub length: usize,
    /// Bytes that go to the device: those of the buffer, if [`Submitted::is_sent`].
    pub data: Vec<u8>,
}

impl Submitted {
    /// Returns whether the buffer's bytes go to the device: to an OUT endpoint, or with a setup packet.
    #[must_use]
    pub const fn is_sent(kind: u8, endpoint: u8) -> bool {
        kind == CONTROL || endpoint & 0x80 == 0
    }
}

/// A transfer that has ended.
#[derive(Debug)]
pub struct Ended {
    /// [`Submitted::address`].
    pub address: u64,
    /// [`Submitted::buffer`].
    pub buffer: u64,
    /// Whether it is a control transfer, whose data follow the setup packet in the buffer.
    pub is_control: bool,
    /// 0, or an error of the system as a negative number.
    pub status: i32,
    /// Bytes that were transferred, without a setup packet.
    pub actual: u32,
    /// Bytes that go to the program.
    pub data: Vec<u8>,
}

impl Ended {
    fn new(urb: &Submitted, status: i32, actual: usize, data: Vec<u8>) -> Self {
        Self {
            address: urb.address,
            buffer: urb.buffer,
            is_control: urb.kind == CONTROL,
            status,
            // No buffer has 2^32 bytes.
            actual: actual as u32,
            data,
        }
    }
}

fn word(bytes: &[u8], at: usize) -> u32 {
    let word = bytes.get(at..).and_then(<[u8]>::first_chunk);
    u32::from_ne_bytes(word.copied().unwrap_or_default())
}

impl Usbfs {
    /// Creates a device that meets no fault.
    #[must_use]
    pub fn new(peripheral: Box<dyn Peripheral>) -> Self {
        Self {
            peripheral,
            waiting: Vec::new(),
            ended: VecDeque::new(),
            halted: Vec::new(),
            gone: false,
            taken: false,
            urbs_max: usize::MAX,
            faults: VecDeque::new(),
            stays_halted: false,
            unplug_after: None,
            waiting_max: 0,
            halts_ended: 0,
            discarded: 0,
            scratch: Vec::new(),
        }
    }

    /// Takes the device away: what waits ends, and is reaped before anything else fails.
    pub fn unplug(&mut self) {
        self.gone = true;
        for urb in self.waiting.drain(..) {
            self.ended
                .push_back(Ended::new(&urb, -ESHUTDOWN, 0, Vec::new()));
        }
    }

    /// Answers an ioctl that is not about a transfer, by its number, and returns its result and what its argument
    /// becomes.
    pub fn ioctl(&mut self, what: u32, bytes: &[u8]) -> (i32, Vec<u8>) {
        match what {
            _ if self.gone => return (-ENODEV, Vec::new()),
            // Capabilities: zero packets, no limit of sizes, scatter and gather, reaping after the end.
            26 => return (0, (0x1u32 | 0x4 | 0x8 | 0x10).to_ne_bytes().to_vec()),
            _ => {}
        }
        let result = match what {
            // Claim, with or without a driver that gives way.
            15 | 27 if self.taken => -EBUSY,
            4 | 15 | 16 | 27 => 0,
            5 | 20 => {
                self.peripheral.reset();
                0
            }
            21 => self.clear_halt(word(bytes, 0) as u8),
            // No driver of the kernel.
            8 | 18 => -ENODATA,
            _ => -ENOTTY,
        };
        (result, Vec::new())
    }

    fn clear_halt(&mut self, endpoint: u8) -> i32 {
        self.halts_ended += 1;
        self.peripheral.clear_halt(endpoint);
        if !self.stays_halted {
            self.halted.retain(|&one| one != endpoint);
        }
        0
    }

    /// Submits a transfer; returns 0, or an error as a negative number.
    pub fn submit(&mut self, urb: Submitted) -> i32 {
        if self.gone {
            return -ENODEV;
        }
        let (status, actual, data) = match urb.kind {
            CONTROL if urb.data.len() >= SETUP_BYTES => {
                let (status, answer) = self.control(&urb.data);
                let is_in = urb.data[0] & 0x80 != 0;
                let sent = urb.length - SETUP_BYTES;
                (status, if is_in { answer.len() } else { sent }, answer)
            }
            BULK | INTERRUPT if Submitted::is_sent(urb.kind, urb.endpoint) => {
                let is_taken = self.peripheral.bulk_out(urb.endpoint, &urb.data);
                let status = if is_taken { 0 } else { -EPIPE };
                (status, urb.data.len(), Vec::new())
            }
            BULK | INTERRUPT => {
                let same = |other: &&Submitted| other.endpoint == urb.endpoint;
                if self.waiting.iter().filter(same).count() >= self.urbs_max {
                    return -ENOMEM;
                }
                self.waiting.push(urb);
                self.waiting_max = self.waiting_max.max(self.waiting.len());
                return 0;
            }
            _ => return -EINVAL,
        };
        self.ended.push_back(Ended::new(&urb, status, actual, data));
        0
    }

    fn control(&mut self, setup: &[u8]) -> (i32, Vec<u8>) {
        let short = |at: usize| u16::from_le_bytes([setup[at], setup[at + 1]]);
        let request = Request {
            kind: setup[0],
            request: setup[1],
            value: short(2),
            index: short(4),
        };
        let length = usize::from(short(6));
        let reply = if request.kind & 0x60 == 0 {
            self.standard(request)
        } else {
            let data = if request.is_in() {
                &[]
            } else {
                &setup[SETUP_BYTES..]
            };
            self.peripheral.control(request, data, length)
        };
        match reply {
            Reply::Data(mut data) => {
                data.truncate(if request.is_in() { length } else { 0 });
                (0, data)
            }
            Reply::Stall => (-EPIPE, Vec::new()),
        }
    }

    /// The standard's own requests, as far as libusb sends them itself: descriptors.
    fn standard(&self, request: Request) -> Reply {
        let descriptors = self.peripheral.descriptors();
        if (request.kind, request.request) != (0x80, 6) {
            return Reply::Stall;
        }
        match (request.value >> 8, request.value & 0xFF) {
            (1, 0) => Reply::Data(descriptors.device.clone()),
            (2, 0) => Reply::Data(descriptors.configuration.clone()),
            (3, 0) => Reply::Data(vec![4, 3, 0x09, 0x04]),
            (3, number) => match descriptors.strings.get(usize::from(number) - 1) {
                Some(string) => {
                    let mut data = vec![0, 3];
                    data.extend(string.encode_utf16().flat_map(u16::to_le_bytes));
                    data[0] = data.len() as u8;
                    Reply::Data(data)
                }
                None => Reply::Stall,
            },
            _ => Reply::Stall,
        }
    }

    /// Takes a transfer back that has not ended; returns 0, or an error as a negative number.
    pub fn discard(&mut self, address: u64) -> i32 {
        if self.gone {
            return -ENODEV;
        }
        let Some(index) = self.waiting.iter().position(|urb| urb.address == address) else {
            return -EINVAL;
        };
        let urb = self.waiting.remove(index);
        self.discarded += 1;
        self.ended
            .push_back(Ended::new(&urb, -ENOENT, 0, Vec::new()));
        0
    }

    /// Returns the next transfer that has ended.
    ///
    /// # Errors
    /// `EAGAIN`: none has; `ENODEV`: none will, for the device has gone.
    pub fn reap(&mut self) -> Result<Ended, i32> {
        if self.ended.is_empty() && !self.gone {
            self.serve_one();
        }
        let none = if self.gone { ENODEV } else { EAGAIN };
        self.ended.pop_front().ok_or(none)
    }

    /// Ends the oldest URB of an endpoint that has something.
    fn serve_one(&mut self) {
        let mut asked = Vec::new();
        for index in 0..self.waiting.len() {
            let Submitted {
                endpoint, length, ..
            } = self.waiting[index];
            if asked.contains(&endpoint) || self.halted.contains(&endpoint) {
                continue;
            }
            asked.push(endpoint);
            self.scratch.clear();
            let mut status = 0;
            match self.faults.front().copied().flatten() {
                Some(Fault::Stall) => status = -EPIPE,
                Some(Fault::Overflow) => status = -EOVERFLOW,
                Some(Fault::Wire) => status = -EPROTO,
                None if self.stays_halted => status = -EPIPE,
                None => match self.peripheral.bulk_in(endpoint, length, &mut self.scratch) {
                    Bulk::Data => {}
                    Bulk::Wait => continue,
                    Bulk::Stall => status = -EPIPE,
                },
            }
            self.faults.pop_front();
            if status == -EPIPE {
                self.halted.push(endpoint);
            }
            let urb = self.waiting.remove(index);
            let data = std::mem::take(&mut self.scratch);
            self.ended
                .push_back(Ended::new(&urb, status, data.len(), data));
            if let Some(left) = &mut self.unplug_after {
                *left = left.saturating_sub(1);
                if *left == 0 {
                    self.unplug();
                }
            }
            return;
        }
    }
}
