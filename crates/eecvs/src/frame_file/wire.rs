//! Numbers of marks and short frames, written as the headers of frames have them: as varints.

use serde::{Deserialize, Serialize};

/// Size of the largest value: six numbers of 64 bits.
pub(super) const VALUE_BYTES_MAX: usize = 60;

/// Appends a value.
pub(super) fn put(out: &mut Vec<u8>, value: &impl Serialize) {
    let mut room = [0; VALUE_BYTES_MAX];
    // All values have room.
    if let Ok(bytes) = postcard::to_slice(value, &mut room) {
        out.extend_from_slice(bytes);
    }
}

/// Takes a value from the front of `rest`.
pub(super) fn take<'b, T: Deserialize<'b>>(rest: &mut &'b [u8]) -> Option<T> {
    let (value, after) = postcard::take_from_bytes(rest).ok()?;
    *rest = after;
    Some(value)
}
