//! A USB bus in memory, for a device stack that runs on this host: packets, handshakes, resets.
//!
//! The device's side is a [`UsbBus`], the host's side the methods of [`Wire`]. Each direction of an endpoint has
//! memory for one packet, as in a small controller; a packet that finds no memory, or a request that finds no
//! packet, is answered with NAK.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use usb_device::bus::{PollResult, UsbBus};
use usb_device::endpoint::{EndpointAddress, EndpointType};
use usb_device::{UsbDirection, UsbError};

/// Number of endpoints per direction, including the control endpoint: as in an STM32F405's controller.
pub const ENDPOINTS: usize = 4;

/// Answer to a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Handshake {
    /// The packet was accepted.
    Ack,
    /// Not now; try again later.
    Nak,
    /// The endpoint is halted or does not exist.
    Stall,
}

/// One direction of an endpoint.
#[derive(Debug, Clone, Default)]
struct Endpoint {
    /// Size of the largest packet; 0 if the endpoint is not allocated.
    bytes_max: usize,
    packet: Option<Vec<u8>>,
    halted: bool,
}

#[derive(Debug, Default)]
struct Controller {
    to_device: [Endpoint; ENDPOINTS],
    to_host: [Endpoint; ENDPOINTS],
    /// Whether the packet of the control endpoint is a setup packet.
    is_setup: bool,
    /// Bit mask of endpoints whose packet the host took since the last poll.
    taken: u16,
    reset: bool,
    suspend: bool,
    resume: bool,
    address: u8,
}

impl Controller {
    fn endpoint(&mut self, address: EndpointAddress) -> Option<&mut Endpoint> {
        let side = match address.direction() {
            UsbDirection::In => &mut self.to_host,
            UsbDirection::Out => &mut self.to_device,
        };
        let endpoint = side.get_mut(address.index())?;
        (endpoint.bytes_max > 0).then_some(endpoint)
    }
}

/// A bus in memory: the device's side is a [`UsbBus`], the host's side this type's own methods.
#[derive(Debug, Clone, Default)]
pub struct Wire(Arc<Mutex<Controller>>);

impl Wire {
    fn lock(&self) -> MutexGuard<'_, Controller> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Resets the bus, as the host.
    pub fn reset_bus(&self) {
        let mut controller = self.lock();
        controller.reset = true;
        controller.address = 0;
    }

    /// Suspends the bus: the host is silent for 3 ms, or was unplugged.
    pub fn suspend_bus(&self) {
        self.lock().suspend = true;
    }

    /// Resumes the bus, as the host.
    pub fn resume_bus(&self) {
        self.lock().resume = true;
    }

    /// Returns the address that the host has assigned.
    #[must_use]
    pub fn address(&self) -> u8 {
        self.lock().address
    }

    /// Begins a control transfer as the host, which voids any packet of the control endpoint.
    pub fn setup(&self, setup: [u8; 8]) {
        let mut controller = self.lock();
        let [to_device, ..] = &mut controller.to_device;
        to_device.packet = Some(setup.to_vec());
        to_device.halted = false;
        let [to_host, ..] = &mut controller.to_host;
        to_host.packet = None;
        to_host.halted = false;
        controller.is_setup = true;
    }

    /// Sends a packet as the host.
    pub fn give(&self, endpoint: u8, packet: &[u8]) -> Handshake {
        let mut controller = self.lock();
        let address = EndpointAddress::from(endpoint & 0x7F);
        match controller.endpoint(address) {
            Some(endpoint) if !endpoint.halted && packet.len() <= endpoint.bytes_max => {
                if endpoint.packet.is_some() {
                    return Handshake::Nak;
                }
                endpoint.packet = Some(packet.to_vec());
                if address.index() == 0 {
                    controller.is_setup = false;
                }
                Handshake::Ack
            }
            _ => Handshake::Stall,
        }
    }

    /// Requests a packet as the host; it is appended to `bytes`.
    pub fn ask(&self, endpoint: u8, bytes: &mut Vec<u8>) -> Handshake {
        let mut controller = self.lock();
        let address = EndpointAddress::from(endpoint | 0x80);
        match controller.endpoint(address) {
            Some(endpoint) if !endpoint.halted => {
                let Some(packet) = endpoint.packet.take() else {
                    return Handshake::Nak;
                };
                bytes.extend(packet);
                controller.taken |= 1 << address.index();
                Handshake::Ack
            }
            _ => Handshake::Stall,
        }
    }
}

impl UsbBus for Wire {
    fn alloc_ep(
        &mut self,
        direction: UsbDirection,
        address: Option<EndpointAddress>,
        _: EndpointType,
        max_packet_size: u16,
        _: u8,
    ) -> usb_device::Result<EndpointAddress> {
        let mut controller = self.lock();
        let side = match direction {
            UsbDirection::In => &mut controller.to_host,
            UsbDirection::Out => &mut controller.to_device,
        };
        // Without a requested address, the first free endpoint; the control endpoint is requested by its number.
        let mut free = (1..ENDPOINTS).filter(|at| side[*at].bytes_max == 0);
        let at = match address {
            Some(address) => address.index(),
            None => free.next().ok_or(UsbError::EndpointOverflow)?,
        };
        match side.get_mut(at) {
            Some(endpoint) if endpoint.bytes_max == 0 => {
                endpoint.bytes_max = usize::from(max_packet_size);
                Ok(EndpointAddress::from_parts(at, direction))
            }
            _ => Err(UsbError::InvalidEndpoint),
        }
    }

    fn enable(&mut self) {}

    fn reset(&self) {
        let mut controller = self.lock();
        let Controller {
            to_device, to_host, ..
        } = &mut *controller;
        for endpoint in to_device.iter_mut().chain(to_host) {
            endpoint.packet = None;
            endpoint.halted = false;
        }
        controller.taken = 0;
        controller.is_setup = false;
        controller.address = 0;
    }

    fn set_device_address(&self, address: u8) {
        self.lock().address = address;
    }

    fn write(&self, address: EndpointAddress, bytes: &[u8]) -> usb_device::Result<usize> {
        let mut controller = self.lock();
        let endpoint = controller
            .endpoint(address)
            .filter(|_| address.is_in())
            .ok_or(UsbError::InvalidEndpoint)?;
        if bytes.len() > endpoint.bytes_max {
            return Err(UsbError::BufferOverflow);
        }
        if endpoint.packet.is_some() {
            return Err(UsbError::WouldBlock);
        }
        endpoint.packet = Some(bytes.to_vec());
        Ok(bytes.len())
    }

    fn read(&self, address: EndpointAddress, bytes: &mut [u8]) -> usb_device::Result<usize> {
        let mut controller = self.lock();
        let endpoint = controller
            .endpoint(address)
            .filter(|_| address.is_out())
            .ok_or(UsbError::InvalidEndpoint)?;
        let packet = endpoint.packet.as_ref().ok_or(UsbError::WouldBlock)?;
        let len = packet.len();
        // On overflow the packet stays in place, as in the controllers' drivers.
        let to = bytes.get_mut(..len).ok_or(UsbError::BufferOverflow)?;
        to.copy_from_slice(packet);
        endpoint.packet = None;
        Ok(len)
    }

    fn set_stalled(&self, address: EndpointAddress, stalled: bool) {
        if let Some(endpoint) = self.lock().endpoint(address) {
            endpoint.halted = stalled;
        }
    }

    fn is_stalled(&self, address: EndpointAddress) -> bool {
        self.lock()
            .endpoint(address)
            .is_none_or(|endpoint| endpoint.halted)
    }

    fn suspend(&self) {}

    fn resume(&self) {}

    fn poll(&self) -> PollResult {
        let mut controller = self.lock();
        if std::mem::take(&mut controller.reset) {
            controller.suspend = false;
            controller.resume = false;
            return PollResult::Reset;
        }
        if std::mem::take(&mut controller.resume) {
            return PollResult::Resume;
        }
        if std::mem::take(&mut controller.suspend) {
            return PollResult::Suspend;
        }
        let mut waiting = 0;
        for (at, endpoint) in controller.to_device.iter().enumerate() {
            waiting |= u16::from(endpoint.packet.is_some()) << at;
        }
        let setup = waiting & u16::from(controller.is_setup);
        let taken = std::mem::take(&mut controller.taken);
        match waiting | taken {
            0 => PollResult::None,
            _ => PollResult::Data {
                ep_out: waiting & !setup,
                ep_in_complete: taken,
                ep_setup: setup,
            },
        }
    }
}
