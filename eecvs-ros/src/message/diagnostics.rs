//! `diagnostic_msgs/msg/DiagnosticArray`: how a node fares, on `/diagnostics`.

use serde::{Deserialize, Serialize};

use super::header::with_header;
use super::{Header, Message, Type};

/// How serious a status is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// All is well.
    Ok,
    /// Something was lost.
    Warn,
    /// It does not work.
    Error,
    /// Nothing has come for a while.
    Stale,
}

/// What one node says.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 ok, 1 warn, 2 error, 3 stale.
    pub level: u8,
    /// Who says it.
    pub name: String,
    /// In a few words.
    pub message: String,
    /// The sensor.
    pub hardware_id: String,
    /// In figures.
    pub values: Vec<KeyValue>,
}

/// A figure and its name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Figure.
    pub value: String,
}

/// What several say.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// The computer's time.
    pub header: Header,
    /// One for each who says something.
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
