//! What the device says of itself, byte by byte.

use eecvs_usb_class::{DESCRIPTOR_SET, DESCRIPTORS};
use usb_bridge::link::control::Request;
use usb_bridge::peripheral::{Peripheral, Reply, Speed};

use super::script::{Script, with_device};

fn word(bytes: &[u8], at: usize) -> usize {
    usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]))
}

#[test]
fn the_device_descriptor_is_as_documented() {
    with_device(Script::default(), |device| {
        let descriptors = device.descriptors().clone();
        assert_eq!(descriptors.speed, Speed::Full);
        assert_eq!(
            descriptors.device,
            [
                18, 1, 0x10, 0x02, 0xEF, 0x02, 0x01,
                64, // length, type, USB 2.1, composite, packets
                0x09, 0x12, 0x01, 0x00, 0x10, 0x00, // 1209:0001, release 0.1
                1, 2, 3, 1, // strings, one configuration
            ]
        );
        assert_eq!(
            descriptors.strings,
            [
                "EECVS",
                "EECVS event encoder",
                "000000010000000200000003",
                "EECVS encoder",
                "EECVS encoder, serial",
            ]
        );
        assert_eq!(device.wire().address(), 1);
    });
}

#[test]
fn the_configuration_has_both_functions() {
    with_device(Script::default(), |device| {
        let bytes = device.descriptors().configuration.clone();
        let expected: &[&[u8]] = &[
            &[9, 2, bytes.len() as u8, 0, 3, 1, 0, 0x80, 125],
            // The vendor's interface and its two endpoints of 64 bytes.
            &[9, 4, 0, 0, 2, 0xFF, 0xFF, 0xFF, 4],
            &[7, 5, 0x81, 2, 64, 0, 0],
            &[7, 5, 0x01, 2, 64, 0, 0],
            // Interfaces 1 and 2 belong together: a serial port.
            &[8, 11, 1, 2, 2, 2, 0, 0],
            &[9, 4, 1, 0, 1, 2, 2, 0, 5],
            &[5, 0x24, 0, 0x10, 0x01],
            &[4, 0x24, 2, 0],
            &[5, 0x24, 6, 1, 2],
            &[5, 0x24, 1, 0, 2],
            &[7, 5, 0x82, 3, 8, 0, 255],
            &[9, 4, 2, 0, 2, 10, 0, 0, 0],
            &[7, 5, 0x83, 2, 64, 0, 0],
            &[7, 5, 0x02, 2, 64, 0, 0],
        ];
        let mut at = 0;
        for descriptor in expected {
            assert_eq!(
                &bytes[at..at + usize::from(bytes[at])],
                *descriptor,
                "at {at}"
            );
            at += descriptor.len();
        }
        assert_eq!(at, bytes.len());
        assert_eq!(word(&bytes, 2), bytes.len());
    });
}

#[test]
fn windows_finds_what_it_asks_for() {
    with_device(Script::default(), |device| {
        let bos = device.descriptors().bos.clone();
        let mut expected = vec![5, 15, 40, 0, 2];
        // USB 2.0 extension: no link power management.
        expected.extend([7, 16, 2, 0, 0, 0, 0]);
        expected.extend([28, 16, 5, 0]);
        expected.extend([
            0xDF, 0x60, 0xDD, 0xD8, 0x89, 0x45, 0xC7, 0x4C, 0x9C, 0xD2, 0x65, 0x9D, 0x9E, 0x64,
            0x8A, 0x9F,
        ]);
        expected.extend([0, 0, 3, 6, 178, 0, DESCRIPTORS, 0]);
        assert_eq!(bos, expected);

        let request = Request::vendor_in(DESCRIPTORS, 0, 7);
        let Reply::Data(set) = device.control(request, &[], 178) else {
            panic!("no descriptor set");
        };
        assert_eq!(set, DESCRIPTOR_SET);
        // Any shorter length gives the beginning.
        for length in [0, 1, 10, 63, 64, 65, 128, 177] {
            let reply = device.control(request, &[], length);
            assert_eq!(reply, Reply::Data(set[..length].to_vec()), "{length}");
        }
        well_formed(&set);
    });
}

/// Walks the set as Windows does.
fn well_formed(set: &[u8]) {
    assert_eq!((word(set, 0), word(set, 2)), (10, 0));
    assert_eq!(&set[4..8], [0, 0, 3, 6]);
    assert_eq!(word(set, 8), set.len());
    let configuration = &set[10..];
    assert_eq!((word(configuration, 0), word(configuration, 2)), (8, 1));
    assert_eq!(word(configuration, 6), configuration.len());
    let function = &configuration[8..];
    assert_eq!((word(function, 0), word(function, 2)), (8, 2));
    assert_eq!(function[4], 0, "the first interface");
    assert_eq!(word(function, 6), function.len());
    let identity = &function[8..];
    assert_eq!((word(identity, 0), word(identity, 2)), (20, 3));
    assert_eq!(&identity[4..20], b"WINUSB\0\0\0\0\0\0\0\0\0\0");
    let property = &identity[20..];
    assert_eq!((word(property, 0), word(property, 2)), (property.len(), 4));
    assert_eq!(word(property, 4), 7, "a list of strings");
    let name = word(property, 6);
    let data = word(property, 8 + name);
    assert_eq!(property.len(), 10 + name + data);
    let text = |bytes: &[u8]| {
        let units: Vec<u16> = bytes.chunks(2).map(|unit| word(unit, 0) as u16).collect();
        String::from_utf16(&units).unwrap()
    };
    assert_eq!(text(&property[8..8 + name]), "DeviceInterfaceGUIDs\0");
    let guid = text(&property[10 + name..]);
    assert_eq!(guid.len(), 40);
    assert!(guid.ends_with("}\0\0"));
    let digits: Vec<usize> = guid[1..37].split('-').map(str::len).collect();
    assert_eq!(digits, [8, 4, 4, 4, 12]);
    assert!(
        guid[1..37]
            .chars()
            .all(|c| c == '-' || c.is_ascii_hexdigit())
    );
}
