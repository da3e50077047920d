//! Stream files, `.stream`: a device's stream byte for byte, with times of arrival and losses.
//!
//! All numbers are little-endian; times are in nanoseconds after the header's time zero.
//!
//! ```text
//! header   8  "EECVSTRM"
//!          2  version, 1
//!          2  length of the whole header in bytes
//!          2  width and 2 height of the sensor, in pixels
//!          8  time zero, in nanoseconds since 1970
//!          6 strings, each 2 bytes of length and UTF-8: model, name, serial number (empty: none),
//!             firmware, stream, program that wrote the file
//!          4  CRC-32 of the header before it
//! record   4  "DATA", "LOSS", "INDX" or "TAIL"
//!          4  length of the payload in bytes
//!          8  time; in TAIL: offset of INDX in the file
//!          4  LOSS: cause (1 overflow, 2 damaged, 3 stalled, 4 injected); otherwise 0
//!          4  CRC-32 of the record before it, without the payload
//!             payload: DATA: bytes of the stream, at most 16 MiB, without a checksum
//!                      LOSS: 8 bytes, number of lost bytes, 2^64 - 1 if it is unknown
//!                      INDX: entries of 24 bytes: time, offset of a DATA record, bytes of the stream
//!                            before it; one for each MiB of the stream
//!                      TAIL: none
//! ```
//!
//! A file consists of a header, records in order of time, one INDX and one TAIL. A file that is cut off anywhere is
//! read up to the cut, without an index. A damaged record is skipped up to the next whole one, and reported as a
//! loss.

mod reader;
mod writer;

use std::io;

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use eecvs_nostd::Sensor;
use thiserror::Error;

use super::Loss;
use crate::device::Info;

pub use reader::{RawReader, Record};
pub use writer::RawWriter;

const MAGIC: [u8; 8] = *b"EECVSTRM";
const VERSION: u16 = 1;
const FIXED: usize = 24;
const RECORD: usize = 24;
/// Largest payload of a DATA record.
const DATA_MAX: usize = 16 << 20;
/// Bytes of the stream per index entry.
const INDEX_STEP: u64 = 1 << 20;
const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// A file that is not a stream file, or cannot be read.
#[derive(Debug, Error)]
pub enum RawFileError {
    /// The file cannot be read or written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file does not begin with the magic bytes of a stream file.
    #[error("byte 0: this is not a stream file: it does not begin with EECVSTRM")]
    Magic,
    /// The file was written in another version of the format.
    #[error("byte 8: the stream file has version {0}; this program reads version {VERSION}")]
    Version(u16),
    /// The header is cut off or damaged.
    #[error("byte {0}: the header is damaged, so the device that sent the stream is unknown")]
    Header(u64),
}

/// Header of a stream file: what the stream was captured from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Model, as named on the command line.
    pub model: String,
    /// Name that the device reported.
    pub name: String,
    /// Serial number, if the device has one.
    pub serial: Option<String>,
    /// Version of firmware and logic, as the device reported it.
    pub firmware: String,
    /// Name of the stream, as in [`Info::stream`].
    pub stream: String,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// Time zero, in nanoseconds since 1970.
    pub started_ns: u64,
    /// Program that wrote the file.
    pub program: String,
}

impl Header {
    /// Creates the header of a capture that starts `started_ns` nanoseconds after 1970.
    #[must_use]
    pub fn new(model: &str, info: &Info, started_ns: u64) -> Self {
        Self {
            model: model.to_owned(),
            name: info.name.clone(),
            serial: info.serial.clone(),
            firmware: info.firmware.clone(),
            stream: info.stream.to_owned(),
            sensor: info.sensor,
            started_ns,
            program: concat!("eecvs-usb ", env!("CARGO_PKG_VERSION")).to_owned(),
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend([0; 2]);
        bytes.extend(self.sensor.width.to_le_bytes());
        bytes.extend(self.sensor.height.to_le_bytes());
        bytes.extend(self.started_ns.to_le_bytes());
        let serial = self.serial.clone().unwrap_or_default();
        let strings = [
            &self.model,
            &self.name,
            &serial,
            &self.firmware,
            &self.stream,
            &self.program,
        ];
        for string in strings {
            // More than any device reports: a string descriptor has at most 126 characters.
            let mut length = string.len().min(1000);
            while !string.is_char_boundary(length) {
                length -= 1;
            }
            bytes.extend((length as u16).to_le_bytes());
            bytes.extend(&string.as_bytes()[..length]);
        }
        let length = (bytes.len() + 4) as u16;
        bytes[10..12].copy_from_slice(&length.to_le_bytes());
        bytes.extend(CRC.checksum(&bytes).to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (body, crc) = bytes.split_last_chunk::<4>()?;
        if CRC.checksum(body) != u32::from_le_bytes(*crc) {
            return None;
        }
        let mut strings = Vec::new();
        let mut rest = body.get(FIXED..)?;
        for _ in 0..6 {
            let (length, after) = rest.split_first_chunk::<2>()?;
            let (string, after) = after.split_at_checked(u16::from_le_bytes(*length).into())?;
            strings.push(String::from_utf8(string.to_vec()).ok()?);
            rest = after;
        }
        let [model, name, serial, firmware, stream, program] = strings.try_into().ok()?;
        Some(Self {
            model,
            name,
            serial: Some(serial).filter(|serial| !serial.is_empty()),
            firmware,
            stream,
            program,
            sensor: Sensor {
                width: u16::from_le_bytes(body.get(12..14)?.try_into().ok()?),
                height: u16::from_le_bytes(body.get(14..16)?.try_into().ok()?),
            },
            started_ns: u64::from_le_bytes(body.get(16..24)?.try_into().ok()?),
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mark {
    Data,
    Loss,
    Index,
    Tail,
}

/// The fixed part of a record.
#[derive(Debug, Clone, Copy)]
struct Fixed {
    mark: Mark,
    length: u32,
    time: u64,
    detail: u32,
}

impl Fixed {
    fn to_bytes(self) -> [u8; RECORD] {
        let mark = match self.mark {
            Mark::Data => *b"DATA",
            Mark::Loss => *b"LOSS",
            Mark::Index => *b"INDX",
            Mark::Tail => *b"TAIL",
        };
        let mut bytes = [0; RECORD];
        bytes[..4].copy_from_slice(&mark);
        bytes[4..8].copy_from_slice(&self.length.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.time.to_le_bytes());
        bytes[16..20].copy_from_slice(&self.detail.to_le_bytes());
        let crc = CRC.checksum(&bytes[..20]);
        bytes[20..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mark = match bytes.get(..4)? {
            b"DATA" => Mark::Data,
            b"LOSS" => Mark::Loss,
            b"INDX" => Mark::Index,
            b"TAIL" => Mark::Tail,
            _ => return None,
        };
        let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
        if word(20)? != CRC.checksum(bytes.get(..20)?) {
            return None;
        }
        Some(Self {
            mark,
            length: word(4)?,
            time: u64::from_le_bytes(bytes.get(8..16)?.try_into().ok()?),
            detail: word(16)?,
        })
    }
}

const CAUSES: [(Loss, u32); 4] = [
    (Loss::Overflow, 1),
    (Loss::Damaged, 2),
    (Loss::Stalled, 3),
    (Loss::Injected, 4),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Entry {
    time: u64,
    offset: u64,
    stream: u64,
}

#[cfg(test)]
pub(crate) mod tests;
