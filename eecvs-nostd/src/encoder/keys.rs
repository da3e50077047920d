//! Codes a window by the keys coder, in as many frames as it takes.

use crate::coder::Fidelity;
use crate::coder::keys::{self, EncoderMemory, Simd, sort_by_time};
use crate::frame::Header;
use crate::window::Window;

/// Codes the `left` last events of a window that keeps the order of arrival, in order of time, or as many as there is
/// room for. Returns the payload's bytes. `header` is that of the frame before, if this is not the first one.
#[inline(never)]
pub fn encode_keys(
    memory: &mut EncoderMemory,
    window: &mut Window<'_>,
    fidelity: Fidelity,
    header: &mut Header,
    left: &mut u32,
    payload: &mut [u8],
) -> usize {
    if header.part == 0 {
        sort_by_time(window.in_order_mut());
    }
    let done = header.window_events.saturating_sub(*left);
    let mut events = window.in_order().get(done as usize..).unwrap_or_default();
    if header.part > 0 {
        // As many as in the frame before will not fit by far, where many more are left.
        let most = (header.events + header.events / 8 + 16) as usize;
        events = events.get(..most).unwrap_or(events);
    }
    let of = keys::Window::new(header.sensor, header.t0_us, header.duration_us, fidelity);
    let coded = keys::encode(Simd::detected(), &of, events, memory, payload);
    debug_assert!(coded.is_ok(), "the window checked its events");
    match coded {
        Ok(coded) => {
            header.events = coded.events as u32;
            *left = left.saturating_sub(header.events);
            header.last = *left == 0;
            coded.bytes
        }
        Err(_) => {
            header.events = 0;
            header.dropped = header.dropped.saturating_add(*left);
            header.last = true;
            0
        }
    }
}
