//! The whole device, polled from its controller's interrupt.

use core::mem;

use eecvs_nostd::event_link::{Kind, SYNC};
use usb_device::class_prelude::{EndpointAddress, UsbBus, UsbBusAllocator};
use usb_device::device::{
    StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid,
};
use usb_device::{UsbDirection, UsbError};
use usbd_serial::CdcAcmClass;

use crate::PACKET_BYTES;
use crate::function::{Events, Function};
use crate::identity::{MANUFACTURER, PRODUCT, RELEASE, SERIAL_NAME, VENDOR_AND_PRODUCT};
use crate::outgoing::{Fetcher, QUEUE_PACKETS};
use crate::requests::Counts;

/// Largest current of a bus-powered board in milliamperes: the chip, a sensor and a few LEDs.
const POWER_MA: usize = 250;
/// Size in bytes of the largest packet of the control endpoint.
const CONTROL_BYTES: usize = 64;

/// The encoder's receiving end, to which the device passes the host's bytes.
pub trait Port {
    /// Returns how many bytes it can take now.
    fn room(&self) -> usize;

    /// Takes a packet's bytes; called only if there is room for [`PACKET_BYTES`].
    fn put(&mut self, bytes: &[u8]);

    /// Begins a session: bytes that were put and are not used yet belong to the one before.
    fn restart(&mut self);

    /// Numbers this endpoint's next packet DATA0, as the host does after it has set the configuration or cleared a
    /// halt; the stack leaves this to the controller.
    fn renumber(&mut self, endpoint: EndpointAddress) {
        let _ = endpoint;
    }
}

/// The function that has the encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Vendor,
    Serial,
}

/// A packet in the controller that the host may take.
#[derive(Debug, Clone, Copy)]
struct Flight {
    bytes: u32,
    ends: bool,
}

/// The USB device with both functions, on a controller `B`; a [`Port`] connects it to the encoder.
pub struct Device<'a, B: UsbBus, P> {
    device: UsbDevice<'a, B>,
    vendor: Function<'a, B>,
    serial: CdcAcmClass<'a, B>,
    outgoing: Fetcher<'a>,
    port: P,
    owner: Owner,
    /// Indexed by [`Owner`].
    flights: [Option<Flight>; 2],
}

impl<'a, B: UsbBus, P: Port> Device<'a, B, P> {
    /// Returns the device, connected to the bus; `None` if the controller has too few endpoints.
    pub fn new(
        allocator: &'a UsbBusAllocator<B>,
        outgoing: Fetcher<'a>,
        port: P,
        serial_number: &'a str,
    ) -> Option<Self> {
        let vendor = Function::new(allocator, outgoing.shared())?;
        let serial = CdcAcmClass::new_with_interface_names(
            allocator,
            PACKET_BYTES as u16,
            Some(SERIAL_NAME),
            None,
        );
        let strings = StringDescriptors::default()
            .manufacturer(MANUFACTURER)
            .product(PRODUCT)
            .serial_number(serial_number);
        let (vendor_id, product_id) = VENDOR_AND_PRODUCT;
        let device = UsbDeviceBuilder::new(allocator, UsbVidPid(vendor_id, product_id))
            .device_release(RELEASE)
            .composite_with_iads()
            .max_packet_size_0(CONTROL_BYTES as u8)
            .ok()?
            .max_power(POWER_MA)
            .ok()?
            .strings(&[strings])
            .ok()?
            .build();
        Some(Self {
            device,
            vendor,
            serial,
            outgoing,
            port,
            owner: Owner::Vendor,
            flights: [None; 2],
        })
    }

    /// Returns what the device has moved and dropped.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.vendor.all_counts()
    }

    /// Returns the encoder's receiving end, as given to [`Device::new`].
    pub const fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// Returns the controller's driver, which the stack uses.
    pub fn bus(&self) -> &B {
        self.device.bus()
    }

    /// Handles everything that is due. Call it in the controller's interrupt, after a message was queued, and when
    /// there is room again. It moves at most one packet each way.
    #[inline]
    pub fn poll(&mut self) {
        self.poll_stack();
        self.refuse_excess();
        let events = mem::take(&mut self.vendor.events);
        self.follow(&events);
        match self.device.state() {
            UsbDeviceState::Configured => {
                self.outgoing.shared().listen(true);
                self.receive();
                self.transmit();
            }
            // Asleep, perhaps unplugged: what waits stays until a reset decides.
            UsbDeviceState::Suspend => {}
            UsbDeviceState::Default | UsbDeviceState::Addressed => {
                self.outgoing.shared().listen(false);
                self.discard();
            }
        }
    }

    /// Separate, so that the stack's own code can be distinguished from this crate's in an image.
    #[inline(never)]
    fn poll_stack(&mut self) {
        self.device.poll(&mut [&mut self.vendor, &mut self.serial]);
    }

    /// Ends control transfers with more data than the stack takes. The stack leaves their packet in place, and a
    /// controller whose endpoints share a queue would then receive nothing more.
    fn refuse_excess(&mut self) {
        let control = EndpointAddress::from_parts(0, UsbDirection::Out);
        let bus = self.device.bus();
        let mut packet = [0; CONTROL_BYTES];
        match bus.read(control, &mut packet) {
            Ok(_) | Err(UsbError::BufferOverflow) => {
                bus.set_stalled(control, true);
                bus.set_stalled(EndpointAddress::from_parts(0, UsbDirection::In), true);
                add(&mut self.vendor.counts.controls_refused, 1);
            }
            // No packet is left, as it should be.
            Err(_) => {}
        }
    }

    fn follow(&mut self, events: &Events) {
        let ends = [
            self.vendor.to_host.address(),
            self.serial.write_ep().address(),
        ];
        for (flight, end) in self.flights.iter_mut().zip(ends) {
            let taken = 1_u16.checked_shl(end.index() as u32).unwrap_or(0);
            if events.taken & taken != 0
                && let Some(Flight { bytes, ends }) = flight.take()
            {
                add(&mut self.vendor.counts.bytes_sent, bytes);
                add(&mut self.vendor.counts.messages_sent, u32::from(ends));
            }
            // A reset empties the controller.
            if events.reset
                && let Some(Flight { bytes, ends }) = flight.take()
            {
                add(&mut self.vendor.counts.bytes_dropped, bytes);
                add(&mut self.vendor.counts.messages_dropped, u32::from(ends));
            }
        }
        for bit in (0..32).filter(|bit| events.renumbered >> bit & 1 != 0) {
            let side = if bit < 16 {
                UsbDirection::Out
            } else {
                UsbDirection::In
            };
            let endpoint = EndpointAddress::from_parts(bit as usize % 16, side);
            self.port.renumber(endpoint);
        }
        if events.reset {
            self.own(Owner::Vendor);
        }
        if events.reset || events.restart {
            self.restart();
        }
    }

    fn own(&mut self, owner: Owner) {
        self.owner = owner;
        self.vendor.counts.serial = owner == Owner::Serial;
    }

    /// Begins a session.
    fn restart(&mut self) {
        add(&mut self.vendor.counts.sessions, 1);
        self.outgoing.shared().begin_session();
        self.port.restart();
        self.discard();
    }

    /// Drops packets of sessions that have ended, at most as many as the queue holds.
    fn discard(&mut self) {
        let session = self.outgoing.shared().session();
        for _ in 0..QUEUE_PACKETS {
            let Some(packet) = self.outgoing.peek().filter(|packet| !packet.is_of(session)) else {
                break;
            };
            self.outgoing.take();
            let counts = &mut self.vendor.counts;
            add(&mut counts.bytes_dropped, packet.bytes().len() as u32);
            add(&mut counts.messages_dropped, u32::from(packet.ends()));
        }
    }

    /// Receives packets. A packet for which there is no room stays in its endpoint, which holds the host.
    fn receive(&mut self) {
        let mut packet = [0; PACKET_BYTES];
        for from in [Owner::Vendor, Owner::Serial] {
            if self.port.room() >= PACKET_BYTES
                && let Ok(len) = self.read(from, &mut packet)
            {
                self.take(from, packet.get(..len).unwrap_or(&[]));
            }
        }
    }

    /// Separate, as [`Device::poll_stack`].
    #[inline(never)]
    fn read(&mut self, from: Owner, packet: &mut [u8; PACKET_BYTES]) -> usb_device::Result<usize> {
        match from {
            Owner::Vendor => self.vendor.from_host.read(packet),
            Owner::Serial => self.serial.read_packet(packet),
        }
    }

    /// Separate, as [`Device::read`].
    #[inline(never)]
    fn write(&mut self, packet: &[u8]) -> usb_device::Result<usize> {
        match self.owner {
            Owner::Vendor => self.vendor.to_host.write(packet),
            Owner::Serial => self.serial.write_packet(packet),
        }
    }

    fn take(&mut self, from: Owner, packet: &[u8]) {
        let len = packet.len() as u32;
        if from != self.owner {
            if !packet.starts_with(&[SYNC[0], SYNC[1], Kind::Setup as u8]) {
                add(&mut self.vendor.counts.bytes_refused, len);
                add(&mut self.vendor.counts.packets_refused, 1);
                return;
            }
            self.own(from);
            self.restart();
        }
        add(&mut self.vendor.counts.bytes_received, len);
        self.port.put(packet);
    }

    fn transmit(&mut self) {
        self.discard();
        let at = self.owner as usize;
        if self.flights.get(at).is_none_or(Option::is_some) {
            return;
        }
        let Some(packet) = self.outgoing.peek() else {
            return;
        };
        if self.write(packet.bytes()).is_err() {
            // A packet of an earlier session is still there; once it is gone, this is called again.
            return;
        }
        self.outgoing.take();
        if let Some(flight) = self.flights.get_mut(at) {
            *flight = Some(Flight {
                bytes: packet.bytes().len() as u32,
                ends: packet.ends(),
            });
        }
    }
}

fn add(count: &mut u32, more: u32) {
    *count = count.wrapping_add(more);
}
