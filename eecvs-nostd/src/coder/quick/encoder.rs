//! Codes the events of a window, block by block.

use crate::coder::quick::format::{Area, BLOCK, BLOCK_BYTES_MAX, Block, Output, Placed};
use crate::coder::quick::{Simd, Window};

/// An event is not on the sensor or not in the window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Outside;

/// What of a window was coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Coded {
    /// Bytes of the payload.
    pub bytes: usize,
    /// Events in it, from the front.
    pub events: usize,
}

/// Room in which one event has a payload of its own, whatever it is.
pub const EVENT_BYTES_MAX: usize = 21;
const _: () = assert!(fitting(EVENT_BYTES_MAX) == 1 && fitting(EVENT_BYTES_MAX - 1) == 0);

/// Returns how many events fit into a block of this many bytes, whatever they are: they take at most 55 bits each, a
/// code of 23 and a time of 32, or else a word of 31 and less than 3 bits of the upper parts.
const fn fitting(bytes: usize) -> usize {
    // Header, area, least time, and the last byte of each of two packed parts.
    bytes.saturating_sub(14) * 8 / 55
}

/// What a block depends on.
struct Encoder {
    window: Window,
    area: Area,
    block: Block,
}

impl Encoder {
    /// Codes a block's events, 1 to [`BLOCK`], at the front of `out`, and returns the number of bytes; `None` if there is
    /// no room for them.
    ///
    /// # Errors
    /// [`Outside`]; the area is unset then.
    #[inline]
    fn code(
        &mut self,
        simd: Simd,
        events: &[Placed],
        out: &mut [u8],
    ) -> Result<Option<usize>, Outside> {
        let (area, first) = (self.area, self.block.first);
        let bytes = if let Some(out) = out.first_chunk_mut() {
            Some(self.code_into(simd, events, out)?)
        } else {
            let mut room = [0; BLOCK_BYTES_MAX];
            let bytes = self.code_into(simd, events, &mut room)?;
            out.get_mut(..bytes).map(|out| {
                out.copy_from_slice(room.get(..bytes).unwrap_or_default());
                bytes
            })
        };
        if bytes.is_none() {
            (self.area, self.block.first) = (area, first);
        }
        Ok(bytes)
    }

    #[inline]
    fn code_into(
        &mut self,
        simd: Simd,
        events: &[Placed],
        out: &mut Output,
    ) -> Result<usize, Outside> {
        let bytes = simd.encode(events, &mut self.block, &mut self.area, &self.window, out);
        self.block.first = events.last().map_or(0, |[offset_us, _]| *offset_us);
        bytes.ok_or(Outside)
    }
}

/// Codes events of a window from the front, as far as there is room in `out`: at least one in [`EVENT_BYTES_MAX`]
/// bytes.
///
/// # Errors
/// [`Outside`].
pub fn encode(
    simd: Simd,
    window: Window,
    events: &[Placed],
    out: &mut [u8],
) -> Result<Coded, Outside> {
    let mut encoder = Encoder {
        window,
        area: Area::whole(window.sensor),
        block: Block::new(),
    };
    let mut coded = Coded::default();
    for block in events.chunks(BLOCK) {
        let out = out.get_mut(coded.bytes..).unwrap_or_default();
        if let Some(bytes) = encoder.code(simd, block, out)? {
            coded.bytes += bytes;
            coded.events += block.len();
            continue;
        }
        // A block that is not full is a payload's last one.
        let part = block.get(..fitting(out.len())).unwrap_or_default();
        if !part.is_empty()
            && let Some(bytes) = encoder.code(simd, part, out)?
        {
            coded.bytes += bytes;
            coded.events += part.len();
        }
        break;
    }
    Ok(coded)
}
