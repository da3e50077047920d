//! The packet table of AEDAT 4, which is used for seeking.
//!
//! `FTAB` is a vector of tables, one for each packet in the file, with these fields: i64 position of the packet's
//! content (after its 8-byte header); the header itself (i32 stream, i32 size); i64 number of elements; i64 first
//! and i64 last time in us. For packets without times, the times are -1 or absent.
//!
//! The table only saves time: if it is damaged or does not agree with the packets, it is not used.

use crate::flatbuffer::{Buffer, Table};

/// A packet of the stream that is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Entry {
    /// Offset of the packet's header in the file.
    pub header_at: u64,
    /// Size of the packet's content in bytes.
    pub size: i32,
    /// Number of the packet's events.
    pub events: u64,
    /// Time of the packet's last event.
    pub last_us: u64,
}

/// The packets of one stream, in file order.
#[derive(Debug, Default)]
pub(crate) struct PacketTable(Vec<Entry>);

impl PacketTable {
    /// Parses `bytes`, a whole `FTAB` buffer, and keeps the packets of `stream`; `None` if the buffer is damaged.
    pub fn parse(bytes: &[u8], stream: i32) -> Option<Self> {
        let (buffer, root) = Buffer::root(bytes, b"FTAB")?;
        let vector = buffer.vector(root, 0)?;
        let mut entries = Vec::new();
        for index in 0..vector.len {
            // Every element takes 4 bytes of the buffer, so this returns if the count is larger than the buffer.
            let table = buffer.element(vector, index)?;
            if let Some(entry) = entry(buffer, table, stream)? {
                entries.push(entry);
            }
        }
        entries.sort_by_key(|entry: &Entry| entry.header_at);
        Some(Self(entries))
    }

    /// Returns the first packet whose last time is at or after `t_us`, so that no packet before it has such
    /// events, and the number of events before it; no packet if all events are earlier.
    pub fn place(&self, t_us: u64) -> (Option<Entry>, u64) {
        let Self(entries) = self;
        let found = entries.iter().position(|entry| entry.last_us >= t_us);
        let before = entries.iter().take(found.unwrap_or(entries.len()));
        let events = before.fold(0_u64, |sum, entry| sum.saturating_add(entry.events));
        (found.and_then(|at| entries.get(at).copied()), events)
    }
}

/// Returns an entry if it is of `stream` and has times; the outer `None` means that it is damaged.
fn entry(buffer: Buffer<'_>, table: Table, stream: i32) -> Option<Option<Entry>> {
    let content_at = u64::try_from(buffer.i64(table, 0, 0)?).ok()?;
    let header = buffer.inline(table, 1)?;
    let id = i32::from_le_bytes(buffer.bytes(header)?);
    let size = i32::from_le_bytes(buffer.bytes(header.checked_add(4)?)?);
    let events = u64::try_from(buffer.i64(table, 2, 0)?).ok()?;
    let last_us = u64::try_from(buffer.i64(table, 4, -1)?);
    let header_at = content_at.checked_sub(8)?;
    Some(match last_us {
        Ok(last_us) if id == stream => Some(Entry {
            header_at,
            size,
            events,
            last_us,
        }),
        _ => None,
    })
}
