//! The vendor's function: its interface, endpoints and requests; and what happened to the endpoints of both
//! functions, which the stack reports to every class.

use usb_device::class_prelude::*;
use usb_device::control::{Recipient, Request, RequestType};
use usb_device::device::DEFAULT_ALTERNATE_SETTING;

use crate::identity::VENDOR_NAME;
use crate::microsoft::{DESCRIPTOR_SET, PLATFORM_CAPABILITY, SET_INDEX};
use crate::outgoing::Shared;
use crate::requests::{COUNTS, Counts, DESCRIPTORS, RESTART};
use crate::{FROM_HOST, PACKET_BYTES, TO_HOST};

/// Class, subclass and protocol: vendor-specific.
const CLASS: u8 = 0xFF;
/// `bDescriptorType` of a platform capability.
const PLATFORM: u8 = 5;
/// All endpoints, a bit for each number; those to the host from bit 16 on.
const EVERY_ENDPOINT: u32 = 0xFFFE_FFFE;

/// What has happened since the device last looked.
#[derive(Debug, Default)]
pub(crate) struct Events {
    /// The bus was reset.
    pub reset: bool,
    /// A session begins without a reset.
    pub restart: bool,
    /// Endpoints whose packets are numbered anew, in the bits of [`EVERY_ENDPOINT`].
    pub renumbered: u32,
    /// Endpoints, by number, from which the host has taken a packet.
    pub taken: u16,
}

pub(crate) struct Function<'a, B: UsbBus> {
    interface: InterfaceNumber,
    name: StringIndex,
    pub from_host: EndpointOut<'a, B>,
    pub to_host: EndpointIn<'a, B>,
    pub events: Events,
    pub counts: Counts,
    shared: &'a Shared,
}

impl<'a, B: UsbBus> Function<'a, B> {
    /// Returns the function; `None` if the controller lacks its endpoints.
    pub fn new(allocator: &'a UsbBusAllocator<B>, shared: &'a Shared) -> Option<Self> {
        let bytes = PACKET_BYTES as u16;
        let bulk = EndpointType::Bulk;
        Some(Self {
            interface: allocator.interface(),
            name: allocator.string(),
            from_host: allocator
                .alloc(Some(FROM_HOST.into()), bulk, bytes, 0)
                .ok()?,
            to_host: allocator.alloc(Some(TO_HOST.into()), bulk, bytes, 0).ok()?,
            events: Events::default(),
            counts: Counts::default(),
            shared,
        })
    }

    /// Returns the counts of both sides.
    pub fn all_counts(&self) -> Counts {
        let Counts {
            messages_dropped,
            bytes_dropped,
            ..
        } = self.counts;
        Counts {
            messages_dropped: messages_dropped.wrapping_add(self.shared.messages_dropped()),
            bytes_dropped: bytes_dropped.wrapping_add(self.shared.bytes_dropped()),
            ..self.counts
        }
    }

    /// Whether a request is one of the vendor's, to the device or to the interface.
    fn is_own(&self, request: &Request) -> bool {
        let to_interface = u16::from(u8::from(self.interface));
        request.request_type == RequestType::Vendor
            && match request.recipient {
                Recipient::Device => true,
                Recipient::Interface => request.index == to_interface,
                _ => false,
            }
    }
}

impl<B: UsbBus> UsbClass<B> for Function<'_, B> {
    fn get_configuration_descriptors(
        &self,
        writer: &mut DescriptorWriter,
    ) -> usb_device::Result<()> {
        writer.interface_alt(
            self.interface,
            DEFAULT_ALTERNATE_SETTING,
            CLASS,
            CLASS,
            CLASS,
            Some(self.name),
        )?;
        writer.endpoint(&self.to_host)?;
        writer.endpoint(&self.from_host)
    }

    fn get_bos_descriptors(&self, writer: &mut BosWriter) -> usb_device::Result<()> {
        writer.capability(PLATFORM, &PLATFORM_CAPABILITY)
    }

    fn get_string(&self, index: StringIndex, _: LangID) -> Option<&str> {
        (index == self.name).then_some(VENDOR_NAME)
    }

    fn reset(&mut self) {
        self.events.reset = true;
        self.events.taken = 0;
    }

    fn endpoint_in_complete(&mut self, endpoint: EndpointAddress) {
        self.events.taken |= 1_u16.checked_shl(endpoint.index() as u32).unwrap_or(0);
    }

    fn control_in(&mut self, transfer: ControlIn<B>) {
        let request = transfer.request();
        if !self.is_own(request) {
            return;
        }
        // The stack stalls what is not accepted here. The answers are copies: if a host stops in the middle of an
        // answer of constant bytes, the stack does not end it and would mix it with the next one.
        let _ = match (request.request, request.recipient, request.index) {
            (COUNTS, ..) => transfer.accept_with(&self.all_counts().to_bytes()),
            (DESCRIPTORS, Recipient::Device, SET_INDEX) => transfer.accept_with(&DESCRIPTOR_SET),
            _ => Ok(()),
        };
    }

    fn control_out(&mut self, transfer: ControlOut<B>) {
        let request = *transfer.request();
        if self.is_own(&request) {
            if request.request == RESTART && transfer.data().is_empty() {
                self.events.restart = true;
                let _ = transfer.accept();
            }
            return;
        }
        // Standard requests: the stack answers them without reporting them to any class.
        match (request.request_type, request.recipient, request.request) {
            (RequestType::Standard, Recipient::Device, Request::SET_CONFIGURATION) => {
                self.events.restart = true;
                self.events.renumbered = EVERY_ENDPOINT;
            }
            (RequestType::Standard, Recipient::Interface, Request::SET_INTERFACE) => {
                self.events.renumbered = EVERY_ENDPOINT;
            }
            (RequestType::Standard, Recipient::Endpoint, Request::CLEAR_FEATURE) => {
                let number = u32::from(request.index & 15);
                let side = u32::from(request.index & 0x80 != 0) * 16;
                self.events.renumbered |= 1 << (number + side) & EVERY_ENDPOINT;
            }
            _ => {}
        }
    }
}
