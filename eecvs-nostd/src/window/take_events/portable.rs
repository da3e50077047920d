//! One event at a time.

use crate::window::Slot;
use crate::window::take_events::Bounds;
use event_types::Event;

/// As [`super::take_in_order`].
#[inline]
pub fn take_in_order(
    bounds: Bounds,
    slots: &mut [Slot],
    events: &[Event],
    latest_us: &mut u32,
) -> usize {
    let Bounds {
        sensor,
        start_us,
        duration_us,
    } = bounds;
    let mut taken = 0;
    for (slot, event) in slots.iter_mut().zip(events) {
        let offset_us = event.t_us.wrapping_sub(start_us);
        let is_inside = event.t_us >= start_us && offset_us < u64::from(duration_us);
        if !is_inside || !sensor.contains(event.x, event.y) {
            break;
        }
        *slot = Slot::placed(*event, offset_us as u32);
        *latest_us = (*latest_us).max(offset_us as u32);
        taken += 1;
    }
    taken
}
