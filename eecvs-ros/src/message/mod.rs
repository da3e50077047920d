//! Messages, as ROS 2 defines them, and their bytes.
//!
//! A message travels as CDR of version 1, little-endian, whatever carries it: [`to_cdr`] and [`from_cdr`] are all
//! that the nodes and the links have to agree on. The messages of other packages are theirs; those of
//! `eecvs_msgs` are defined in the folder of that name, which builds as a package of ROS 2.

mod density;
mod diagnostics;
mod event_packet;
mod frame;
mod header;
mod image;
mod volume;

use byteorder::LittleEndian;
use event_files::ros::fields::{Fields, Serialisation};
use serde::Serialize;
use serde::de::DeserializeOwned;

pub use density::Density;
pub use diagnostics::{DiagnosticArray, DiagnosticStatus, KeyValue, Level};
pub use event_packet::EventPacket;
pub use frame::Frame;
pub use header::{Header, Time};
pub use image::Image;
pub use volume::Volume;

/// The four bytes in front of a message: CDR of version 1, little-endian, no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// What ROS 2 knows a message's type by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Type {
    /// Package and name: `std_msgs/msg/Header`.
    pub name: &'static str,
    /// The SHA-256 of its description (REP 2016), which Zenoh's keys carry.
    pub hash: &'static str,
    /// Its fields in the language of ROS 2, those of its parts behind it, as bags store them.
    pub definition: &'static str,
}

impl Type {
    /// Package and name apart: `std_msgs`, `Header`.
    #[must_use]
    pub fn parts(&self) -> (&'static str, &'static str) {
        self.name.split_once("/msg/").unwrap_or(("", self.name))
    }

    /// As DDS and Zenoh spell it: `std_msgs::msg::dds_::Header_`.
    #[must_use]
    pub fn dds(&self) -> String {
        let (package, name) = self.parts();
        format!("{package}::msg::dds_::{name}_")
    }
}

/// A message.
pub trait Message: Serialize + DeserializeOwned {
    /// Its type.
    const TYPE: Type;
}

/// Every type that is sent or received here.
pub const TYPES: [Type; 6] = [
    EventPacket::TYPE,
    Frame::TYPE,
    Density::TYPE,
    Volume::TYPE,
    Image::TYPE,
    DiagnosticArray::TYPE,
];

/// The number of a message among its publisher's, where its type has one.
#[must_use]
pub fn sequence_of(kind: Type, cdr: &[u8]) -> Option<u64> {
    let mut fields = Fields::new(cdr, Serialisation::Cdr).ok()?;
    let mut number = || {
        // The header: its stamp and its name.
        fields.u32()?;
        fields.u32()?;
        fields.sequence()?;
        if kind.name == EventPacket::TYPE.name {
            // Rows and columns.
            fields.u32()?;
            fields.u32()?;
        }
        fields.u64()
    };
    let has_one = [EventPacket::TYPE, Frame::TYPE, Density::TYPE, Volume::TYPE].contains(&kind);
    has_one.then(|| number().ok()).flatten()
}

/// Appends a message's bytes.
///
/// # Panics
/// Never: a message has no field that CDR lacks, and memory takes all bytes.
pub fn put_cdr<M: Message>(message: &M, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&ENCAPSULATION);
    let put = cdr_encoding::to_writer::<M, LittleEndian, _>(bytes, message);
    debug_assert!(put.is_ok(), "{put:?}");
}

/// A message's bytes.
#[must_use]
pub fn to_cdr<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    put_cdr(message, &mut bytes);
    bytes
}

/// Bytes that are no message of the type that is wanted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// Another representation than CDR of version 1, little-endian.
    #[error("not little-endian CDR of version 1")]
    Representation,
    /// The fields are others, or the message is damaged.
    #[error("other fields, or a damage: {0}")]
    Fields(String),
}

/// The message of some bytes.
///
/// # Errors
/// [`Malformed`].
pub fn from_cdr<M: Message>(bytes: &[u8]) -> Result<M, Malformed> {
    let Some((_, fields)) = bytes
        .split_first_chunk()
        .filter(|(start, _): &(&[u8; 4], _)| start[..2] == ENCAPSULATION[..2])
    else {
        return Err(Malformed::Representation);
    };
    match cdr_encoding::from_bytes::<M, LittleEndian>(fields) {
        Ok((message, _)) => Ok(message),
        Err(error) => Err(Malformed::Fields(error.to_string())),
    }
}
