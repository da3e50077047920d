//! Forwards one stream to many consumers, none of which can hold up the others or the camera.
//!
//! ```text
//! frames or raw packets -> fan_out -> a queue per consumer -> sink (tcp, udp, unix, file, stdout)
//! senders (tcp, udp, unix) -> receive -> a file
//! ```

pub mod address;
pub mod consumer;
pub mod datagram;
pub mod demux;
pub mod fan_out;
pub mod packet;
pub mod packetise;
pub mod receive;
pub mod refusal;
pub mod senders;
pub mod sink;
