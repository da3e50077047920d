//! `eecvs_msgs/msg/Frame`: a frame of docs/wire-format.md, or of another operator.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// One frame of a window of events.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// The computer's time at the end of the window.
    pub header: Header,
    /// Sequence number of the message: a gap means a loss.
    pub seq: u64,
    /// Start of the window in the sensor's time, in microseconds.
    pub t0_us: u64,
    /// Duration of the window in microseconds.
    pub duration_us: u32,
    /// Rows of the sensor.
    pub height: u32,
    /// Columns of the sensor.
    pub width: u32,
    /// Events encoded in this frame.
    pub events: u32,
    /// Name of the operator that decodes `data`.
    pub operator_name: String,
    /// The frame's bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

impl Message for Frame {
    const TYPE: Type = Type {
        name: "eecvs_msgs/msg/Frame",
        hash: "RIHS01_2061cb87da15a9988f32ab9af4eb9a03654fa0dfa9b8897897fecee11f1b76a0",
        definition: with_header!(include_str!("../../../eecvs_msgs/msg/Frame.msg")),
    };
}
