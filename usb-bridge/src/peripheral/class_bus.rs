//! The microcontroller's own USB class as a [`Peripheral`]: the code of the firmware on a bus in memory.
//!
//! ```text
//! Peripheral -> control and bulk transfers -> packets on Wire -> usb-device -> eecvs-usb-class -> Application
//! ```

use std::collections::VecDeque;

use eecvs_usb_class::{Counts, Device, Fetcher, PACKET_BYTES, Port, Sender, TO_HOST};
use usb_device::bus::UsbBusAllocator;
use usb_device::endpoint::EndpointAddress;

use super::wire::{ENDPOINTS, Handshake, Wire};
use super::{Bulk, Descriptors, Peripheral, Reply, Speed};
use crate::link::control::Request;

/// Most bytes from the host that wait for the application, as in the firmware's ring buffer.
const INBOX_BYTES: usize = 1024;
/// Most bytes from the host that wait for a packet buffer, as in a host's controller.
const HELD_BYTES_MAX: usize = 1 << 16;
/// Number of polls of the device for a packet of a control transfer before the host gives up.
const CONTROL_POLLS: usize = 8;

/// Bytes from the host for the application.
#[derive(Debug, Default)]
pub struct Inbox {
    bytes: VecDeque<u8>,
    restarted: bool,
    /// Endpoints whose packet numbering was restarted.
    pub renumbered: Vec<u8>,
}

impl Inbox {
    /// Takes the oldest byte, if there is one.
    pub fn take(&mut self) -> Option<u8> {
        self.bytes.pop_front()
    }

    /// Returns the number of bytes that wait.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Returns whether no bytes wait.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Returns whether a session has begun since the last call.
    pub fn has_restarted(&mut self) -> bool {
        std::mem::take(&mut self.restarted)
    }
}

impl Port for Inbox {
    fn room(&self) -> usize {
        INBOX_BYTES - self.bytes.len().min(INBOX_BYTES)
    }

    fn put(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    fn restart(&mut self) {
        self.bytes.clear();
        self.restarted = true;
    }

    fn renumber(&mut self, endpoint: EndpointAddress) {
        // The first 64 are enough for tests.
        if self.renumbered.len() < 64 {
            self.renumbered.push(endpoint.into());
        }
    }
}

/// The application that stands in for the encoder.
pub trait Application: Send {
    /// Takes as many bytes from the host as it can use, and sends messages as far as there is room.
    fn work(&mut self, inbox: &mut Inbox, sender: &mut Sender<'_>);
}

impl<F: FnMut(&mut Inbox, &mut Sender<'_>) + Send> Application for F {
    fn work(&mut self, inbox: &mut Inbox, sender: &mut Sender<'_>) {
        self(inbox, sender);
    }
}

/// The microcontroller on the bus.
pub struct ClassBus<'a, A> {
    wire: Wire,
    device: Device<'a, Wire, Inbox>,
    sender: Sender<'a>,
    application: A,
    descriptors: Descriptors,
    /// Bytes of an unfinished transfer to the host, by endpoint.
    partial: [Vec<u8>; ENDPOINTS],
    /// Bytes of unfinished transfers from the host, by endpoint.
    held: [VecDeque<u8>; ENDPOINTS],
    /// Bytes from the host for which there was no room at all.
    bytes_refused: u64,
}

impl<'a, A: Application> ClassBus<'a, A> {
    /// Puts the device on `wire`, from which `allocator` was made, and enumerates it as a host does. `None` if the
    /// class does not fit the controller or enumeration fails.
    pub fn new(
        wire: &Wire,
        allocator: &'a UsbBusAllocator<Wire>,
        (sender, fetcher): (Sender<'a>, Fetcher<'a>),
        serial_number: &'a str,
        application: A,
    ) -> Option<Self> {
        let device = Device::new(allocator, fetcher, Inbox::default(), serial_number)?;
        let mut bus = Self {
            wire: wire.clone(),
            device,
            sender,
            application,
            descriptors: Descriptors {
                device: Vec::new(),
                configuration: Vec::new(),
                bos: Vec::new(),
                strings: Vec::new(),
                speed: Speed::Full,
            },
            partial: Default::default(),
            held: Default::default(),
            bytes_refused: 0,
        };
        bus.reset();
        bus.descriptors = bus.enumerate()?;
        Some(bus)
    }

    /// Returns what the class has moved and dropped.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.device.counts()
    }

    /// Returns the bus to which the device is connected.
    #[must_use]
    pub const fn wire(&self) -> &Wire {
        &self.wire
    }

    /// Returns the application that stands in for the encoder.
    pub const fn application(&mut self) -> &mut A {
        &mut self.application
    }

    /// Returns the bytes that wait for the application.
    pub const fn inbox(&mut self) -> &mut Inbox {
        self.device.port()
    }

    /// Returns the number of bytes for an endpoint that wait for the device to take them, as in a host's
    /// controller.
    #[must_use]
    pub fn held_bytes(&self, endpoint: u8) -> usize {
        Self::number(endpoint).map_or(0, |number| self.held[number].len())
    }

    /// Returns the number of bytes from the host that were dropped because the application took none and all
    /// buffers were full.
    #[must_use]
    pub const fn bytes_refused(&self) -> u64 {
        self.bytes_refused
    }

    /// Lets the device and the application run once.
    pub fn run(&mut self) {
        self.device.poll();
        self.application.work(self.device.port(), &mut self.sender);
        self.device.poll();
    }

    /// Makes a control transfer of any kind, as a host's controller does.
    pub fn transfer(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        let length = match request.is_in() {
            true => length.min(usize::from(u16::MAX)),
            false => data.len(),
        };
        let Ok(length_word) = u16::try_from(length) else {
            return Reply::Stall;
        };
        let [value_low, value_high] = request.value.to_le_bytes();
        let [index_low, index_high] = request.index.to_le_bytes();
        let [length_low, length_high] = length_word.to_le_bytes();
        self.wire.setup([
            request.kind,
            request.request,
            value_low,
            value_high,
            index_low,
            index_high,
            length_low,
            length_high,
        ]);
        self.device.poll();
        let reply = match request.is_in() {
            true => self.answer(length).map(Reply::Data),
            false => self.question(data).map(|()| Reply::Data(Vec::new())),
        };
        reply.unwrap_or(Reply::Stall)
    }

    /// Runs the data and status stages of a request that reads.
    fn answer(&mut self, length: usize) -> Option<Vec<u8>> {
        let mut data = Vec::new();
        while data.len() < length {
            let before = data.len();
            self.control_packet(|wire| wire.ask(0x80, &mut data))?;
            if data.len() - before < PACKET_BYTES {
                break;
            }
        }
        self.control_packet(|wire| wire.give(0, &[]))?;
        // A device that answers with more than was requested would do so on a real bus too.
        (data.len() <= length).then_some(data)
    }

    /// Runs the data and status stages of a request that sends.
    fn question(&mut self, data: &[u8]) -> Option<()> {
        for packet in data.chunks(PACKET_BYTES) {
            self.control_packet(|wire| wire.give(0, packet))?;
        }
        self.control_packet(|wire| wire.ask(0x80, &mut Vec::new()))
    }

    /// Moves a packet of a control transfer; `None` if the transfer is stalled.
    fn control_packet(&mut self, mut packet: impl FnMut(&Wire) -> Handshake) -> Option<()> {
        for _ in 0..CONTROL_POLLS {
            let handshake = packet(&self.wire);
            self.device.poll();
            match handshake {
                Handshake::Ack => return Some(()),
                Handshake::Nak => {}
                Handshake::Stall => return None,
            }
        }
        None
    }

    fn descriptor(&mut self, kind: u8, index: u8, language: u16) -> Option<Vec<u8>> {
        let request = Request {
            kind: 0x80,
            request: 6,
            value: u16::from(kind) << 8 | u16::from(index),
            index: language,
        };
        match self.transfer(request, &[], 1024) {
            Reply::Data(data) => Some(data),
            Reply::Stall => None,
        }
    }

    /// Gives the device an address and a configuration, and reads its descriptors.
    fn enumerate(&mut self) -> Option<Descriptors> {
        let device = self.descriptor(1, 0, 0)?;
        let configuration = self.descriptor(2, 0, 0)?;
        let bos = self.descriptor(15, 0, 0)?;
        let languages = self.descriptor(3, 0, 0)?;
        let language = u16::from_le_bytes(*languages.get(2..)?.first_chunk()?);
        let mut strings = Vec::new();
        for index in 1..=u8::MAX {
            let Some(string) = self.descriptor(3, index, language) else {
                break;
            };
            let (units, _) = string.get(2..)?.as_chunks();
            let units: Vec<u16> = units.iter().map(|unit| u16::from_le_bytes(*unit)).collect();
            strings.push(String::from_utf16(&units).ok()?);
        }
        Some(Descriptors {
            device,
            configuration,
            bos,
            strings,
            speed: Speed::Full,
        })
    }

    fn number(endpoint: u8) -> Option<usize> {
        let number = usize::from(endpoint & 0x7F);
        (1..ENDPOINTS).contains(&number).then_some(number)
    }

    /// Sends what is held, as far as the device takes it; returns `false` if the endpoint is halted.
    fn send_held(&mut self, endpoint: u8, number: usize) -> bool {
        while !self.held[number].is_empty() {
            let len = self.held[number].len().min(PACKET_BYTES);
            let packet: Vec<u8> = self.held[number].iter().take(len).copied().collect();
            match self.wire.give(endpoint, &packet) {
                Handshake::Ack => {
                    self.held[number].drain(..len);
                    self.run();
                }
                Handshake::Nak => {
                    self.run();
                    // The previous packet has not been taken: the application is busy.
                    if self.wire.give(endpoint, &packet) != Handshake::Ack {
                        return true;
                    }
                    self.held[number].drain(..len);
                }
                Handshake::Stall => return false,
            }
        }
        self.run();
        true
    }
}

impl<A: Application> Peripheral for ClassBus<'_, A> {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        let reply = self.transfer(request, data, length);
        self.run();
        reply
    }

    fn is_ready(&self, endpoint: u8) -> bool {
        self.held_bytes(endpoint) == 0
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        let Some(number) = Self::number(endpoint).filter(|_| endpoint & 0x80 == 0) else {
            return false;
        };
        let room = HELD_BYTES_MAX.saturating_sub(self.held[number].len());
        let kept = data.get(..room).unwrap_or(data);
        self.bytes_refused += (data.len() - kept.len()) as u64;
        self.held[number].extend(kept);
        self.send_held(endpoint, number)
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        let Some(number) = Self::number(endpoint).filter(|_| endpoint & 0x80 != 0) else {
            return Bulk::Stall;
        };
        for number in 1..ENDPOINTS {
            self.send_held(number as u8, number);
        }
        let mut ended = false;
        while !ended && self.partial[number].len() < room {
            let before = self.partial[number].len();
            match self.wire.ask(endpoint, &mut self.partial[number]) {
                Handshake::Ack => ended = self.partial[number].len() - before < PACKET_BYTES,
                // The transfer continues once there is more.
                Handshake::Nak => return Bulk::Wait,
                Handshake::Stall => return Bulk::Stall,
            }
            self.run();
        }
        let len = self.partial[number].len().min(room);
        data.extend(self.partial[number].drain(..len));
        Bulk::Data
    }

    fn clear_halt(&mut self, endpoint: u8) {
        let request = Request {
            kind: 0x02,
            request: 1,
            value: 0,
            index: u16::from(endpoint),
        };
        self.transfer(request, &[], 0);
        self.run();
    }

    fn reset(&mut self) {
        self.wire.reset_bus();
        self.device.poll();
        self.partial = Default::default();
        self.held = Default::default();
        let set = |request, value| Request {
            kind: 0,
            request,
            value,
            index: 0,
        };
        self.transfer(set(5, 1), &[], 0);
        self.transfer(set(9, 1), &[], 0);
        self.run();
    }
}

/// The endpoint of frames must exist on this bus.
const _: () = assert!((TO_HOST & 0x7F) < ENDPOINTS as u8);
