//! Link on which events reach an encoder: the packets that a host or a camera sends to the microcontroller, and the
//! status with which that answers.
//!
//! | file | content |
//! |---|---|
//! | `packet.rs` | one packet |
//! | `receiver.rs` | finds packets in received bytes |
//! | `hot.rs` | pixels that are never sent |
//! | `setup.rs` | configuration of an encoder |
//! | `status.rs` | state of an encoder |
//!
//! docs/wire-format.md, "Event link", has the layout. Every packet says how many events were sent before it, so the
//! receiver knows exactly how many events a lost packet held.

mod hot;
mod packet;
mod receiver;
mod setup;
mod status;

pub use hot::HotNumbers;
pub use packet::{BODY_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, SYNC, TooLong};
pub use receiver::Receiver;
pub use setup::Setup;
pub use status::{Cause, Refusal, Restart, Status};

use serde::{Deserialize, Serialize};

/// Size in bytes of the longest body of a setup or a status.
pub const FIELDS_BYTES_MAX: usize = 112;

fn write_body(fields: &impl Serialize, out: &mut [u8]) -> Result<usize, TooLong> {
    postcard::to_slice(fields, out)
        .map(|bytes| bytes.len())
        .map_err(|_| TooLong)
}

/// Parses a whole body; also `None` if bytes are left, as then it has another layout.
fn parse_body<'b, T: Deserialize<'b>>(body: &'b [u8]) -> Option<T> {
    let (fields, rest) = postcard::take_from_bytes(body).ok()?;
    rest.is_empty().then_some(fields)
}
