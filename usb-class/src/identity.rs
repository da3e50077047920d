//! Numbers and strings that a host knows the device by.

/// USB vendor and product: 1209:0001 is what pid.codes gives for tests. A product needs a pair of its own,
/// as another device of somebody's tests may have this one: hosts look at the strings too.
pub const VENDOR_AND_PRODUCT: (u16, u16) = (0x1209, 0x0001);
/// Release of the device, `bcdDevice`: 0.1.
pub const RELEASE: u16 = 0x0010;
/// String 1.
pub const MANUFACTURER: &str = "EECVS";
/// String 2.
pub const PRODUCT: &str = "EECVS event encoder";
/// String of the vendor's interface: what Windows shows.
pub const VENDOR_NAME: &str = "EECVS encoder";
/// String of the serial port's interface.
pub const SERIAL_NAME: &str = "EECVS encoder, serial";
/// The class of device interfaces under which Windows' programs find the encoder.
pub const DEVICE_INTERFACE: &str = "{6A2D7B84-3F51-4E0C-9B7E-5C0F8D1EEC55}";

/// Digits of a serial number.
pub const SERIAL_BYTES: usize = 24;

/// A chip's unique number of 96 bits as 24 digits, string 3.
#[must_use]
pub fn serial_number(unique: [u32; 3]) -> [u8; SERIAL_BYTES] {
    let mut text = [0; SERIAL_BYTES];
    let (digits, _) = text.as_chunks_mut::<8>();
    for (digits, word) in digits.iter_mut().zip(unique) {
        for (place, digit) in digits.iter_mut().rev().enumerate() {
            let value = (word >> (4 * place)) as u8 & 15;
            *digit = match value {
                0..10 => b'0' + value,
                _ => b'A' - 10 + value,
            };
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_serial_number_is_the_chips_words() {
        let text = serial_number([0x0012_ABCD, 0, u32::MAX]);
        assert_eq!(&text, b"0012ABCD00000000FFFFFFFF");
    }
}
