//! `eecvs_msgs/msg/Volume`: the dense input of networks.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// A part of the dense volume of a window: channels x height x width, in C order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Volume {
    /// The computer's time at the end of the window.
    pub header: Header,
    /// Sequence number of the message: a gap means a loss.
    pub seq: u64,
    /// Start of the window in the sensor's time, in microseconds.
    pub t0_us: u64,
    /// Duration of the window in microseconds.
    pub duration_us: u32,
    /// Channels of the volume.
    pub channels: u32,
    /// Rows of the sensor.
    pub height: u32,
    /// Columns of the sensor.
    pub width: u32,
    /// Meaning of the channels: coefficients of `dct`, `dwt` or `dtft`, or time bins with `bins` (nearest) or
    /// `bilinear` weights.
    pub layout: String,
    /// Index in the volume of the first value in this message.
    pub offset: u64,
    /// Values from `offset` on.
    pub values: Vec<f32>,
}

impl Message for Volume {
    const TYPE: Type = Type {
        name: "eecvs_msgs/msg/Volume",
        hash: "RIHS01_0e8fbfcaa03c4f0f960bbda4dd5737d6c9d215e024d1ab07347d13b6e39505f9",
        definition: with_header!(include_str!("../../../eecvs_msgs/msg/Volume.msg")),
    };
}
