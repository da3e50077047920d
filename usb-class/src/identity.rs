//! Numbers and strings by which a host recognises the device.

/// USB vendor and product numbers: 1209:0001, which pid.codes provides for tests. A product needs a pair of its
/// own, as other test devices may have this one too; hosts therefore also check the strings.
pub const VENDOR_AND_PRODUCT: (u16, u16) = (0x1209, 0x0001);
/// Release of the device, `bcdDevice`: 0.1.
pub const RELEASE: u16 = 0x0010;
/// Manufacturer, string 1.
pub const MANUFACTURER: &str = "EECVS";
/// Product, string 2.
pub const PRODUCT: &str = "EECVS event encoder";
/// Name of the vendor's interface, which Windows shows.
pub const VENDOR_NAME: &str = "EECVS encoder";
/// Name of the serial port's interface.
pub const SERIAL_NAME: &str = "EECVS encoder, serial";
/// Class of device interfaces by which Windows programs find the encoder.
pub const DEVICE_INTERFACE: &str = "{6A2D7B84-3F51-4E0C-9B7E-5C0F8D1EEC55}";

/// Number of digits in a serial number.
pub const SERIAL_BYTES: usize = 24;

/// Returns a chip's unique number of 96 bits as 24 hexadecimal digits in ASCII, for string 3.
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
