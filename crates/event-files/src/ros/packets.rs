//! Packs events into `event_camera_msgs/EventPacket` messages, for the writers of bags.
//!
//! The encoding is `libcaer`, the only one of the package `event_camera_codecs` that represents any events in any
//! order exactly: 8 bytes an event. The data word has the polarity in bit 1, y in bits 2 to 16 and x in bits 17 to
//! 31 (bit 0, libcaer's mark of validity, is set); the time word counts microseconds from `time_base`, which is in
//! ns. A reader takes a time below the previous one for a roll-over of 31 bits, so a step back begins a new
//! message, whose `time_base` and stamp are the time of its first event.
//!
//! Messages are stored under the largest stamp so far, so that readers that sort by it keep the file's order.

use event_types::stream::Result;
use event_types::{Event, Polarity, Sensor, ensure};

use super::fields::Serialisation;
use crate::{EventWriter, check_inside};

/// Topic of the events, the same as the drivers'.
pub const TOPIC: &str = "/event_camera/events";

/// The message's type in ROS 2.
pub const TYPE_ROS2: &str = "event_camera_msgs/msg/EventPacket";

/// Hash that identifies the definition in ROS 2: the SHA-256 of its description (REP 2016).
pub const HASH_ROS2: &str =
    "RIHS01_d6fa176260b1f37e5a40845305315e150a0f18191241eb64f407442aa29844aa";

/// Name of the camera in message headers.
const FRAME_ID: &str = "event_camera";

/// Largest number of events in a message: messages above 100 kB get lost between machines.
const PACKET_EVENTS: usize = 12_000;

/// Longest time that a message spans, so that a bag plays smoothly.
const PACKET_US: u64 = 10_000;

/// Definition of the message in the language of ROS 2, followed by those of its parts.
pub const DEFINITION_ROS2: &str = "std_msgs/Header header\n\
uint32 height\n\
uint32 width\n\
uint64 seq\n\
uint64 time_base\n\
string encoding\n\
bool is_bigendian\n\
uint8[] events\n\
================================================================================\n\
MSG: std_msgs/Header\n\
builtin_interfaces/Time stamp\n\
string frame_id\n\
================================================================================\n\
MSG: builtin_interfaces/Time\n\
int32 sec\n\
uint32 nanosec\n";

/// Definition of the message in the language of ROS 1, followed by that of its header.
pub const DEFINITION_ROS1: &str = "Header header\n\
uint32 height\n\
uint32 width\n\
uint64 seq\n\
uint64 time_base\n\
string encoding\n\
bool is_bigendian\n\
uint8[] events\n\
================================================================================\n\
MSG: std_msgs/Header\n\
uint32 seq\n\
time stamp\n\
string frame_id\n";

/// Hash that identifies the definition in ROS 1: the MD5 of its fields.
pub const MD5_ROS1: &str = "8a6101b351a64529ac77bd8b71074e52";

/// Returns the largest time of a stamp in microseconds; its seconds have 32 bits, signed in ROS 2 (the year 2038).
#[must_use]
pub const fn t_max_us(serialisation: Serialisation) -> u64 {
    let seconds = match serialisation {
        Serialisation::Ros1 => u32::MAX as u64,
        Serialisation::Cdr => i32::MAX as u64,
    };
    seconds * 1_000_000 + 999_999
}

/// A message of events.
#[derive(Debug, Default)]
pub struct Message {
    /// Time under which it is stored, in ns.
    pub time_ns: u64,
    /// Sequence number of the message.
    pub sequence: u64,
    /// The serialised message.
    pub bytes: Vec<u8>,
}

/// A file to which messages are written.
pub trait MessageFile {
    /// Writes the next message.
    ///
    /// # Errors
    /// The file cannot be written.
    fn message(&mut self, message: &Message) -> Result<()>;

    /// Writes the end of the file.
    ///
    /// # Errors
    /// The file cannot be written.
    fn finish(self) -> Result<()>;
}

/// A writer of events as messages of one topic.
pub struct PacketWriter<F> {
    packets: Packets,
    file: F,
}

impl<F: MessageFile> PacketWriter<F> {
    /// Packs events for `file`, whose beginning has been written.
    pub(super) const fn new(packets: Packets, file: F) -> Self {
        Self { packets, file }
    }
}

impl<F: MessageFile> EventWriter for PacketWriter<F> {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        let file = &mut self.file;
        self.packets.write(events, |message| file.message(message))
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        let file = &mut self.file;
        self.packets.finish(|message| file.message(message))?;
        self.file.finish()
    }
}

/// Packs events into messages.
pub struct Packets {
    name: String,
    sensor: Sensor,
    serialisation: Serialisation,
    words: Vec<u8>,
    /// Times of the message's first and latest event.
    first_us: u64,
    last_us: u64,
    /// Number of events packed so far.
    events: u64,
    message: Message,
}

impl Packets {
    /// Packs events for the file `name`.
    #[must_use]
    pub fn new(name: &str, sensor: Sensor, serialisation: Serialisation) -> Self {
        Self {
            name: name.to_owned(),
            sensor,
            serialisation,
            words: Vec::new(),
            first_us: 0,
            last_us: 0,
            events: 0,
            message: Message::default(),
        }
    }

    /// Packs events; `put` gets each message that they complete.
    ///
    /// # Errors
    /// An event lies outside the sensor or its time exceeds a stamp's; otherwise those of `put`.
    pub fn write(
        &mut self,
        events: &[Event],
        mut put: impl FnMut(&Message) -> Result<()>,
    ) -> Result<()> {
        let t_max_us = t_max_us(self.serialisation);
        for event in events {
            let Event { t_us, x, y, .. } = *event;
            check_inside(&self.name, self.events, event, self.sensor)?;
            ensure!(
                t_us <= t_max_us,
                CannotHold,
                "{}: event {}: time {t_us} us is above {t_max_us} us, the largest time of a stamp: \
                 write .aedat4",
                self.name,
                self.events
            );
            let full = self.words.len() >= PACKET_EVENTS * 8;
            let apart = t_us < self.last_us || t_us - self.first_us >= PACKET_US;
            if (full || apart) && !self.words.is_empty() {
                self.close(&mut put)?;
            }
            if self.words.is_empty() {
                self.first_us = t_us;
            }
            self.last_us = t_us;
            let on = u32::from(event.polarity == Polarity::On);
            let word = u32::from(x) << 17 | u32::from(y) << 2 | on << 1 | 1;
            // Below PACKET_US.
            let since_us = (t_us - self.first_us) as u32;
            self.words.extend_from_slice(&word.to_le_bytes());
            self.words.extend_from_slice(&since_us.to_le_bytes());
            self.events += 1;
        }
        Ok(())
    }

    /// Gives `put` the last message. If there were no events, it is empty, since only messages state the sensor's
    /// size.
    ///
    /// # Errors
    /// Those of `put`.
    pub fn finish(&mut self, mut put: impl FnMut(&Message) -> Result<()>) -> Result<()> {
        if self.words.is_empty() && self.message.sequence > 0 {
            return Ok(());
        }
        self.close(&mut put)
    }

    fn close(&mut self, put: &mut impl FnMut(&Message) -> Result<()>) -> Result<()> {
        let Message {
            time_ns, sequence, ..
        } = self.message;
        // Times have at most a stamp's seconds, so the product is below 2^63.
        let base_ns = self.first_us * 1000;
        let packet = Packet {
            sequence,
            stamp_us: self.first_us,
            sensor: self.sensor,
            base_ns,
            encoding: "libcaer",
            words: &self.words,
        };
        let bytes = std::mem::take(&mut self.message.bytes);
        self.message.bytes = packet.put(bytes, self.serialisation);
        self.message.time_ns = time_ns.max(base_ns);
        self.words.clear();
        put(&self.message)?;
        self.message.sequence += 1;
        Ok(())
    }
}

/// The fields of an `EventPacket`.
pub(super) struct Packet<'a> {
    /// Sequence number of the message.
    pub sequence: u64,
    /// Time of the header, at most that of a stamp.
    pub stamp_us: u64,
    pub sensor: Sensor,
    pub base_ns: u64,
    pub encoding: &'a str,
    /// The packed events.
    pub words: &'a [u8],
}

impl Packet<'_> {
    /// Serialises the packet into `bytes`, replacing its content.
    pub fn put(&self, bytes: Vec<u8>, serialisation: Serialisation) -> Vec<u8> {
        let mut fields = Put::new(bytes, serialisation);
        if serialisation == Serialisation::Ros1 {
            // ROS 1's own sequence number has 32 bits and wraps.
            fields.u32(self.sequence as u32);
        }
        fields.u32((self.stamp_us / 1_000_000) as u32);
        fields.u32((self.stamp_us % 1_000_000 * 1000) as u32);
        fields.string(FRAME_ID);
        fields.u32(self.sensor.height.into());
        fields.u32(self.sensor.width.into());
        fields.u64(self.sequence);
        fields.u64(self.base_ns);
        fields.string(self.encoding);
        fields.bytes.push(0);
        fields.sequence(self.words);
        fields.bytes
    }
}

/// Appends fields of a message, the counterpart of [`super::fields::Fields`].
struct Put {
    bytes: Vec<u8>,
    serialisation: Serialisation,
}

impl Put {
    /// Begins a message in `bytes`, replacing its content.
    fn new(mut bytes: Vec<u8>, serialisation: Serialisation) -> Self {
        bytes.clear();
        if serialisation == Serialisation::Cdr {
            // CDR version 1, little-endian.
            bytes.extend_from_slice(&[0, 1, 0, 0]);
        }
        Self {
            bytes,
            serialisation,
        }
    }

    /// Pads to a multiple of `to`; CDR counts alignment from the end of its first four bytes.
    fn align(&mut self, to: usize) {
        if self.serialisation == Serialisation::Cdr {
            let length = self.bytes.len() - 4;
            self.bytes.resize(4 + length.next_multiple_of(to), 0);
        }
    }

    fn u32(&mut self, value: u32) {
        self.align(4);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    fn u64(&mut self, value: u64) {
        self.align(8);
        self.bytes.extend_from_slice(&value.to_le_bytes());
    }

    /// Appends a sequence, whose length must be below 2^32.
    fn sequence(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.bytes.extend_from_slice(bytes);
    }

    fn string(&mut self, text: &str) {
        let end = usize::from(self.serialisation == Serialisation::Cdr);
        self.u32((text.len() + end) as u32);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.resize(self.bytes.len() + end, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::message::{Content, Encoding, Head, Kind};

    const SENSOR: Sensor = Sensor {
        width: 640,
        height: 480,
    };

    fn at(t_us: u64) -> Event {
        Event {
            t_us,
            x: 639,
            y: 479,
            polarity: Polarity::On,
        }
    }

    /// Returns the stored time, `time_base` and number of events of each message.
    fn messages(serialisation: Serialisation, events: &[Event]) -> Vec<(u64, u64, usize)> {
        let mut packets = Packets::new("test", SENSOR, serialisation);
        let mut messages = Vec::new();
        let mut put = |message: &Message| {
            assert!(message.bytes.len() < 100_000);
            assert_eq!(message.sequence, messages.len() as u64);
            let head = Head::read(&message.bytes, Kind::EventPacket, serialisation).unwrap();
            assert_eq!((head.width, head.height), (640, 480));
            let Content::Packed {
                encoding: Encoding::Libcaer,
                base_ns,
                at,
                end,
            } = head.content
            else {
                panic!("another encoding");
            };
            assert_eq!(end, message.bytes.len());
            messages.push((message.time_ns, base_ns, (end - at) / 8));
            Ok(())
        };
        packets.write(events, &mut put).unwrap();
        packets.finish(&mut put).unwrap();
        packets.finish(&mut put).unwrap();
        messages
    }

    #[test]
    fn a_message_ends_at_a_step_back_at_its_length_and_at_its_time() {
        for serialisation in [Serialisation::Ros1, Serialisation::Cdr] {
            let back = [at(70), at(80), at(79), at(79), at(20_000), at(30_000)];
            let want = [
                (70_000, 70_000, 2),
                (79_000, 79_000, 2),
                (20_000_000, 20_000_000, 1),
                (30_000_000, 30_000_000, 1),
            ];
            assert_eq!(messages(serialisation, &back), want);
            // Stored under the largest stamp so far.
            let back = [at(7), at(3), at(9)];
            let want = [(7000, 7000, 1), (7000, 3000, 2)];
            assert_eq!(messages(serialisation, &back), want);
            let many = messages(serialisation, &vec![at(5); 2 * PACKET_EVENTS + 1]);
            let lengths: Vec<usize> = many.iter().map(|message| message.2).collect();
            assert_eq!(lengths, [PACKET_EVENTS, PACKET_EVENTS, 1]);
            // A reader still learns the sensor's size.
            assert_eq!(messages(serialisation, &[]), [(0, 0, 0)]);
        }
    }

    #[test]
    fn a_time_beyond_the_stamps_is_refused() {
        for serialisation in [Serialisation::Ros1, Serialisation::Cdr] {
            let t_max_us = t_max_us(serialisation);
            assert_eq!(messages(serialisation, &[at(t_max_us)]).len(), 1);
            let mut packets = Packets::new("test", SENSOR, serialisation);
            let refused = packets.write(&[at(1), at(t_max_us + 1)], |_| Ok(()));
            let refused = refused.unwrap_err().to_string();
            assert!(refused.contains("test: event 1: time"), "{refused}");
        }
    }
}
