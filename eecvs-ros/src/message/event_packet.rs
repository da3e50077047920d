//! `event_camera_msgs/msg/EventPacket`: the messages that drivers of event cameras publish.

use serde::{Deserialize, Serialize};

use super::{Header, Message, Type};

/// A message of packed events.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventPacket {
    /// The computer's time at the arrival of the first event.
    pub header: Header,
    /// Rows of the sensor.
    pub height: u32,
    /// Columns of the sensor.
    pub width: u32,
    /// Sequence number of the message: a gap means a loss.
    pub seq: u64,
    /// Origin of the event times in nanoseconds, if the encoding uses it.
    pub time_base: u64,
    /// How events are packed: `evt3`, `libcaer`, `libcaer_cmp`, `mono`.
    pub encoding: String,
    /// Whether the words of `events` are big-endian.
    pub is_bigendian: bool,
    /// The packed events.
    #[serde(with = "serde_bytes")]
    pub events: Vec<u8>,
}

impl Message for EventPacket {
    const TYPE: Type = Type {
        name: event_files::ros::packets::TYPE_ROS2,
        hash: event_files::ros::packets::HASH_ROS2,
        definition: event_files::ros::packets::DEFINITION_ROS2,
    };
}
