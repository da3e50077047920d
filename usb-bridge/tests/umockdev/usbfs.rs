//! The kernel's usbfs as libusb sees it, for one device: URBs and the other ioctls.

use std::collections::VecDeque;
use std::time::Duration;

use usb_bridge::link::control::Request;
use usb_bridge::peripheral::{Bulk, Peripheral, Reply};

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
    waiting: Vec<Urb>,
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

struct Urb {
    address: u64,
    endpoint: u8,
    length: usize,
}

struct Ended {
    address: u64,
    status: i32,
    actual: u32,
    data: Vec<u8>,
}

fn word(bytes: &[u8], at: usize) -> u32 {
    let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
    u32::from_ne_bytes(word.unwrap_or_default())
}

fn address(bytes: &[u8]) -> u64 {
    let word = bytes.get(..8).and_then(|word| word.try_into().ok());
    u64::from_ne_bytes(word.unwrap_or_default())
}

impl Usbfs {
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

    /// The device goes: what waits ends, and is reaped before anything else fails.
    pub fn unplug(&mut self) {
        self.gone = true;
        for urb in self.waiting.drain(..) {
            self.ended.push_back(Ended {
                address: urb.address,
                status: -ESHUTDOWN,
                actual: 0,
                data: Vec::new(),
            });
        }
    }

    /// One ioctl by its number: its result, and what its argument becomes.
    pub fn ioctl(&mut self, what: u32, bytes: &[u8]) -> (i32, Vec<u8>) {
        match what {
            13 => return self.reap(),
            _ if self.gone => return (-ENODEV, Vec::new()),
            10 => return (self.submit(bytes), Vec::new()),
            11 => return (self.discard(address(bytes)), Vec::new()),
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

    fn submit(&mut self, bytes: &[u8]) -> i32 {
        if bytes.len() < 20 {
            return -EINVAL;
        }
        let (address, kind, endpoint) = (address(bytes), bytes[8], bytes[9]);
        let length = word(bytes, 16) as usize;
        let data = &bytes[20..];
        let (status, answer) = match kind {
            2 => self.control(data),
            3 if endpoint & 0x80 == 0 => {
                if self.peripheral.bulk_out(endpoint, data) {
                    (0, Vec::new())
                } else {
                    (-EPIPE, Vec::new())
                }
            }
            3 => {
                let in_flight = self.waiting.iter().filter(|urb| urb.endpoint == endpoint);
                if in_flight.count() >= self.urbs_max {
                    return -ENOMEM;
                }
                self.waiting.push(Urb {
                    address,
                    endpoint,
                    length,
                });
                self.waiting_max = self.waiting_max.max(self.waiting.len());
                return 0;
            }
            _ => return -EINVAL,
        };
        let sent = if kind == 2 { answer.len() } else { data.len() };
        let wrote = kind == 2 && data.first().is_some_and(|kind| kind & 0x80 == 0);
        self.ended.push_back(Ended {
            address,
            status,
            actual: if wrote { length - 8 } else { sent } as u32,
            data: answer,
        });
        0
    }

    fn control(&mut self, setup: &[u8]) -> (i32, Vec<u8>) {
        if setup.len() < 8 {
            return (-EINVAL, Vec::new());
        }
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
            let data = if request.is_in() { &[] } else { &setup[8..] };
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

    fn discard(&mut self, address: u64) -> i32 {
        let Some(index) = self.waiting.iter().position(|urb| urb.address == address) else {
            return -EINVAL;
        };
        self.waiting.remove(index);
        self.discarded += 1;
        self.ended.push_back(Ended {
            address,
            status: -ENOENT,
            actual: 0,
            data: Vec::new(),
        });
        0
    }

    fn reap(&mut self) -> (i32, Vec<u8>) {
        if self.ended.is_empty() && !self.gone {
            self.serve_one();
        }
        let Some(ended) = self.ended.pop_front() else {
            if self.gone {
                return (-ENODEV, Vec::new());
            }
            // The mocked node is always ready, so libusb asks without a pause: one is made here.
            std::thread::sleep(Duration::from_micros(50));
            return (-EAGAIN, Vec::new());
        };
        let mut answer = ended.address.to_ne_bytes().to_vec();
        answer.extend(ended.status.to_ne_bytes());
        answer.extend(ended.actual.to_ne_bytes());
        answer.extend(ended.data);
        (0, answer)
    }

    /// Ends the oldest URB of an endpoint that has something.
    fn serve_one(&mut self) {
        let mut asked = Vec::new();
        for index in 0..self.waiting.len() {
            let Urb {
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
            self.ended.push_back(Ended {
                address: urb.address,
                status,
                actual: self.scratch.len() as u32,
                data: self.scratch.clone(),
            });
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
