//! `eecvs_msgs/msg/Frame`: a frame of docs/wire-format.md.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// One frame of a window of events.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// The computer's time at the window's end.
    pub header: Header,
    /// Number of the message: a gap is a loss.
    pub seq: u64,
    /// Start of the window, in the sensor's time.
    pub t0_us: u64,
    /// Its duration.
    pub duration_us: u32,
    /// Rows of the sensor.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Events told in this frame.
    pub events: u32,
    /// What decodes the data.
    pub operator_name: String,
    /// The frame.
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
