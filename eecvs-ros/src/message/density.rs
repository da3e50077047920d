//! `eecvs_msgs/msg/Density`: how dense a window is.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// Density of a window of events, and the transform that it chooses.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Density {
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
    /// Events of the window.
    pub events: u32,
    /// Messages of events that never came, since the start.
    pub packets_lost: u64,
    /// Events per second.
    pub rate_eps: f64,
    /// Events per pixel and second (eq. 1).
    pub density: f64,
    /// Below it, the window is sparse.
    pub tau_low: f64,
    /// From it on, the window is dense.
    pub tau_high: f64,
    /// 0 sparse, 1 moderate, 2 dense.
    pub regime: u8,
    /// `dwt`, `dtft` or `dct`.
    pub transform: String,
}

impl Message for Density {
    const TYPE: Type = Type {
        name: "eecvs_msgs/msg/Density",
        hash: "RIHS01_21e6dc512220750084630e0d9f7402f927ad77214a3361f2559c81e3eb477930",
        definition: with_header!(include_str!("../../../eecvs_msgs/msg/Density.msg")),
    };
}
