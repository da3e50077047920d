//! `sensor_msgs/msg/Image`: what rqt and RViz show.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// A picture.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// The computer's time at the arrival of the last events in it.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// What a pixel is: `mono8`, `rgb8`.
    pub encoding: String,
    /// Whether numbers of several bytes begin with the highest.
    pub is_bigendian: u8,
    /// Bytes of a row.
    pub step: u32,
    /// Rows, one after the other.
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
