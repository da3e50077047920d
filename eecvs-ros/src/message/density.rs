//! `eecvs_msgs/msg/Density`: the event density of a window.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// Event density of a window, and the transform that it selects.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Density {
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
    /// Events in the window.
    pub events: u32,
    /// Event messages lost since the start.
    pub packets_lost: u64,
    /// Events per second.
    pub rate_eps: f64,
    /// Events per pixel and second (eq. 1).
    pub density: f64,
    /// Density below which a window is sparse.
    pub tau_low: f64,
    /// Density from which a window is dense.
    pub tau_high: f64,
    /// 0 sparse, 1 moderate, 2 dense.
    pub regime: u8,
    /// Transform for this regime: `dwt`, `dtft` or `dct`.
    pub transform: String,
}

impl Message for Density {
    const TYPE: Type = Type {
        name: "eecvs_msgs/msg/Density",
        hash: "RIHS01_21e6dc512220750084630e0d9f7402f927ad77214a3361f2559c81e3eb477930",
        definition: with_header!(include_str!("../../../eecvs_msgs/msg/Density.msg")),
    };
}
