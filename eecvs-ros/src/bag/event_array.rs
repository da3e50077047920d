//! Turns messages with a structure for each event into packets of events.
//!
//! `dvs_msgs/msg/EventArray` and `prophesee_event_msgs/msg/EventArray` have the fields header, uint32 height, uint32
//! width and `Event[]` of uint16 x, uint16 y, time ts and bool polarity. They become messages of
//! `event_camera_msgs/msg/EventPacket` in the encoding `mono`, which keeps columns, rows below 2^15, and times in
//! nanoseconds.

use anyhow::{Result, anyhow, ensure};
use event_files::ros::fields::{Fields, Serialisation};

use crate::message::{DATA_BYTES, EventPacket, Header, Time};

/// Bytes of an event in the encoding `mono`.
const EVENT_BYTES: usize = 8;

/// Longest packet, in bytes of events: larger messages are more likely to be lost.
const PACKET_BYTES: usize = DATA_BYTES as usize;

/// Makes packets from the messages of one topic.
#[derive(Debug, Default)]
pub struct Packets {
    /// Number of the next packet.
    seq: u64,
}

impl Packets {
    /// Turns a message into packets, at least one, with consecutive sequence numbers.
    ///
    /// # Errors
    /// The message is damaged, or has a row that the encoding cannot hold; the error names the byte.
    pub fn convert(&mut self, cdr: &[u8]) -> Result<Vec<EventPacket>> {
        let damaged = |at: usize, what: String| anyhow!("byte {at} of a message: {what}");
        let mut fields = Fields::new(cdr, Serialisation::Cdr).map_err(|what| damaged(0, what))?;
        let head = head(&mut fields).map_err(|what| damaged(fields.cursor.at, what))?;
        let (header, height, width, count) = head;
        let begin = |seq: u64, time_base: u64| EventPacket {
            header: header.clone(),
            height,
            width,
            seq,
            time_base,
            encoding: "mono".to_owned(),
            ..EventPacket::default()
        };
        let mut packets: Vec<EventPacket> = Vec::new();
        for _ in 0..count {
            let at = fields.cursor.at;
            let event = event(&mut fields).map_err(|what| damaged(at, what))?;
            let (x, y, t_ns, is_on) = event;
            ensure!(
                y < 1 << 15,
                "byte {at} of a message: row {y} is beyond 32767"
            );
            let since_ns = packets.last().and_then(|packet| {
                let since_ns = t_ns.checked_sub(packet.time_base)?;
                let since_ns = u32::try_from(since_ns).ok()?;
                (packet.events.len() + EVENT_BYTES <= PACKET_BYTES).then_some(since_ns)
            });
            let since_ns = since_ns.unwrap_or_else(|| {
                packets.push(begin(self.seq + packets.len() as u64, t_ns));
                0
            });
            let data = u32::from(x) | u32::from(y) << 16 | u32::from(is_on) << 31;
            if let Some(packet) = packets.last_mut() {
                packet.events.extend_from_slice(&since_ns.to_le_bytes());
                packet.events.extend_from_slice(&data.to_le_bytes());
            }
        }
        let behind = fields.left();
        if count > 0 && behind > 3 {
            // CDR pads a message to 4 bytes.
            let what = format!("{behind} bytes follow the events: the message has another layout");
            return Err(damaged(fields.cursor.at, what));
        }
        if packets.is_empty() {
            packets.push(begin(self.seq, 0));
        }
        self.seq += packets.len() as u64;
        Ok(packets)
    }
}

/// Reads header, height, width and number of events.
fn head(fields: &mut Fields<'_>) -> Result<(Header, u32, u32, u32), String> {
    let stamp = Time {
        // Signed in ROS 2.
        sec: fields.u32()?.cast_signed(),
        nanosec: fields.u32()?,
    };
    let frame_id = fields.string()?.to_owned();
    let header = Header { stamp, frame_id };
    Ok((header, fields.u32()?, fields.u32()?, fields.u32()?))
}

/// Reads an event: column, row, time in nanoseconds, and whether it is ON.
fn event(fields: &mut Fields<'_>) -> Result<(u16, u16, u64, bool), String> {
    let (x, y) = (fields.u16()?, fields.u16()?);
    Ok((x, y, fields.time_ns()?, fields.u8()? != 0))
}

#[cfg(test)]
mod tests {
    use event_files::input::Batch;
    use event_files::ros::message::{Head, Kind};
    use event_files::ros::message_events::MessageEvents;
    use serde::Serialize;

    use super::*;
    use crate::message::{ENCAPSULATION, to_cdr};

    #[derive(Serialize)]
    struct Array {
        header: Header,
        height: u32,
        width: u32,
        events: Vec<Single>,
    }

    #[derive(Clone, Serialize)]
    struct Single {
        x: u16,
        y: u16,
        ts: Time,
        polarity: bool,
    }

    fn array(events: &[Single]) -> Vec<u8> {
        let array = Array {
            header: Header {
                stamp: Time::from_ns(7),
                frame_id: "left".to_owned(),
            },
            height: 480,
            width: 640,
            events: events.to_vec(),
        };
        let mut cdr = ENCAPSULATION.to_vec();
        cdr_encoding::to_writer::<_, byteorder::LittleEndian, _>(&mut cdr, &array).unwrap();
        cdr
    }

    /// The events of a message, as our reader of bags has them.
    fn events(cdr: Vec<u8>, kind: Kind) -> Vec<eecvs_nostd::Event> {
        let head = Head::read(&cdr, kind, Serialisation::Cdr).unwrap();
        let sensor = eecvs_nostd::Sensor::new(head.width as u16, head.height as u16).unwrap();
        let mut decoder = MessageEvents::new(sensor);
        decoder.take(cdr, head.content);
        let mut events = Vec::new();
        while !decoder.read(&mut Batch::new(&mut events)).unwrap() {}
        events
    }

    #[test]
    fn every_event_is_kept() {
        // More than a packet, with a step back and a pause of more than 32 bits of nanoseconds.
        let single = |i: u64| Single {
            x: (i % 640) as u16,
            y: (i * 7 % 480) as u16,
            ts: Time::from_ns(match i {
                5000.. => 9_000_000_000 + i as i64 * 1001,
                700.. => i as i64 * 1001,
                _ => 5_000_000 + i as i64 * 1001,
            }),
            polarity: i.is_multiple_of(3),
        };
        let all: Vec<Single> = (0..30_000).map(single).collect();
        let (first, second) = all.split_at(20_000);
        let (mut packets, mut put) = (Packets::default(), Vec::new());
        for part in [first, second, &[]] {
            put.extend(packets.convert(&array(part)).unwrap());
        }
        assert!(put.len() > 5);
        let mut got = Vec::new();
        for (number, packet) in put.iter().enumerate() {
            assert_eq!(packet.seq, number as u64);
            assert_eq!((packet.width, packet.height), (640, 480));
            assert_eq!(packet.header.frame_id, "left");
            assert!(packet.events.len() <= PACKET_BYTES);
            got.extend(events(to_cdr(packet), Kind::EventPacket));
        }
        let want = [first, second].map(|part| events(array(part), Kind::EventArray));
        assert_eq!(got, want.concat());
        assert_eq!(got.len(), 30_000);
    }

    #[test]
    fn damage_is_an_error() {
        let cdr = array(&[Single {
            x: 1,
            y: 40_000,
            ts: Time::default(),
            polarity: true,
        }]);
        let convert = |cdr: &[u8]| {
            let converted = Packets::default().convert(cdr);
            converted.unwrap_err().to_string()
        };
        assert!(convert(&cdr).contains("row 40000"));
        for length in [0, 3, 20, cdr.len() - 1] {
            assert!(convert(&cdr[..length]).contains("byte"));
        }
    }
}
