//! `eecvs_msgs/msg/Volume`: what networks take.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// A part of the dense volume of a window: channels x height x width, in C order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Volume {
    /// The computer's time at the window's end.
    pub header: Header,
    /// Number of the message: a gap is a loss.
    pub seq: u64,
    /// Start of the window, in the sensor's time.
    pub t0_us: u64,
    /// Its duration.
    pub duration_us: u32,
    /// Channels of the volume.
    pub channels: u32,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// What channels are: `dct`, `dwt`, `dtft` or `bins`.
    pub layout: String,
    /// Index of the first value here.
    pub offset: u64,
    /// Values.
    pub values: Vec<f32>,
}

impl Message for Volume {
    const TYPE: Type = Type {
        name: "eecvs_msgs/msg/Volume",
        hash: "RIHS01_0e8fbfcaa03c4f0f960bbda4dd5737d6c9d215e024d1ab07347d13b6e39505f9",
        definition: with_header!(include_str!("../../../eecvs_msgs/msg/Volume.msg")),
    };
}
