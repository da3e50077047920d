//! `event_camera_msgs/msg/EventPacket`: what drivers of event cameras publish.

use serde::{Deserialize, Serialize};

use super::{Header, Message, Type};

/// Packed events.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EventPacket {
    /// The computer's time at the arrival of the first event.
    pub header: Header,
    /// Rows of the sensor.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Number of the message: a gap is a loss.
    pub seq: u64,
    /// What times count from, in ns, where the encoding says so.
    pub time_base: u64,
    /// How events are packed: `evt3`, `libcaer`, `libcaer_cmp`, `mono`.
    pub encoding: String,
    /// Whether the words' bytes are swapped.
    pub is_bigendian: bool,
    /// The words.
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
