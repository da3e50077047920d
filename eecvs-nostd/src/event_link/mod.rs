//! Events on their way to an encoder: the packets that a host or a camera sends to the MCU, and
//! the status that it answers with.
//!
//! | file | what |
//! |---|---|
//! | `packet.rs` | one packet |
//! | `receiver.rs` | packets in received bytes |
//! | `hot.rs` | pixels that are never sent |
//! | `setup.rs` | what an encoder is set to |
//! | `status.rs` | what it says of itself |
//!
//! docs/wire-format.md, "Event link", has the layout. Every packet says how many events were sent
//! before it, so the receiver knows exactly how many a lost packet held.

mod hot;
mod packet;
mod receiver;
mod setup;
mod status;

pub use hot::HotNumbers;
pub use packet::{BODY_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, SYNC, TooLong};
pub use receiver::Receiver;
pub use setup::Setup;
pub use status::{Refusal, Status};

use serde::{Deserialize, Serialize};

/// Longest body of a setup and of a status.
pub const FIELDS_BYTES_MAX: usize = 112;

fn write_body(fields: &impl Serialize, out: &mut [u8]) -> Result<usize, TooLong> {
    postcard::to_slice(fields, out)
        .map(|bytes| bytes.len())
        .map_err(|_| TooLong)
}

/// `None` where bytes are left, too: another layout.
fn parse_body<'b, T: Deserialize<'b>>(body: &'b [u8]) -> Option<T> {
    let (fields, rest) = postcard::take_from_bytes(body).ok()?;
    rest.is_empty().then_some(fields)
}
