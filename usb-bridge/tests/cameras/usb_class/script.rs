//! A device whose application does what a test says.

use std::collections::VecDeque;

use eecvs_nostd::event_link::{Kind, Packet};
use eecvs_usb_class::{COUNTS, Counts, Fetcher, Outgoing, Sender, serial_number};
use usb_bridge::link::control::Request;
use usb_bridge::peripheral::class_bus::{Application, ClassBus, Inbox};
use usb_bridge::peripheral::wire::Wire;
use usb_bridge::peripheral::{Bulk, Peripheral, Reply};
use usb_device::bus::UsbBusAllocator;

/// Endpoints of the serial port.
pub const SERIAL_TO_HOST: u8 = 0x83;
pub const SERIAL_FROM_HOST: u8 = 0x02;

/// Sends what it is told to, keeps what it receives.
#[derive(Default)]
pub struct Script {
    pub messages: VecDeque<Vec<u8>>,
    pub received: Vec<u8>,
    /// Takes nothing.
    pub busy: bool,
    /// Sends without asking for room, as a sender that does not wait.
    pub rude: bool,
    pub restarts: usize,
    /// Answers of the sender.
    pub sent: usize,
    pub refused: usize,
}

impl Application for Script {
    fn work(&mut self, inbox: &mut Inbox, sender: &mut Sender<'_>) {
        if inbox.has_restarted() {
            self.restarts += 1;
            sender.follow();
        }
        while !self.busy
            && let Some(byte) = inbox.take()
        {
            self.received.push(byte);
        }
        while let Some(message) = self.messages.front() {
            if !self.rude && !sender.has_room(message.len()) {
                return;
            }
            match sender.send(message, || false) {
                true => self.sent += 1,
                false => self.refused += 1,
            }
            self.messages.pop_front();
        }
    }
}

/// Runs `test` with a device that has been enumerated.
pub fn with_device<R>(script: Script, test: impl FnOnce(&mut ClassBus<'_, Script>) -> R) -> R {
    let wire = Wire::default();
    let allocator = UsbBusAllocator::new(wire.clone());
    let mut outgoing = Outgoing::new();
    let ends: (Sender<'_>, Fetcher<'_>) = outgoing.split();
    let serial = serial_number([1, 2, 3]);
    let serial = std::str::from_utf8(&serial).unwrap();
    let mut device = ClassBus::new(&wire, &allocator, ends, serial, script).unwrap();
    test(&mut device)
}

/// The setup packet that gives the encoder to a function.
pub fn setup_packet() -> Vec<u8> {
    let mut bytes = vec![0; 64];
    let packet = Packet {
        kind: Kind::Setup,
        position: 0,
        body: &[1, 2, 3],
    };
    let len = packet.write(&mut bytes).unwrap();
    bytes.truncate(len);
    bytes
}

pub fn counts(device: &mut ClassBus<'_, Script>) -> Counts {
    let reply = device.control(Request::vendor_in(COUNTS, 0, 0), &[], 255);
    let Reply::Data(data) = reply else {
        panic!("no counts");
    };
    let counts = Counts::parse(&data).unwrap();
    assert_eq!(counts, device.counts());
    counts
}

/// All transfers that an endpoint has.
pub fn transfers(device: &mut ClassBus<'_, Script>, endpoint: u8, room: usize) -> Vec<Vec<u8>> {
    let mut transfers = Vec::new();
    loop {
        let mut data = Vec::new();
        match device.bulk_in(endpoint, room, &mut data) {
            Bulk::Data => transfers.push(data),
            Bulk::Wait => return transfers,
            Bulk::Stall => panic!("halted"),
        }
    }
}

pub fn message(len: usize, seed: u8) -> Vec<u8> {
    (0..len).map(|at| at as u8 ^ seed).collect()
}
