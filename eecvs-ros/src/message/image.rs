//! `sensor_msgs/msg/Image`: pictures, as rqt and RViz show them.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// An uncompressed picture.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// The computer's time at the arrival of the latest events in the picture.
    pub header: Header,
    /// Number of rows.
    pub height: u32,
    /// Number of columns.
    pub width: u32,
    /// Pixel format: `mono8`, `rgb8`.
    pub encoding: String,
    /// Whether multi-byte values are big-endian.
    pub is_bigendian: u8,
    /// Bytes per row.
    pub step: u32,
    /// Pixels, row by row.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

impl Message for Image {
    const TYPE: Type = Type {
        name: "sensor_msgs/msg/Image",
        hash: "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        definition: with_header!(
            "std_msgs/Header header\n\
             uint32 height\n\
             uint32 width\n\
             string encoding\n\
             uint8 is_bigendian\n\
             uint32 step\n\
             uint8[] data\n"
        ),
    };
}
