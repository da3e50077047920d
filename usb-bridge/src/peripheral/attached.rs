//! A plugged-in device: requests are answered, and transfers wait until their data is due.
//!
//! It implements what every carrier needs: chapter 9, halts, and the transfers that the host has in flight on each
//! endpoint. Transfers are answered in order. A transfer without data waits (NAK), and occupies only the memory for
//! its number and its room.

use std::collections::VecDeque;

use super::descriptors::Layout;
use super::standard::Standard;
use super::{Bulk, Peripheral, Reply};
use crate::link::control::Request;

/// Most bytes given to one transfer; a longer one ends short.
pub const ROOM_MAX: usize = 1 << 20;

/// Most transfers in flight on all endpoints.
pub const WAITING_MAX: usize = 1024;

/// Number of endpoints per direction, including number 0.
const ENDPOINTS: usize = 16;

/// How a transfer ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Status {
    /// In order.
    Done,
    /// The endpoint is halted.
    Stalled,
    /// The device had more data than the transfer had room for; the rest is lost.
    Overflow,
}

/// A transfer from the device that has ended; its bytes are returned separately.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Completion {
    /// Number that the carrier gave the transfer.
    pub ticket: u64,
    /// Endpoint, with the direction bit.
    pub endpoint: u8,
    /// How the transfer ended.
    pub status: Status,
    /// Number of bytes that the transfer asked for.
    pub asked: usize,
}

/// Counts of what was carried.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Control requests.
    pub requests: u64,
    /// Control requests that were refused.
    pub requests_refused: u64,
    /// Transfers to the host that ended with data.
    pub transfers_in: u64,
    /// Bytes to the host.
    pub bytes_in: u64,
    /// Transfers to the device.
    pub transfers_out: u64,
    /// Bytes to the device.
    pub bytes_out: u64,
    /// Transfers that ended with a halt.
    pub stalled: u64,
    /// Transfers that the host cancelled before they had data.
    pub cancelled: u64,
    /// Transfers that were refused: too many in flight, or no such endpoint.
    pub refused: u64,
    /// Bytes lost because a device gave more than the transfer had room for.
    pub bytes_overflown: u64,
}

/// A transfer that waits for its data.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    ticket: u64,
    asked: usize,
}

/// A device on its bus.
pub struct Attached {
    peripheral: Box<dyn Peripheral>,
    standard: Standard,
    waiting: [VecDeque<Waiting>; ENDPOINTS],
    in_flight: usize,
    /// Endpoint that is asked first, so that none starves.
    turn: usize,
    traffic: Traffic,
}

impl Attached {
    /// Attaches a device; its state is that after a reset.
    #[must_use]
    pub fn new(mut peripheral: Box<dyn Peripheral>) -> Self {
        let mut standard = Standard::new(peripheral.descriptors());
        standard.reset(&mut *peripheral);
        Self {
            peripheral,
            standard,
            waiting: std::array::from_fn(|_| VecDeque::new()),
            in_flight: 0,
            turn: 0,
            traffic: Traffic::default(),
        }
    }

    /// Returns the device that is attached.
    #[must_use]
    pub fn peripheral(&self) -> &dyn Peripheral {
        &*self.peripheral
    }

    /// Returns the address, configuration, settings and halts of the device.
    #[must_use]
    pub fn standard(&self) -> &Standard {
        &self.standard
    }

    /// Returns the interfaces and endpoints of the device.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        self.standard.layout()
    }

    /// Returns the counts of what was carried so far.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// Returns the number of transfers that wait for data.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.in_flight
    }

    /// Answers a control request with at most `length` bytes.
    pub fn control(&mut self, request: Request, data: &[u8], length: u16) -> Reply {
        let peripheral = &mut *self.peripheral;
        let reply = self.standard.control(peripheral, request, data, length);
        self.traffic.requests += 1;
        self.traffic.requests_refused += u64::from(reply == Reply::Stall);
        reply
    }

    /// Passes `data` to an endpoint of the device.
    pub fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Status {
        let is_there = endpoint & 0x80 == 0 && self.standard.endpoint(endpoint).is_some();
        if !is_there {
            self.traffic.refused += 1;
            return Status::Stalled;
        }
        if self.standard.is_halted(endpoint) || !self.peripheral.bulk_out(endpoint, data) {
            self.standard.halt(endpoint);
            self.traffic.stalled += 1;
            return Status::Stalled;
        }
        self.traffic.transfers_out += 1;
        self.traffic.bytes_out += data.len() as u64;
        Status::Done
    }

    /// Puts a transfer of `asked` bytes in flight; returns `false` if it is refused.
    pub fn submit(&mut self, ticket: u64, endpoint: u8, asked: usize) -> bool {
        let is_there = endpoint & 0x80 != 0 && self.standard.endpoint(endpoint).is_some();
        if !is_there || self.in_flight >= WAITING_MAX {
            self.traffic.refused += 1;
            return false;
        }
        let queue = &mut self.waiting[usize::from(endpoint & 0x0F)];
        queue.push_back(Waiting { ticket, asked });
        self.in_flight += 1;
        true
    }

    /// Cancels a transfer; returns its endpoint if it was still in flight.
    pub fn cancel(&mut self, ticket: u64) -> Option<u8> {
        for (number, queue) in (0x80..).zip(&mut self.waiting) {
            if let Some(place) = queue.iter().position(|one| one.ticket == ticket) {
                queue.remove(place);
                self.in_flight -= 1;
                self.traffic.cancelled += 1;
                return Some(number);
            }
        }
        None
    }

    /// Cancels every transfer; returns their numbers and endpoints.
    pub fn cancel_all(&mut self) -> Vec<(u64, u8)> {
        let mut all = Vec::with_capacity(self.in_flight);
        for (number, queue) in (0x80..).zip(&mut self.waiting) {
            all.extend(queue.drain(..).map(|one| (one.ticket, number)));
        }
        self.in_flight = 0;
        self.traffic.cancelled += all.len() as u64;
        all
    }

    /// Returns the next transfer that has ended, with its bytes in `data`; `None` if all transfers wait.
    pub fn poll(&mut self, data: &mut Vec<u8>) -> Option<Completion> {
        for step in 0..ENDPOINTS {
            let number = (self.turn + step) % ENDPOINTS;
            let Some(&Waiting { ticket, asked }) = self.waiting[number].front() else {
                continue;
            };
            let endpoint = 0x80 | number as u8;
            data.clear();
            let Some(status) = self.ask(endpoint, asked.min(ROOM_MAX), data) else {
                continue;
            };
            self.waiting[number].pop_front();
            self.in_flight -= 1;
            self.turn = (number + 1) % ENDPOINTS;
            return Some(Completion {
                ticket,
                endpoint,
                status,
                asked,
            });
        }
        None
    }

    /// Returns how a transfer of `room` bytes ends now; `None` if it waits.
    fn ask(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Option<Status> {
        // The endpoint may have disappeared with another configuration or setting.
        let is_there = self.standard.endpoint(endpoint).is_some();
        let bulk = if !is_there || self.standard.is_halted(endpoint) {
            Bulk::Stall
        } else {
            self.peripheral.bulk_in(endpoint, room, data)
        };
        match bulk {
            Bulk::Wait => {
                data.clear();
                None
            }
            Bulk::Stall => {
                data.clear();
                self.standard.halt(endpoint);
                self.traffic.stalled += 1;
                Some(Status::Stalled)
            }
            Bulk::Data => {
                let beyond = data.len().saturating_sub(room);
                data.truncate(room);
                self.traffic.transfers_in += 1;
                self.traffic.bytes_in += data.len() as u64;
                self.traffic.bytes_overflown += beyond as u64;
                Some(if beyond == 0 {
                    Status::Done
                } else {
                    Status::Overflow
                })
            }
        }
    }

    /// Resets the bus: address, configuration and halts are cleared. Transfers in flight stay.
    pub fn reset(&mut self) {
        self.standard.reset(&mut *self.peripheral);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Speed;
    use super::super::sequence::{self, SequenceDevice};
    use super::*;

    fn configured(device: SequenceDevice) -> Attached {
        let mut attached = Attached::new(Box::new(device));
        let set = Request {
            kind: 0,
            request: 9,
            value: 1,
            index: 0,
        };
        assert_eq!(attached.control(set, &[], 0), Reply::Data(Vec::new()));
        attached
    }

    fn start(attached: &mut Attached) {
        let request = Request::vendor_out(sequence::START, 0, 0);
        assert_eq!(attached.control(request, &[], 0), Reply::Data(Vec::new()));
    }

    #[test]
    fn transfers_wait_and_end_in_their_order() {
        let mut attached = configured(SequenceDevice::new(Speed::High));
        let mut data = Vec::new();
        for ticket in 0..4 {
            assert!(attached.submit(ticket, sequence::STREAM, 512));
        }
        assert_eq!(attached.poll(&mut data), None);
        start(&mut attached);
        assert_eq!(attached.cancel(1), Some(sequence::STREAM));
        assert_eq!(attached.cancel(1), None);
        let mut check = sequence::Check::default();
        for ticket in [0, 2, 3] {
            let done = attached.poll(&mut data).expect("its data is due");
            assert_eq!(
                (done.ticket, done.status, data.len()),
                (ticket, Status::Done, 512)
            );
            check.take(&data);
        }
        assert_eq!(attached.poll(&mut data), None);
        assert_eq!((check.bytes(), check.is_good()), (3 * 512, true));
        assert_eq!(
            (attached.traffic().bytes_in, attached.traffic().cancelled),
            (1536, 1)
        );
    }

    #[test]
    fn transfers_in_flight_are_bounded_and_need_an_endpoint() {
        let mut attached = configured(SequenceDevice::new(Speed::High));
        for ticket in 0..WAITING_MAX as u64 {
            assert!(attached.submit(ticket, sequence::STREAM, usize::MAX));
        }
        assert!(!attached.submit(9999, sequence::STREAM, 1));
        assert_eq!(attached.cancel_all().len(), WAITING_MAX);
        assert!(!attached.submit(1, 0x8F, 1));
        assert!(!attached.submit(1, 0x01, 1));
        assert_eq!(attached.bulk_out(0x0F, &[]), Status::Stalled);
        assert_eq!(attached.traffic().refused, 4);
        start(&mut attached);
        assert!(attached.submit(1, sequence::STREAM, usize::MAX));
        let mut data = Vec::new();
        assert!(attached.poll(&mut data).is_some());
        assert_eq!(data.len(), ROOM_MAX);
    }

    #[test]
    fn a_halt_ends_every_transfer_until_the_host_ends_it_and_loses_nothing() {
        let mut attached = configured(SequenceDevice::new(Speed::High).stall_at(1000));
        start(&mut attached);
        let mut data = Vec::new();
        let mut check = sequence::Check::default();
        for ticket in 0..4 {
            assert!(attached.submit(ticket, sequence::STREAM, 512));
        }
        for status in [Status::Done, Status::Done, Status::Stalled, Status::Stalled] {
            assert_eq!(
                attached.poll(&mut data).map(|done| done.status),
                Some(status)
            );
            check.take(&data);
        }
        assert_eq!(check.bytes(), 1000);
        let clear = Request {
            kind: 2,
            request: 1,
            value: 0,
            index: u16::from(sequence::STREAM),
        };
        assert_eq!(attached.control(clear, &[], 0), Reply::Data(Vec::new()));
        assert!(attached.submit(5, sequence::STREAM, 512));
        assert!(attached.poll(&mut data).is_some());
        check.take(&data);
        assert_eq!((check.bytes(), check.is_good()), (1512, true));
    }
}
