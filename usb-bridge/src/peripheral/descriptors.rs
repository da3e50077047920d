//! USB descriptors: written from a description of a device, and parsed back into its interfaces and endpoints.
//!
//! The formats are those of USB 2.0, 9.6 and USB 3.2, 9.6. A device has one configuration and connects at one
//! speed:
//!
//! ```
//! use usb_bridge::peripheral::Speed;
//! use usb_bridge::peripheral::descriptors::{Device, Endpoint, Interface};
//!
//! let endpoints = [Endpoint::bulk(0x82)];
//! let camera = Device {
//!     speed: Speed::Super,
//!     vendor: 0x152A,
//!     product: 0x841A,
//!     names: ["iniVation", "DAVIS346", "00000001"],
//!     interfaces: &[Interface::vendor(0, &endpoints)],
//!     ..Device::default()
//! };
//! assert_eq!(camera.describe().device.len(), 18);
//! ```

use super::{Descriptors, Speed};

/// `bDescriptorType`.
pub(super) mod kind {
    pub const DEVICE: u8 = 1;
    pub const CONFIGURATION: u8 = 2;
    pub const STRING: u8 = 3;
    pub const INTERFACE: u8 = 4;
    pub const ENDPOINT: u8 = 5;
    pub const BOS: u8 = 15;
    pub const CAPABILITY: u8 = 16;
    pub const COMPANION: u8 = 48;
}

/// `bConfigurationValue` of the only configuration.
pub const CONFIGURATION: u8 = 1;

/// Transfer type of an endpoint: the low bits of `bmAttributes`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Transfer {
    /// Control requests.
    Control = 0,
    /// A fixed rate, without retransmission.
    Isochronous = 1,
    /// The remaining bandwidth of the bus.
    Bulk = 2,
    /// Polled at an interval.
    Interrupt = 3,
}

/// An endpoint of an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Endpoint {
    /// Number 1 to 15, with the direction bit 0x80 for endpoints to the host.
    pub address: u8,
    /// Transfer type.
    pub transfer: Transfer,
    /// Bytes per packet; 0 for the size of bulk packets at the device's speed (64, 512 or 1024).
    pub packet: u16,
    /// `bInterval`.
    pub interval: u8,
    /// Packets per burst beyond the first, 0 to 15, at SuperSpeed.
    pub burst: u8,
}

impl Endpoint {
    /// Creates a bulk endpoint with the packet size of the device's speed.
    #[must_use]
    pub const fn bulk(address: u8) -> Self {
        Self {
            address,
            transfer: Transfer::Bulk,
            packet: 0,
            interval: 0,
            burst: 15,
        }
    }

    /// Creates an interrupt endpoint with packets of `packet` bytes; `interval` is its `bInterval`.
    #[must_use]
    pub const fn interrupt(address: u8, packet: u16, interval: u8) -> Self {
        Self {
            address,
            transfer: Transfer::Interrupt,
            packet,
            interval,
            burst: 0,
        }
    }

    fn write(self, speed: Speed, bytes: &mut Vec<u8>) {
        let packet = match (self.packet, speed) {
            (0, Speed::Full) => 64,
            (0, Speed::High) => 512,
            (0, Speed::Super) => 1024,
            (packet, _) => packet,
        };
        let [low, high] = packet.to_le_bytes();
        let attributes = self.transfer as u8;
        bytes.extend([
            7,
            kind::ENDPOINT,
            self.address,
            attributes,
            low,
            high,
            self.interval,
        ]);
        if speed == Speed::Super {
            // Of interrupt endpoints also the bytes per interval.
            let [low, high] = match self.transfer {
                Transfer::Interrupt => packet.to_le_bytes(),
                _ => [0, 0],
            };
            bytes.extend([6, kind::COMPANION, self.burst, 0, low, high]);
        }
    }
}

/// An interface, or an alternate setting of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interface<'d> {
    /// Number of the interface, below 32.
    pub number: u8,
    /// `bAlternateSetting`.
    pub setting: u8,
    /// Class, subclass and protocol.
    pub class: [u8; 3],
    /// Number of its string; 0 for none.
    pub name: u8,
    /// Descriptors of an interface association, written before the interface.
    pub before: &'d [u8],
    /// Class-specific descriptors, written after the interface.
    pub extra: &'d [u8],
    /// Its endpoints, except number 0.
    pub endpoints: &'d [Endpoint],
}

impl<'d> Interface<'d> {
    /// Creates an interface of the vendor-specific class.
    #[must_use]
    pub const fn vendor(number: u8, endpoints: &'d [Endpoint]) -> Self {
        Self {
            number,
            setting: 0,
            class: [0xFF, 0, 0],
            name: 0,
            before: &[],
            extra: &[],
            endpoints,
        }
    }

    fn write(&self, speed: Speed, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(self.before);
        let endpoints = self.endpoints.len() as u8;
        bytes.extend([9, kind::INTERFACE, self.number, self.setting, endpoints]);
        bytes.extend(self.class);
        bytes.push(self.name);
        bytes.extend_from_slice(self.extra);
        for endpoint in self.endpoints {
            endpoint.write(speed, bytes);
        }
    }
}

/// A device, from which its descriptors are derived.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Device<'d> {
    /// Speed at which it connects.
    pub speed: Speed,
    /// `idVendor`.
    pub vendor: u16,
    /// `idProduct`.
    pub product: u16,
    /// `bcdDevice`.
    pub release: u16,
    /// Class, subclass and protocol; zeros if the interfaces define them.
    pub class: [u8; 3],
    /// Manufacturer, product and serial number, which become strings 1 to 3; empty for none.
    pub names: [&'d str; 3],
    /// Its interfaces and their settings, ordered by number.
    pub interfaces: &'d [Interface<'d>],
    /// Device capabilities for the BOS, besides those of SuperSpeed.
    pub capabilities: &'d [u8],
}

impl Default for Device<'_> {
    fn default() -> Self {
        Self {
            speed: Speed::High,
            vendor: 0,
            product: 0,
            release: 0x0100,
            class: [0; 3],
            names: [""; 3],
            interfaces: &[],
            capabilities: &[],
        }
    }
}

impl Device<'_> {
    /// USB 2.0 extension without link power management, and SuperSpeed with full to super speed.
    const SUPER_SPEED: [u8; 17] = [
        7,
        kind::CAPABILITY,
        2,
        0,
        0,
        0,
        0, //
        10,
        kind::CAPABILITY,
        3,
        0,
        0x0E,
        0,
        1,
        0,
        0,
        0,
    ];

    /// Returns the descriptors of the device.
    #[must_use]
    pub fn describe(&self) -> Descriptors {
        Descriptors {
            device: self.device(),
            configuration: self.configuration(),
            bos: self.bos(),
            strings: self.names.iter().map(|&name| name.to_owned()).collect(),
            speed: self.speed,
        }
    }

    fn device(&self) -> Vec<u8> {
        let version: u16 = match self.speed {
            Speed::Super => 0x0300,
            // The first version with a BOS.
            _ if !self.capabilities.is_empty() => 0x0210,
            _ => 0x0200,
        };
        // At SuperSpeed, the exponent of a power of two.
        let packet = if self.speed == Speed::Super { 9 } else { 64 };
        let mut bytes = vec![18, kind::DEVICE];
        bytes.extend(version.to_le_bytes());
        bytes.extend(self.class);
        bytes.push(packet);
        for number in [self.vendor, self.product, self.release] {
            bytes.extend(number.to_le_bytes());
        }
        for (number, name) in (1..).zip(self.names) {
            bytes.push(if name.is_empty() { 0 } else { number });
        }
        bytes.push(1);
        bytes
    }

    fn configuration(&self) -> Vec<u8> {
        let interfaces = self
            .interfaces
            .iter()
            .filter(|one| one.setting == 0)
            .count() as u8;
        // Bus-powered: 500 mA or 896 mA.
        let power = if self.speed == Speed::Super { 112 } else { 250 };
        let mut bytes = vec![9, kind::CONFIGURATION, 0, 0];
        bytes.extend([interfaces, CONFIGURATION, 0, 0x80, power]);
        for interface in self.interfaces {
            interface.write(self.speed, &mut bytes);
        }
        set_total(bytes)
    }

    fn bos(&self) -> Vec<u8> {
        let of_speed: &[u8] = match self.speed {
            Speed::Super => &Self::SUPER_SPEED,
            _ => &[],
        };
        if of_speed.is_empty() && self.capabilities.is_empty() {
            return Vec::new();
        }
        let mut bytes = vec![5, kind::BOS, 0, 0, 0];
        bytes.extend_from_slice(of_speed);
        bytes.extend_from_slice(self.capabilities);
        bytes[4] = parts(&bytes[5..]).count() as u8;
        set_total(bytes)
    }
}

/// Writes the total length into `wTotalLength`.
fn set_total(mut bytes: Vec<u8>) -> Vec<u8> {
    let total = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
    bytes.truncate(usize::from(total));
    bytes[2..4].copy_from_slice(&total.to_le_bytes());
    bytes
}

/// Iterates over consecutive descriptors by their `bLength`; ends at the first invalid one.
pub(super) fn parts(mut bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let length = usize::from(*bytes.first()?);
        if length < 2 || length > bytes.len() {
            return None;
        }
        let (part, rest) = bytes.split_at(length);
        bytes = rest;
        Some(part)
    })
}

/// A setting of an interface, as parsed from a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DescribedInterface {
    /// Number of the interface.
    pub number: u8,
    /// `bAlternateSetting`.
    pub setting: u8,
    /// Class, subclass and protocol.
    pub class: [u8; 3],
}

/// An endpoint, as parsed from a configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DescribedEndpoint {
    /// Number of its interface.
    pub interface: u8,
    /// Setting of the interface to which it belongs.
    pub setting: u8,
    /// Number, with the direction bit.
    pub address: u8,
    /// Transfer type.
    pub transfer: Transfer,
    /// Bytes per packet.
    pub packet: u16,
    /// `bInterval`.
    pub interval: u8,
}

/// Interfaces and endpoints of a configuration.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layout {
    /// Interfaces and their settings, in the order of the configuration.
    pub interfaces: Vec<DescribedInterface>,
    /// Endpoints, in the order of the configuration.
    pub endpoints: Vec<DescribedEndpoint>,
}

impl Layout {
    /// Parses a configuration descriptor with everything that follows it; truncated parts are ignored.
    #[must_use]
    pub fn of(configuration: &[u8]) -> Self {
        let mut layout = Self::default();
        for part in parts(configuration) {
            match *part {
                [_, kind::INTERFACE, number, setting, _, a, b, c, ..] => {
                    let class = [a, b, c];
                    layout.interfaces.push(DescribedInterface {
                        number,
                        setting,
                        class,
                    });
                }
                [
                    _,
                    kind::ENDPOINT,
                    address,
                    attributes,
                    low,
                    high,
                    interval,
                    ..,
                ] => {
                    // An endpoint without an interface is ignored.
                    let Some(of) = layout.interfaces.last() else {
                        continue;
                    };
                    layout.endpoints.push(DescribedEndpoint {
                        interface: of.number,
                        setting: of.setting,
                        address,
                        transfer: match attributes & 3 {
                            0 => Transfer::Control,
                            1 => Transfer::Isochronous,
                            2 => Transfer::Bulk,
                            _ => Transfer::Interrupt,
                        },
                        packet: u16::from_le_bytes([low, high]) & 0x07FF,
                        interval,
                    });
                }
                _ => {}
            }
        }
        layout
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENDPOINTS: [Endpoint; 3] = [
        Endpoint::bulk(0x81),
        Endpoint::bulk(0x02),
        Endpoint::interrupt(0x83, 8, 9),
    ];

    fn device(speed: Speed) -> Descriptors {
        Device {
            speed,
            vendor: 0x152A,
            product: 0x841A,
            names: ["a", "", "c"],
            interfaces: &[Interface::vendor(0, &ENDPOINTS)],
            ..Device::default()
        }
        .describe()
    }

    #[test]
    fn high_speed_is_as_the_tables_of_usb_2() {
        let found = device(Speed::High);
        assert_eq!(
            found.device,
            [
                18, 1, 0, 2, 0, 0, 0, 64, 0x2A, 0x15, 0x1A, 0x84, 0, 1, 1, 0, 3, 1
            ]
        );
        assert_eq!(
            found.configuration,
            [
                9, 2, 39, 0, 1, 1, 0, 0x80, 250, //
                9, 4, 0, 0, 3, 0xFF, 0, 0, 0, //
                7, 5, 0x81, 2, 0, 2, 0, //
                7, 5, 0x02, 2, 0, 2, 0, //
                7, 5, 0x83, 3, 8, 0, 9,
            ]
        );
        assert!(found.bos.is_empty());
    }

    #[test]
    fn super_speed_has_companions_and_a_bos() {
        let found = device(Speed::Super);
        assert_eq!((found.device[3], found.device[7]), (3, 9));
        assert_eq!(found.configuration.len(), 39 + 3 * 6);
        assert_eq!(
            found.configuration[18..31],
            [7, 5, 0x81, 2, 0, 4, 0, 6, 48, 15, 0, 0, 0]
        );
        assert_eq!(found.configuration[51..], [6, 48, 0, 0, 8, 0]);
        assert_eq!(found.bos[..5], [5, 15, 22, 0, 2]);
        assert_eq!(parts(&found.bos).count(), 3);
    }

    #[test]
    fn a_layout_is_what_was_described_and_any_bytes_are_survived() {
        for speed in [Speed::Full, Speed::High, Speed::Super] {
            let configuration = device(speed).configuration;
            let layout = Layout::of(&configuration);
            let found: Vec<u8> = layout.endpoints.iter().map(|one| one.address).collect();
            assert_eq!(found, [0x81, 0x02, 0x83]);
            assert_eq!(layout.interfaces.len(), 1);
            for cut in 0..configuration.len() {
                assert!(Layout::of(&configuration[..cut]).endpoints.len() <= 3);
            }
        }
        assert_eq!(Layout::of(&[0, 5, 1]), Layout::default());
        assert_eq!(Layout::of(&[7, 5, 0x81, 2, 0, 2, 0]), Layout::default());
    }
}
