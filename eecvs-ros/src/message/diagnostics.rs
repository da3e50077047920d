//! `diagnostic_msgs/msg/DiagnosticArray`: the state of nodes, published on `/diagnostics`.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// Severity of a status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// All is well.
    Ok,
    /// Something was lost.
    Warn,
    /// The node does not work.
    Error,
    /// Nothing has arrived for a while.
    Stale,
}

/// Status of one node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 ok, 1 warn, 2 error, 3 stale.
    pub level: u8,
    /// Who reports it.
    pub name: String,
    /// Summary in a few words.
    pub message: String,
    /// The sensor.
    pub hardware_id: String,
    /// The figures behind the summary.
    pub values: Vec<KeyValue>,
}

/// A named figure.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name of the figure.
    pub key: String,
    /// The figure as text.
    pub value: String,
}

/// Statuses of several nodes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Header with the computer's time.
    pub header: Header,
    /// One entry per reporting node.
    pub status: Vec<DiagnosticStatus>,
}

impl From<Level> for u8 {
    fn from(level: Level) -> Self {
        match level {
            Level::Ok => 0,
            Level::Warn => 1,
            Level::Error => 2,
            Level::Stale => 3,
        }
    }
}

impl Message for DiagnosticArray {
    const TYPE: Type = Type {
        name: "diagnostic_msgs/msg/DiagnosticArray",
        hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
        definition: concat!(
            with_header!(
                "std_msgs/Header header\n\
                 diagnostic_msgs/DiagnosticStatus[] status\n"
            ),
            "================================================================================\n",
            "MSG: diagnostic_msgs/DiagnosticStatus\n",
            "byte OK=0\n",
            "byte WARN=1\n",
            "byte ERROR=2\n",
            "byte STALE=3\n",
            "byte level\n",
            "string name\n",
            "string message\n",
            "string hardware_id\n",
            "diagnostic_msgs/KeyValue[] values\n",
            "================================================================================\n",
            "MSG: diagnostic_msgs/KeyValue\n",
            "string key\n",
            "string value\n"
        ),
    };
}
