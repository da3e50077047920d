//! A device that is opened, with one interface claimed.

use std::sync::Arc;

use rusb::{Context, DeviceHandle, TransferType};

use super::UsbControl;
use super::bus::Attached;
use super::errors::link_error;
use super::stream::UsbLink;
use crate::device::Transfers;
use crate::link::LinkError;

/// Whether a kernel driver that has the interface is asked to leave it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Drivers {
    /// It leaves, and is back when the device is closed.
    GiveWay,
    /// It stays, and the device is in use.
    Stay,
}

/// A device with one interface claimed. Its control side and its stream keep it open.
#[derive(Debug, Clone)]
pub struct Device {
    opened: Arc<Opened>,
}

/// What the sides of a device share.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) handle: DeviceHandle<Context>,
    pub(super) name: String,
    pub(super) identity: (u16, u16),
    pub(super) release: u16,
    pub(super) serial: Option<String>,
    /// The interface's bulk endpoints and their packets' sizes.
    endpoints: Vec<(u8, usize)>,
}

impl Opened {
    /// The first bulk endpoint that takes bytes, where there is one.
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
        // A device that nothing has configured yet; where this cannot be asked, claiming tells.
        if handle.active_configuration() == Ok(0) {
            handle
                .set_active_configuration(1)
                .map_err(|e| error("configuration", e))?;
        }
        if drivers == Drivers::GiveWay {
            // Not every system has drivers that can be detached: claiming tells there.
            let _ = handle.set_auto_detach_kernel_driver(true);
        }
        handle.claim_interface(interface).map_err(|e| match e {
            rusb::Error::NotFound | rusb::Error::InvalidParam => LinkError::Failed {
                link: attached.name(),
                cause: format!("has no interface {interface}: another model, or another firmware"),
            },
            other => error("claim its interface", other),
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

    /// Name for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.opened.name
    }

    /// Its control side; there may be several.
    #[must_use]
    pub fn control(&self) -> UsbControl {
        UsbControl::new(Arc::clone(&self.opened))
    }

    /// Its stream: transfers are in flight when this returns, so that nothing is missed.
    ///
    /// # Errors
    /// There is no such endpoint, or a transfer cannot be made or submitted.
    pub fn stream(&self, transfers: &Transfers) -> Result<UsbLink, LinkError> {
        let mut endpoints = self.opened.endpoints.iter();
        let Some(&(_, packet)) = endpoints.find(|one| one.0 == transfers.endpoint) else {
            return Err(LinkError::Failed {
                link: self.opened.name.clone(),
                cause: format!(
                    "has no bulk endpoint {:#04x}: another model, or another firmware",
                    transfers.endpoint
                ),
            });
        };
        // A last packet that does not fit would be an overflow.
        let whole = Transfers {
            bytes: transfers.bytes.next_multiple_of(packet.max(1)),
            ..*transfers
        };
        UsbLink::new(Arc::clone(&self.opened), &whole)
    }
}

/// The bulk endpoints of an interface, with the sizes of their packets.
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
