//! Lists the USB devices that are attached.

use std::fs;
use std::mem::MaybeUninit;
use std::path::Path;

use rusb::{Context, Speed, UsbContext};

use super::choose::{Candidate, absent, choose};
use super::device::{Device, Drivers};
use super::errors;
use crate::device::{Model, recognise};
use crate::link::LinkError;

/// Class code of hubs, which are ignored.
const HUB: u8 = 9;

/// Where Linux lists USB devices; absent on a machine without a host controller, as in a container.
const SYSFS: &str = "/sys/bus/usb/devices";

/// The USB host of this machine.
#[derive(Debug, Clone)]
pub struct Bus {
    /// `None` on a machine without USB, which has no devices.
    context: Option<Context>,
}

/// A device that is attached.
#[derive(Clone)]
pub struct Attached {
    pub(super) device: rusb::Device<Context>,
    /// Its model, if known.
    pub model: Option<&'static dyn Model>,
    /// Bus number.
    pub bus: u8,
    /// Address on the bus, which changes with each connection.
    pub address: u8,
    /// Port numbers from the root on, which stay the same until the device is moved.
    pub ports: Vec<u8>,
    /// USB vendor ID.
    pub vendor: u16,
    /// USB product ID.
    pub product: u16,
    /// `bcdDevice`, the release number of the device.
    pub release: u16,
    /// Speed of its connection.
    pub speed: Speed,
    /// The device's own product name, if it can be read.
    pub product_name: Option<String>,
    /// Serial number, if the device has one and it can be read.
    pub serial: Option<String>,
}

/// Whether a device can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// The device can be opened.
    Free,
    /// Another program or driver uses it.
    Taken,
    /// This user has no permission to open it.
    Forbidden,
    /// The device has gone in the meantime, or cannot be queried.
    Unknown,
}

impl Use {
    /// Derives the availability from an attempt to open the device.
    #[must_use]
    pub const fn of(opened: &Result<Device, LinkError>) -> Self {
        match opened {
            Ok(_) => Self::Free,
            Err(LinkError::Busy { .. }) => Self::Taken,
            Err(LinkError::Permission { .. }) => Self::Forbidden,
            Err(_) => Self::Unknown,
        }
    }

    /// Returns the text shown to people and to programs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Taken => "in use",
            Self::Forbidden => "no permission",
            Self::Unknown => "unknown",
        }
    }
}

impl Bus {
    /// Opens the USB host of this machine.
    ///
    /// # Errors
    /// The system does not allow access to USB.
    pub fn new() -> Result<Self, LinkError> {
        match Context::new() {
            Ok(context) => Ok(Self {
                context: Some(context),
            }),
            Err(_) if cfg!(target_os = "linux") && !Path::new(SYSFS).exists() => {
                Ok(Self { context: None })
            }
            Err(error) => Err(LinkError::Failed {
                link: "usb".to_owned(),
                cause: format!("cannot use the system's USB: {error}"),
            }),
        }
    }

    /// Returns every device except hubs, ordered by bus and port.
    ///
    /// # Errors
    /// As for [`Bus::new`].
    pub fn all(&self) -> Result<Vec<Attached>, LinkError> {
        let Some(context) = &self.context else {
            return Ok(Vec::new());
        };
        let list = context.devices().map_err(|error| LinkError::Failed {
            link: "usb".to_owned(),
            cause: format!("cannot list the devices: {error}"),
        })?;
        let mut all: Vec<_> = list.iter().filter_map(Attached::of).collect();
        all.sort_by(|a, b| (a.bus, &a.ports).cmp(&(b.bus, &b.ports)));
        Ok(all)
    }

    /// Returns the devices whose model is known.
    ///
    /// # Errors
    /// As for [`Bus::new`].
    pub fn devices(&self) -> Result<Vec<Attached>, LinkError> {
        let mut all = self.all()?;
        all.retain(|one| one.model.is_some());
        Ok(all)
    }

    /// Returns the known device that `wanted` names, or the only one.
    ///
    /// # Errors
    /// As for [`Bus::new`]; or no device fits, or several do, by the rules of [`choose`].
    pub fn find(&self, wanted: Option<&str>) -> Result<Attached, LinkError> {
        let mut devices = self.devices()?;
        let candidates: Vec<_> = devices.iter().map(Attached::candidate).collect();
        match choose(&candidates, wanted)? {
            Some(index) => Ok(devices.swap_remove(index)),
            None => Err(absent(&candidates, wanted)),
        }
    }
}

impl Attached {
    /// Reads the properties of a device; `None` for a hub, and for a device that has gone.
    pub(super) fn of(device: rusb::Device<Context>) -> Option<Self> {
        let descriptor = device.device_descriptor().ok()?;
        if descriptor.class_code() == HUB {
            return None;
        }
        let (vendor, product) = (descriptor.vendor_id(), descriptor.product_id());
        let release = release(&device)?;
        let mut attached = Self {
            model: recognise(vendor, product, release),
            bus: device.bus_number(),
            address: device.address(),
            ports: device.port_numbers().unwrap_or_default(),
            vendor,
            product,
            release,
            speed: device.speed(),
            product_name: None,
            serial: None,
            device,
        };
        attached.product_name = attached.kept_string("product");
        attached.serial = attached.kept_string("serial");
        if cfg!(not(target_os = "linux"))
            && attached.model.is_some()
            && let Ok(handle) = attached.device.open()
        {
            attached.product_name = handle.read_product_string_ascii(&descriptor).ok();
            attached.serial = handle.read_serial_number_string_ascii(&descriptor).ok();
        }
        Some(attached)
    }

    /// Reads a string that Linux cached when the device was connected. This needs no permission, and does not query
    /// the device, which may be streaming.
    fn kept_string(&self, name: &str) -> Option<String> {
        let path = format!("{SYSFS}/{}/{name}", &self.id()[4..]);
        let text = fs::read_to_string(path).ok()?;
        Some(text.trim().to_owned()).filter(|text| !text.is_empty())
    }

    /// Returns whether the host controller loses bytes when one of several transfers in flight is cancelled: QEMU's
    /// xHCI (7.2) continues after all of them, and the kernel discards what arrives for the skipped ones.
    #[must_use]
    pub fn loses_what_is_taken_back(&self) -> bool {
        // The parent of a root hub is the controller.
        let is = |name: &str, value: &str| {
            let path = format!("{SYSFS}/usb{}/../{name}", self.bus);
            fs::read_to_string(path).is_ok_and(|text| text.trim() == value)
        };
        cfg!(target_os = "linux") && is("vendor", "0x1b36") && is("device", "0x000d")
    }

    /// Returns its port: `usb:1-4.2` is port 2 of the hub at port 4 of bus 1.
    #[must_use]
    pub fn id(&self) -> String {
        let ports: Vec<_> = self.ports.iter().map(ToString::to_string).collect();
        format!("usb:{}-{}", self.bus, ports.join("."))
    }

    /// Returns its name for messages: `usb 1-4 davis346`.
    #[must_use]
    pub fn name(&self) -> String {
        let place = &self.id()[4..];
        match self.model {
            Some(model) => format!("usb {place} {}", model.name()),
            None => format!("usb {place} {:04x}:{:04x}", self.vendor, self.product),
        }
    }

    /// Returns the names by which the device can be selected.
    #[must_use]
    pub fn candidate(&self) -> Candidate {
        Candidate {
            id: self.id(),
            model: self.model.map(Model::name),
            serial: self.serial.clone(),
        }
    }

    /// Opens the device and claims one interface. A kernel driver is detached, and attached again when the device
    /// is closed.
    ///
    /// # Errors
    /// The user has no permission, the device is in use or gone, or its connection is too slow for its model.
    pub fn open(&self, interface: u8) -> Result<Device, LinkError> {
        if self.model.is_some_and(Model::needs_super_speed) {
            self.require_super_speed()?;
        }
        Device::open(self, interface, Drivers::GiveWay)
    }

    /// Opens the device and claims one interface only if nobody uses it, so that nobody is disturbed; [`Use::of`]
    /// interprets the result.
    ///
    /// # Errors
    /// The user has no permission, or the device is in use or gone.
    pub fn try_open(&self, interface: u8) -> Result<Device, LinkError> {
        Device::open(self, interface, Drivers::Stay)
    }

    /// Checks that the connection is at least SuperSpeed (5 Gbit/s).
    ///
    /// # Errors
    /// [`LinkError::TooSlow`] below SuperSpeed; an unknown speed passes.
    pub fn require_super_speed(&self) -> Result<(), LinkError> {
        match self.speed {
            Speed::Low | Speed::Full | Speed::High => Err(LinkError::TooSlow {
                link: self.name(),
                speed: speed_name(self.speed),
            }),
            _ => Ok(()),
        }
    }

    pub(super) fn error(&self, step: &str, error: rusb::Error) -> LinkError {
        errors::link_error(&self.name(), (self.vendor, self.product), step, error)
    }
}

/// Returns a USB speed as text.
#[must_use]
pub const fn speed_name(speed: Speed) -> &'static str {
    match speed {
        Speed::Low => "1.5 Mbit/s",
        Speed::Full => "12 Mbit/s",
        Speed::High => "480 Mbit/s",
        Speed::Super => "5 Gbit/s",
        Speed::SuperPlus => "10 Gbit/s",
        _ => "an unknown speed",
    }
}

/// Reads the raw `bcdDevice`: rusb parses it as decimal digits, which not every device uses.
#[expect(unsafe_code, reason = "rusb does not give the number itself")]
fn release(device: &rusb::Device<Context>) -> Option<u16> {
    let mut descriptor = MaybeUninit::<rusb::ffi::libusb_device_descriptor>::uninit();
    // SAFETY: the device is alive as long as `device`, which holds a reference; libusb fills the descriptor when it
    // returns 0, and only then is it read.
    unsafe {
        let result =
            rusb::ffi::libusb_get_device_descriptor(device.as_raw(), descriptor.as_mut_ptr());
        (result == 0).then(|| descriptor.assume_init().bcdDevice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_without_usb_has_no_devices_or_says_so_in_one_line() {
        match Bus::new().and_then(|bus| bus.find(Some("no such device"))) {
            Ok(_) => panic!("nothing is called so"),
            Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
        }
    }
}
