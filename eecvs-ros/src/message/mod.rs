//! Messages, as ROS 2 defines them, and their serialisation.
//!
//! Every transport carries a message as little-endian CDR of version 1: the nodes and the links need to agree on
//! nothing but [`to_cdr`] and [`from_cdr`]. Messages of other packages keep the definitions of those packages;
//! those of `eecvs_msgs` are defined in the folder of that name, which builds as a ROS 2 package.

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

/// Identification of a message type in ROS 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Type {
    /// Package and name: `std_msgs/msg/Header`.
    pub name: &'static str,
    /// The SHA-256 of the type's description (REP 2016), which Zenoh's keys contain.
    pub hash: &'static str,
    /// The fields in ROS 2's definition language, followed by the definitions of the nested types, as bags store
    /// them.
    pub definition: &'static str,
}

/// What a transport must know of a message type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TypeName<'a> {
    /// Package and name: `std_msgs/msg/Header`.
    pub name: &'a str,
    /// As [`Type::hash`]; empty if it is not known, which DDS does not need.
    pub hash: &'a str,
}

impl From<Type> for TypeName<'static> {
    fn from(kind: Type) -> Self {
        Self {
            name: kind.name,
            hash: kind.hash,
        }
    }
}

impl<'a> TypeName<'a> {
    /// Returns package and name separately: `std_msgs`, `Header`.
    #[must_use]
    pub fn parts(self) -> (&'a str, &'a str) {
        self.name.split_once("/msg/").unwrap_or(("", self.name))
    }

    /// Returns the name as DDS and Zenoh spell it: `std_msgs::msg::dds_::Header_`.
    #[must_use]
    pub fn dds(self) -> String {
        let (package, name) = self.parts();
        format!("{package}::msg::dds_::{name}_")
    }
}

/// A message that ROS 2 has a type for.
pub trait Message: Serialize + DeserializeOwned {
    /// The message's type.
    const TYPE: Type;
}

/// All message types that the nodes send or receive.
pub const TYPES: [Type; 6] = [
    EventPacket::TYPE,
    Frame::TYPE,
    Density::TYPE,
    Volume::TYPE,
    Image::TYPE,
    DiagnosticArray::TYPE,
];

impl Type {
    /// Returns the type of this name if it is one of [`TYPES`].
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        TYPES.into_iter().find(|known| known.name == name)
    }
}

/// Default limit of a message's data in bytes: larger messages are more likely to be lost.
pub const DATA_BYTES: u32 = 98_000;

/// Returns the sequence number that the publisher gave a serialised message, or `None` if the type has none or the
/// message is too short.
#[must_use]
pub fn sequence_of(kind: Type, cdr: &[u8]) -> Option<u64> {
    let mut fields = Fields::new(cdr, Serialisation::Cdr).ok()?;
    let mut number = || {
        // Skip the header: its stamp and frame_id.
        fields.u32()?;
        fields.u32()?;
        fields.sequence()?;
        if kind.name == EventPacket::TYPE.name {
            // Skip rows and columns.
            fields.u32()?;
            fields.u32()?;
        }
        fields.u64()
    };
    let has_one = [EventPacket::TYPE, Frame::TYPE, Density::TYPE, Volume::TYPE].contains(&kind);
    has_one.then(|| number().ok()).flatten()
}

/// Appends a message to `bytes`: the encapsulation, then its CDR serialisation.
///
/// # Panics
/// Never: every field of a message can be represented in CDR, and writing to memory does not fail.
pub fn put_cdr<M: Message>(message: &M, bytes: &mut Vec<u8>) {
    bytes.extend_from_slice(&ENCAPSULATION);
    let put = cdr_encoding::to_writer::<M, LittleEndian, _>(bytes, message);
    debug_assert!(put.is_ok(), "{put:?}");
}

/// Returns a message as CDR bytes, with the encapsulation in front.
#[must_use]
pub fn to_cdr<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = Vec::new();
    put_cdr(message, &mut bytes);
    bytes
}

/// Error: the bytes are not a message of the expected type.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Malformed {
    /// Not little-endian CDR of version 1.
    #[error("not little-endian CDR of version 1")]
    Representation,
    /// The message has other fields, or is damaged.
    #[error("the message has other fields, or is damaged: {0}")]
    Fields(String),
}

/// Decodes a message from CDR bytes, with the encapsulation in front.
///
/// # Errors
/// [`Malformed`] if the bytes are not a message of type `M`.
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
