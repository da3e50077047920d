//! An opened USB device, with one interface claimed.

use std::sync::Arc;

use rusb::{Context, DeviceHandle, TransferType};

use super::UsbControl;
use super::bus::Attached;
use super::errors::link_error;
use super::stream::UsbLink;
use crate::device::Transfers;
use crate::link::LinkError;

/// What happens to a kernel driver that holds the interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drivers {
    /// It is detached, and attached again when the device is closed.
    GiveWay,
    /// It stays, and the device counts as in use.
    Stay,
}

/// A device with one interface claimed. Its control side and its stream keep it open.
#[derive(Debug, Clone)]
pub struct Device {
    opened: Arc<Opened>,
}

/// State shared by the sides of a device.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) handle: DeviceHandle<Context>,
    pub(super) name: String,
    pub(super) identity: (u16, u16),
    pub(super) release: u16,
    pub(super) serial: Option<String>,
    /// Addresses of the interface's bulk endpoints, with their maximum packet sizes.
    endpoints: Vec<(u8, usize)>,
}

impl Opened {
    /// Returns the first bulk OUT endpoint, if there is one.
    pub(super) fn bulk_out(&self) -> Option<u8> {
        let mut endpoints = self.endpoints.iter().map(|one| one.0);
        endpoints.find(|endpoint| endpoint & 0x80 == 0)
    }

    pub(super) fn error(&self, step: &str, error: rusb::Error) -> LinkError {
        link_error(&self.name, self.identity, step, error)
    }
}

impl Device {
    pub(super) fn open(
        attached: &Attached,
        interface: u8,
        drivers: Drivers,
    ) -> Result<Self, LinkError> {
        let error = |step: &str, error| attached.error(step, error);
        let handle = attached.device.open().map_err(|e| error("open", e))?;
        // Nothing has configured the device yet. If this query fails, claiming the interface reports the problem.
        if handle.active_configuration() == Ok(0) {
            handle
                .set_active_configuration(1)
                .map_err(|e| error("configuration", e))?;
        }
        if drivers == Drivers::GiveWay {
            // Not every system can detach drivers; claiming the interface reports the problem there.
            let _ = handle.set_auto_detach_kernel_driver(true);
        }
        handle.claim_interface(interface).map_err(|e| match e {
            rusb::Error::NotFound | rusb::Error::InvalidParam => LinkError::Failed {
                link: attached.name(),
                cause: format!(
                    "has no interface {interface}: it is another model, or has other firmware"
                ),
            },
            other => error("claiming its interface", other),
        })?;
        Ok(Self {
            opened: Arc::new(Opened {
                endpoints: bulk_endpoints(&attached.device, interface),
                handle,
                name: attached.name(),
                identity: (attached.vendor, attached.product),
                release: attached.release,
                serial: attached.serial.clone(),
            }),
        })
    }

    /// Returns the name used in messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.opened.name
    }

    /// Returns a control side of the device; there may be several at a time.
    #[must_use]
    pub fn control(&self) -> UsbControl {
        UsbControl::new(Arc::clone(&self.opened))
    }

    /// Returns the stream of the device. Its transfers are in flight when this returns, so that nothing is missed.
    ///
    /// # Errors
    /// The endpoint does not exist, or a transfer cannot be allocated or submitted.
    pub fn stream(&self, transfers: &Transfers) -> Result<UsbLink, LinkError> {
        let mut endpoints = self.opened.endpoints.iter();
        let Some(&(_, packet)) = endpoints.find(|one| one.0 == transfers.endpoint) else {
            return Err(LinkError::Failed {
                link: self.opened.name.clone(),
                cause: format!(
                    "has no bulk endpoint {:#04x}: it is another model, or has other firmware",
                    transfers.endpoint
                ),
            });
        };
        // A multiple of the packet size, because a last packet that does not fit is an overflow.
        let whole = Transfers {
            bytes: transfers.bytes.next_multiple_of(packet.max(1)),
            ..*transfers
        };
        UsbLink::new(Arc::clone(&self.opened), &whole)
    }
}

/// Returns the bulk endpoints of an interface with their maximum packet sizes.
fn bulk_endpoints(device: &rusb::Device<Context>, interface: u8) -> Vec<(u8, usize)> {
    let Ok(configuration) = device.active_config_descriptor() else {
        return Vec::new();
    };
    configuration
        .interfaces()
        .filter(|one| one.number() == interface)
        .filter_map(|one| one.descriptors().next())
        .flat_map(|descriptor| {
            descriptor
                .endpoint_descriptors()
                .filter(|endpoint| endpoint.transfer_type() == TransferType::Bulk)
                .map(|endpoint| (endpoint.address(), endpoint.max_packet_size().into()))
                .collect::<Vec<_>>()
        })
        .collect()
}
