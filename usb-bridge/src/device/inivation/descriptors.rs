//! Descriptors of cameras with one interface of the vendor's class (USB 2.0, 9.6; USB 3.2, 9.6).

use crate::peripheral::{Descriptors, Speed};

/// An endpoint to the host.
#[derive(Debug, Clone, Copy)]
pub struct Endpoint {
    address: u8,
    attributes: u8,
    /// Bytes of a packet where it is not the speed's own.
    packet: Option<u16>,
}

impl Endpoint {
    /// One of bulk transfers.
    pub const fn bulk(address: u8) -> Self {
        Self {
            address,
            attributes: 2,
            packet: None,
        }
    }

    /// One of interrupts of 64 bytes, each 125 us at the most.
    pub const fn interrupt(address: u8) -> Self {
        Self {
            address,
            attributes: 3,
            packet: Some(64),
        }
    }
}

/// Packets that a bulk endpoint at SuperSpeed may send in a row, less one.
const BURST: u8 = 15;

/// Descriptors of a device with the `ids` vendor, product and release, and the `names` of maker,
/// product and serial number.
pub fn descriptors(
    speed: Speed,
    ids: (u16, u16, u16),
    names: [&str; 3],
    endpoints: &[Endpoint],
) -> Descriptors {
    let is_super = speed == Speed::Super;
    let (usb, control_packet): (u16, u8) = if is_super { (0x0300, 9) } else { (0x0200, 64) };
    let mut device = vec![18, 1];
    device.extend(usb.to_le_bytes());
    device.extend([0xFF, 0, 0, control_packet]);
    for id in [ids.0, ids.1, ids.2] {
        device.extend(id.to_le_bytes());
    }
    device.extend([1, 2, 3, 1]);

    let mut interface = vec![9, 4, 0, 0, endpoints.len() as u8, 0xFF, 0, 0, 0];
    for endpoint in endpoints {
        let packet = endpoint.packet.unwrap_or(match speed {
            Speed::Full => 64,
            Speed::High => 512,
            Speed::Super => 1024,
        });
        let is_bulk = endpoint.attributes == 2;
        interface.extend([7, 5, endpoint.address, endpoint.attributes]);
        interface.extend(packet.to_le_bytes());
        interface.push(u8::from(!is_bulk));
        if is_super {
            let per_interval = if is_bulk { 0 } else { packet };
            interface.extend([6, 0x30, if is_bulk { BURST } else { 0 }, 0]);
            interface.extend(per_interval.to_le_bytes());
        }
    }
    let mut configuration = vec![9, 2];
    configuration.extend((9 + interface.len() as u16).to_le_bytes());
    // One interface, configuration 1, powered by the bus: 500 mA, or 504 mA in units of 8.
    configuration.extend([1, 1, 0, 0x80, if is_super { 63 } else { 250 }]);
    configuration.extend(interface);

    let mut bos = Vec::new();
    if is_super {
        bos.extend([5, 15, 22, 0, 2]);
        // USB 2.0 extension with link power management; SuperSpeed: all speeds from Full on, exit
        // latencies of 10 and 2047 us at the most.
        bos.extend([7, 16, 2, 2, 0, 0, 0]);
        bos.extend([10, 16, 3, 0, 0x0E, 0, 1, 10, 0xFF, 0x07]);
    }
    Descriptors {
        device,
        configuration,
        bos,
        strings: names.map(String::from).into(),
        speed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walks descriptors by their lengths.
    fn kinds(mut bytes: &[u8]) -> Vec<u8> {
        let mut kinds = Vec::new();
        while let [length, kind, ..] = bytes {
            kinds.push(*kind);
            bytes = &bytes[usize::from(*length)..];
        }
        assert!(bytes.is_empty());
        kinds
    }

    #[test]
    fn lengths_add_up() {
        let endpoints = [Endpoint::interrupt(0x81), Endpoint::bulk(0x82)];
        for speed in [Speed::High, Speed::Super] {
            let it = descriptors(speed, (1, 2, 3), ["a", "b", "c"], &endpoints);
            assert_eq!(it.device.len(), 18);
            let total = u16::from_le_bytes([it.configuration[2], it.configuration[3]]);
            assert_eq!(usize::from(total), it.configuration.len());
            let is_super = speed == Speed::Super;
            let want: &[u8] = if is_super {
                &[2, 4, 5, 0x30, 5, 0x30]
            } else {
                &[2, 4, 5, 5]
            };
            assert_eq!(kinds(&it.configuration), want);
            assert_eq!(kinds(&it.bos).len(), if is_super { 3 } else { 0 });
            if is_super {
                assert_eq!(usize::from(it.bos[2]), it.bos.len());
            }
        }
    }
}
