//! Microsoft OS 2.0 descriptors, from which Windows loads WinUSB for the vendor's function, so that no driver has
//! to be installed. The serial port's function needs none: Windows has its driver.

use crate::identity::DEVICE_INTERFACE;
use crate::requests::DESCRIPTORS;

/// Windows 8.1, the first version that asks.
const WINDOWS: [u8; 4] = [0x00, 0x00, 0x03, 0x06];
/// `MS_OS_20_DESCRIPTOR_INDEX`: `wIndex` of the request for the set.
pub const SET_INDEX: u16 = 7;
/// The vendor's interface: the first of its function.
const INTERFACE: u8 = 0;

const NAME: &str = "DeviceInterfaceGUIDs";
/// Length of the name in UTF-16 with its terminator.
const NAME_BYTES: usize = 2 * (NAME.len() + 1);
/// Length of the list of strings, which has a terminator of its own.
const DATA_BYTES: usize = 2 * (DEVICE_INTERFACE.len() + 2);

const PROPERTY_AT: usize = 10 + 8 + 8 + 20;
const SET_BYTES: usize = PROPERTY_AT + 10 + NAME_BYTES + DATA_BYTES;

/// Content of the platform capability in the binary object store, from `bReserved` on: the set's UUID
/// D8DD60DF-4589-4CC7-9CD2-659D9E648A9F, the version of Windows, the set's length, the request that returns it, and
/// no alternate enumeration.
pub const PLATFORM_CAPABILITY: [u8; 25] = [
    0x00, //
    0xDF,
    0x60,
    0xDD,
    0xD8,
    0x89,
    0x45,
    0xC7,
    0x4C, //
    0x9C,
    0xD2,
    0x65,
    0x9D,
    0x9E,
    0x64,
    0x8A,
    0x9F, //
    WINDOWS[0],
    WINDOWS[1],
    WINDOWS[2],
    WINDOWS[3], //
    SET_BYTES as u8,
    (SET_BYTES >> 8) as u8, //
    DESCRIPTORS,
    0x00,
];

/// The descriptor set:
///
/// | at | bytes | descriptor |
/// |---|---|---|
/// | 0 | 10 | header of the set |
/// | 10 | 8 | header of the first configuration |
/// | 18 | 8 | header of the function that begins with interface 0 |
/// | 26 | 20 | compatible identity `WINUSB` |
/// | 46 | 132 | registry property `DeviceInterfaceGUIDs`, a list of strings |
pub const DESCRIPTOR_SET: [u8; SET_BYTES] = descriptor_set();

const fn descriptor_set() -> [u8; SET_BYTES] {
    let mut set = [0; SET_BYTES];
    let mut at = 0;
    at = put_word(&mut set, at, 10);
    at = put_word(&mut set, at, 0);
    at = put(&mut set, at, &WINDOWS);
    at = put_word(&mut set, at, SET_BYTES);

    at = put_word(&mut set, at, 8);
    at = put_word(&mut set, at, 1);
    // Index of the configuration, and a reserved byte.
    at = put(&mut set, at, &[0, 0]);
    at = put_word(&mut set, at, SET_BYTES - 10);

    at = put_word(&mut set, at, 8);
    at = put_word(&mut set, at, 2);
    at = put(&mut set, at, &[INTERFACE, 0]);
    at = put_word(&mut set, at, SET_BYTES - 18);

    at = put_word(&mut set, at, 20);
    at = put_word(&mut set, at, 3);
    at = put(&mut set, at, b"WINUSB\0\0");
    // No sub-compatible identity.
    at = put(&mut set, at, &[0; 8]);

    at = put_word(&mut set, at, SET_BYTES - PROPERTY_AT);
    at = put_word(&mut set, at, 4);
    // REG_MULTI_SZ.
    at = put_word(&mut set, at, 7);
    at = put_word(&mut set, at, NAME_BYTES);
    put_text(&mut set, at, NAME);
    at += NAME_BYTES;
    at = put_word(&mut set, at, DATA_BYTES);
    put_text(&mut set, at, DEVICE_INTERFACE);
    at += DATA_BYTES;
    assert!(at == SET_BYTES);
    set
}

const fn put(set: &mut [u8; SET_BYTES], at: usize, bytes: &[u8]) -> usize {
    let mut i = 0;
    while i < bytes.len() {
        set[at + i] = bytes[i];
        i += 1;
    }
    at + bytes.len()
}

const fn put_word(set: &mut [u8; SET_BYTES], at: usize, word: usize) -> usize {
    put(set, at, &(word as u16).to_le_bytes())
}

/// Writes a text in UTF-16. Its terminator is zeros, which are there already.
const fn put_text(set: &mut [u8; SET_BYTES], at: usize, text: &str) {
    let bytes = text.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        set[at + 2 * i] = bytes[i];
        i += 1;
    }
}
