//! USB identities of event cameras.

/// Family of devices that share a stream format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Family {
    /// iniVation DVS128: 4-byte records of address and time.
    Dvs128,
    /// iniVation DAVIS240 and DAVIS346: 16-bit words.
    Davis,
    /// iniVation DVXplorer: 16-bit words, columns and groups of 8 rows.
    DvXplorer,
    /// Prophesee EVK2, EVK3, EVK4 and cameras built on them: EVT 2.1 or EVT 3.
    Prophesee,
}

/// A camera's USB identity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Camera {
    /// USB vendor.
    pub vendor: u16,
    /// USB product.
    pub product: u16,
    /// Stream format.
    pub family: Family,
    /// Name for people.
    pub name: &'static str,
    /// Bulk endpoint of the event stream.
    pub stream_endpoint: u8,
}

/// Every camera that is known.
pub const CAMERAS: [Camera; 7] = [
    camera(0x152A, 0x8400, Family::Dvs128, "DVS128", 0x86),
    camera(0x152A, 0x841B, Family::Davis, "DAVIS240 (FX2)", 0x82),
    camera(0x152A, 0x841A, Family::Davis, "DAVIS346 (FX3)", 0x82),
    camera(0x152A, 0x8419, Family::DvXplorer, "DVXplorer", 0x82),
    camera(0x04B4, 0x00F4, Family::Prophesee, "EVK3 or EVK4", 0x81),
    camera(0x04B4, 0x00F5, Family::Prophesee, "EVK3 or EVK4", 0x81),
    camera(0x03FD, 0x5832, Family::Prophesee, "EVK2", 0x81),
];

const fn camera(
    vendor: u16,
    product: u16,
    family: Family,
    name: &'static str,
    stream_endpoint: u8,
) -> Camera {
    Camera {
        vendor,
        product,
        family,
        name,
        stream_endpoint,
    }
}

/// The camera with this USB identity.
#[must_use]
pub fn find(vendor: u16, product: u16) -> Option<&'static Camera> {
    CAMERAS
        .iter()
        .find(|camera| (camera.vendor, camera.product) == (vendor, product))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_are_unique_and_stream_from_the_device() {
        for (i, camera) in CAMERAS.iter().enumerate() {
            assert_eq!(find(camera.vendor, camera.product), CAMERAS.get(i));
            assert_ne!(camera.stream_endpoint & 0x80, 0, "{}", camera.name);
        }
        assert_eq!(find(0x152A, 0x0000), None);
    }
}
