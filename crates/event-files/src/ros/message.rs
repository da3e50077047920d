//! What a message of events says before its events.
//!
//! | message | fields |
//! |---|---|
//! | `event_camera_msgs/EventPacket` (once `event_array_msgs/EventArray`) | header, uint32 height, uint32 width, uint64 seq, uint64 time_base, string encoding, bool is_bigendian, uint8[] events |
//! | `dvs_msgs/EventArray`, `prophesee_event_msgs/EventArray` | header, uint32 height, uint32 width, Event[] of uint16 x, uint16 y, time ts, bool polarity |
//!
//! A header is (ROS 1 only) uint32 seq, then a time and a string. Its time is the computer's at the
//! arrival: no event's time is made of it.

use super::fields::{Cursor, Fields, Serialisation};

/// Where a message is damaged, and how.
pub type Damage = (usize, String);

/// A message's type.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Packed events in one of [`Encoding`].
    EventPacket,
    /// One structure for every event.
    EventArray,
}

impl Kind {
    /// The types' names, for messages.
    pub const NAMES: &str = "event_camera_msgs/EventPacket, dvs_msgs/EventArray or \
                             prophesee_event_msgs/EventArray";

    /// The kind of a ROS 1 or ROS 2 type's name.
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

/// How an `EventPacket`'s events are packed, by the names of the package `event_camera_codecs`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Prophesee's EVT 3.0 words of 16 bits.
    Evt3,
    /// 8 bytes an event: libcaer's word, then its time in us since `time_base`.
    Libcaer,
    /// Words of 16 bits like EVT 3.0's, with vectors along y.
    LibcaerCmp,
    /// 8 bytes an event, its time in ns since `time_base`.
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

    /// Bytes that belong together.
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
        /// How.
        encoding: Encoding,
        /// What times count from, in ns.
        base_ns: u64,
        /// Position of the next word.
        at: usize,
        /// Position behind the last word.
        end: usize,
    },
    /// Structures.
    Array {
        /// Position of the next one.
        cursor: Cursor,
        /// How many are left.
        left: u32,
    },
}

impl Content {
    /// Whether there are no events.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        match self {
            Self::Packed { at, end, .. } => *at >= *end,
            Self::Array { left, .. } => *left == 0,
        }
    }

    /// Time of the first event of `message`, whose content this is, where it can be read alone.
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

/// What stands before a message's events.
#[derive(Debug)]
pub struct Head {
    /// Columns; 0 where the recorder did not know.
    pub width: u32,
    /// Rows; 0 where the recorder did not know.
    pub height: u32,
    /// The computer's time at the arrival, since 1970 in ns.
    pub stamp_ns: u64,
    /// Number of an `EventPacket` among its publisher's; 0 of other types.
    pub sequence: u64,
    /// The events, unread.
    pub content: Content,
}

impl Head {
    /// Reads it from a message.
    ///
    /// # Errors
    /// The message is damaged, its encoding unknown: the position and what.
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
        // Whatever it is: only seeking asks.
        let (seconds, nanos) = (fields.u32()?, fields.u32()?);
        let stamp_ns = u64::from(seconds) * 1_000_000_000 + u64::from(nanos);
        fields.sequence()?;
        let (height, width) = (fields.u32()?, fields.u32()?);
        let mut sequence = 0;
        let content = match kind {
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
                    return Err("is_bigendian is set, which no decoder knows: record on a \
                                little-endian computer"
                        .to_owned());
                }
                let n = fields.sequence()?.len();
                let end = fields.cursor.at;
                let rest = n % encoding.word_bytes();
                if rest != 0 {
                    let word = encoding.word_bytes();
                    return Err(format!(
                        "{n} bytes of events are no whole words of {word}: damaged"
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
