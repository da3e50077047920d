//! Reads the part of an event message before its events.
//!
//! * `event_camera_msgs/EventPacket` (formerly `event_array_msgs/EventArray`) has the fields header, uint32 height,
//!   uint32 width, uint64 seq, uint64 time_base, string encoding, bool is_bigendian, `uint8[]` events.
//! * `dvs_msgs/EventArray` and `prophesee_event_msgs/EventArray` have the fields header, uint32 height, uint32
//!   width, `Event[]` of uint16 x, uint16 y, time ts, bool polarity.
//!
//! A header is uint32 seq (ROS 1 only), a time and a string. Its time is the computer's at the arrival and does not
//! enter the time of any event.

use super::fields::{Cursor, Fields, Serialisation};

/// The position of damage in a message, and its description.
pub type Damage = (usize, String);

/// The type of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Events packed in one of the [`Encoding`]s.
    EventPacket,
    /// One structure for each event.
    EventArray,
    /// A picture.
    Image,
}

impl Kind {
    /// Names of the types, for messages to the user.
    pub const NAMES: &str = "event_camera_msgs/EventPacket, dvs_msgs/EventArray or \
                             prophesee_event_msgs/EventArray";

    /// Returns [`Kind::Image`] for the ROS 1 or ROS 2 type of pictures; `None` for any other.
    #[must_use]
    pub fn of_image(name: &str) -> Option<Self> {
        let is_image = name.replace("/msg/", "/") == "sensor_msgs/Image";
        is_image.then_some(Self::Image)
    }

    /// Returns the kind of a ROS 1 or ROS 2 type; `None` if its messages are not events.
    #[must_use]
    pub fn of(name: &str) -> Option<Self> {
        match name.replace("/msg/", "/").as_str() {
            "event_camera_msgs/EventPacket" | "event_array_msgs/EventArray" => {
                Some(Self::EventPacket)
            }
            "dvs_msgs/EventArray" | "prophesee_event_msgs/EventArray" => Some(Self::EventArray),
            _ => None,
        }
    }
}

/// The packing of an `EventPacket`'s events, by the names of the package `event_camera_codecs`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Prophesee's EVT 3.0 words of 16 bits.
    Evt3,
    /// 8 bytes an event: libcaer's word, then the time in us since `time_base`.
    Libcaer,
    /// Words of 16 bits like those of EVT 3.0, with vectors along y.
    LibcaerCmp,
    /// 8 bytes an event, with its time in ns since `time_base`.
    Mono,
}

impl Encoding {
    fn of(name: &str) -> Result<Self, String> {
        match name {
            "evt3" => Ok(Self::Evt3),
            "libcaer" => Ok(Self::Libcaer),
            "libcaer_cmp" => Ok(Self::LibcaerCmp),
            "mono" => Ok(Self::Mono),
            other => Err(format!(
                "encoding {other:?} is not known: record evt3, libcaer, libcaer_cmp or mono"
            )),
        }
    }

    /// Returns the size of a word in bytes.
    #[must_use]
    pub fn word_bytes(self) -> usize {
        match self {
            Self::Evt3 | Self::LibcaerCmp => 2,
            Self::Libcaer | Self::Mono => 8,
        }
    }
}

/// The events of a message.
#[derive(Debug, Clone, Copy)]
pub enum Content {
    /// Packed events between two positions of the message.
    Packed {
        /// Their encoding.
        encoding: Encoding,
        /// Time from which their times count, in ns.
        base_ns: u64,
        /// Position of the next word.
        at: usize,
        /// Position after the last word.
        end: usize,
    },
    /// A structure for each event.
    Array {
        /// Position of the next structure.
        cursor: Cursor,
        /// Number of structures left.
        left: u32,
    },
}

impl Content {
    /// Returns whether no events are left.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        match self {
            Self::Packed { at, end, .. } => *at >= *end,
            Self::Array { left, .. } => *left == 0,
        }
    }

    /// Returns the time in us of the first event of `message`, whose content this is; `None` if it depends on
    /// earlier words or cannot be read.
    #[must_use]
    pub fn first_us(&self, message: &[u8]) -> Option<u64> {
        let t_ns = match *self {
            Self::Array { cursor, .. } => {
                let mut fields = Fields::resume(message, cursor);
                fields.u16().and_then(|_| fields.u16()).ok()?;
                fields.time_ns().ok()?
            }
            Self::Packed {
                encoding,
                base_ns,
                at,
                ..
            } => {
                let [a, b, c, d, e, f, g, h] = *message.get(at..)?.first_chunk()?;
                let since_ns = match encoding {
                    Encoding::Libcaer => u64::from(u32::from_le_bytes([e, f, g, h])) * 1000,
                    Encoding::Mono => u32::from_le_bytes([a, b, c, d]).into(),
                    Encoding::Evt3 | Encoding::LibcaerCmp => return None,
                };
                base_ns.checked_add(since_ns)?
            }
        };
        Some(t_ns / 1000)
    }
}

/// The part of a message before its events.
#[derive(Debug)]
pub struct Head {
    /// Number of columns; 0 if the recorder did not know it.
    pub width: u32,
    /// Number of rows; 0 if the recorder did not know it.
    pub height: u32,
    /// The computer's time at the arrival, in ns since 1970.
    pub stamp_ns: u64,
    /// Sequence number of an `EventPacket`; 0 for other types.
    pub sequence: u64,
    /// The events, not yet read.
    pub content: Content,
}

impl Head {
    /// Reads the head of a message.
    ///
    /// # Errors
    /// The message is damaged, or its encoding is unknown; the error is the position and a description.
    pub fn read(bytes: &[u8], kind: Kind, serialisation: Serialisation) -> Result<Self, Damage> {
        let mut fields = Fields::new(bytes, serialisation).map_err(|what| (0, what))?;
        let head = Self::fields(&mut fields, kind, serialisation);
        head.map_err(|what| (fields.cursor.at, what))
    }

    fn fields(
        fields: &mut Fields<'_>,
        kind: Kind,
        serialisation: Serialisation,
    ) -> Result<Self, String> {
        if serialisation == Serialisation::Ros1 {
            fields.u32()?;
        }
        // Not checked, since only seeking uses the stamp.
        let (seconds, nanos) = (fields.u32()?, fields.u32()?);
        let stamp_ns = u64::from(seconds) * 1_000_000_000 + u64::from(nanos);
        fields.sequence()?;
        let (height, width) = (fields.u32()?, fields.u32()?);
        let mut sequence = 0;
        let content = match kind {
            Kind::Image => return Err("an image, which has no events".to_owned()),
            Kind::EventArray => {
                let left = fields.u32()?;
                let cursor = fields.cursor;
                Content::Array { cursor, left }
            }
            Kind::EventPacket => {
                sequence = fields.u64()?;
                let base_ns = fields.u64()?;
                let encoding = Encoding::of(fields.string()?)?;
                if fields.u8()? != 0 {
                    return Err(
                        "is_bigendian is set, which no decoder supports: record on a little-endian \
                         computer"
                            .to_owned(),
                    );
                }
                let n = fields.sequence()?.len();
                let end = fields.cursor.at;
                let rest = n % encoding.word_bytes();
                if rest != 0 {
                    let word = encoding.word_bytes();
                    return Err(format!(
                        "{n} bytes of events are not whole words of {word} bytes: damaged"
                    ));
                }
                Content::Packed {
                    encoding,
                    base_ns,
                    at: end - n,
                    end,
                }
            }
        };
        Ok(Self {
            width,
            height,
            stamp_ns,
            sequence,
            content,
        })
    }
}
