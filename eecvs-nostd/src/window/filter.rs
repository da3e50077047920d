//! Removes events that the user does not want sent: those outside a region, those of hot pixels, and isolated ones.
//!
//! The filter runs on a closed window. One pass thus serves every source of events, at a cost that grows with the
//! window's events. Removed events are counted.

use crate::window::hot_pixels::HotPixels;
use crate::window::{SEGMENT_PIXELS, Window};

/// A rectangle of pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Region {
    /// First column, from 0.
    pub x: u16,
    /// First row, from 0.
    pub y: u16,
    /// Number of columns.
    pub width: u16,
    /// Number of rows.
    pub height: u16,
}

impl Region {
    /// Returns whether a pixel lies in the region.
    const fn contains(self, x: u16, y: u16) -> bool {
        x.wrapping_sub(self.x) < self.width
            && x >= self.x
            && y.wrapping_sub(self.y) < self.height
            && y >= self.y
    }

    /// Returns the columns of a segment that lie in the region, bit i for column i. The segment's first pixel is
    /// (x, y).
    const fn columns(self, (x, y): (u16, u16)) -> u32 {
        if y < self.y || y as u32 >= self.y as u32 + self.height as u32 {
            return 0;
        }
        let from = (self.x as u32).saturating_sub(x as u32);
        let end = (self.x as u32 + self.width as u32).saturating_sub(x as u32);
        below(end) & !below(from)
    }
}

/// Returns a mask of all bits below `bit`.
const fn below(bit: u32) -> u32 {
    if bit >= u32::BITS {
        u32::MAX
    } else {
        (1 << bit) - 1
    }
}

/// What is removed from every window.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Filter {
    /// If set, only events inside this region are kept.
    pub region: Option<Region>,
    /// Whether to remove isolated events: those whose pixel has no other event in the window and whose eight
    /// neighbours have none. These are background activity if windows are short for the scene.
    pub isolated: bool,
}

impl Filter {
    /// The filter that keeps every event.
    pub const NONE: Self = Self {
        region: None,
        isolated: false,
    };

    /// Removes unwanted events, including those of `hot`, from a closed window; returns how many it removed.
    pub(crate) fn apply(self, hot: &HotPixels<'_>, window: &mut Window<'_>) -> u32 {
        if window.keeps_arrival() {
            return self.apply_in_order(hot, window);
        }
        let mut removed = hot.remove(window);
        if let Some(region) = self.region {
            let mut from = 0;
            while let Some(segment) = window.next_used(from) {
                let at = window.segment_origin(segment);
                removed += window.keep_columns(segment, region.columns(at));
                from = segment + 1;
            }
        }
        if self.isolated {
            removed += remove_isolated(window);
        }
        removed
    }

    /// As [`Self::apply`], for a window in the order of arrival, whose isolated events stay.
    fn apply_in_order(self, hot: &HotPixels<'_>, window: &mut Window<'_>) -> u32 {
        let width = window.config().sensor.width;
        if self.region.is_none() && hot.count() == 0 {
            return 0;
        }
        window.keep_in_order(|x, y| {
            self.region.is_none_or(|region| region.contains(x, y)) && !hot.contains((x, y), width)
        })
    }
}

/// Removes isolated events; returns how many.
///
/// A removed event was nobody's neighbour, so the order of removal does not matter.
pub(crate) fn remove_isolated(window: &mut Window<'_>) -> u32 {
    let sensor = window.config().sensor;
    let stride = u32::from(sensor.width.div_ceil(SEGMENT_PIXELS));
    let rows = u32::from(sensor.height);
    let (mut removed, mut from) = (0, 0);
    while let Some(segment) = window.next_used(from) {
        let (x, y) = window.segment_origin(segment);
        let (x, y) = (u32::from(x) / u32::from(SEGMENT_PIXELS), u32::from(y));
        // The columns with events of the segment in `row`, `east` - 1 segments to the east of this one.
        let occupied = |row: u32, east: u32| {
            let at = (x + east).wrapping_sub(1);
            if row < rows && at < stride {
                window.columns_of(row * stride + at).0
            } else {
                0
            }
        };
        let (here, crowded) = window.columns_of(segment);
        let mut near = crowded;
        for row in [y.wrapping_sub(1), y, y + 1] {
            let middle = if row == y { here } else { occupied(row, 1) };
            // A pixel is not its own neighbour.
            near |= if row == y { 0 } else { middle };
            near |= middle << 1 | middle >> 1;
            near |= occupied(row, 0) >> 31 | occupied(row, 2) << 31;
        }
        removed += window.keep_columns(segment, near);
        from = segment + 1;
    }
    removed
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::window::{Slot, WindowBuffers, WindowConfig, bitmap_words, segments};
    use event_types::{Event, Polarity, Sensor};

    fn event(x: u16, y: u16) -> Event {
        Event {
            t_us: 5,
            x,
            y,
            polarity: Polarity::On,
        }
    }

    /// Returns the events that the filter leaves in a window, and the number it removes.
    fn left(
        sensor: Sensor,
        events: &[(u16, u16)],
        filter: Filter,
        hot: &[(u16, u16)],
    ) -> (Vec<(u16, u16)>, u32) {
        let count = segments(sensor.width, sensor.height);
        let (mut slots, mut heads) = (vec![Slot::EMPTY; events.len().max(1)], vec![0; count]);
        let mut bitmap = vec![0; bitmap_words(count)];
        let buffers = WindowBuffers {
            slots: &mut slots,
            heads: &mut heads,
            bitmap: &mut bitmap,
        };
        let config = WindowConfig::new(sensor, 100);
        let mut window = Window::new(config, buffers).unwrap();
        for (x, y) in events {
            window.push(event(*x, *y));
        }
        window.flush();
        let mut memory = vec![0; hot.len()];
        let mut pixels = HotPixels::new(&mut memory);
        for pixel in hot {
            pixels.add(*pixel, sensor.width).unwrap();
        }
        let removed = filter.apply(&pixels, &mut window);
        assert_eq!(window.events() + removed, events.len() as u32);
        let mut group = crate::group::Group::new();
        let mut found = vec![];
        while let Some(pixel) = group.next(&mut window) {
            found.extend((0..pixel.on + pixel.off).map(|_| (pixel.y, pixel.x)));
        }
        let mut found: Vec<_> = found.into_iter().map(|(y, x)| (x, y)).collect();
        found.sort_unstable();
        (found, removed)
    }

    proptest! {
        /// The same events remain as in a filter that looks at each event by itself.
        #[test]
        fn what_is_kept_is_what_was_asked_for(
            (width, height, events) in (1_u16..150, 1_u16..40).prop_flat_map(|(width, height)| {
                let events = proptest::collection::vec((0..width, 0..height), 0..200);
                (Just(width), Just(height), events)
            }),
            region in proptest::option::of((0_u16..150, 0_u16..40, 0_u16..200, 0_u16..50)),
            isolated: bool,
            hot in proptest::collection::vec((0_u16..150, 0_u16..40), 0..60),
        ) {
            let sensor = Sensor::new(width, height).unwrap();
            let region = region.map(|(x, y, width, height)| Region { x, y, width, height });
            let hot: Vec<_> = hot.into_iter().map(|(x, y)| (x % width, y % height)).collect();
            let mut kept: Vec<_> = events.iter().copied().filter(|(x, y)| {
                let inside = region.is_none_or(|r| {
                    (r.x..r.x + r.width).contains(x) && (r.y..r.y + r.height).contains(y)
                });
                inside && !hot.contains(&(*x, *y))
            }).collect();
            if isolated {
                let all = kept.clone();
                kept.retain(|(x, y)| {
                    let near = |(a, b): &&(u16, u16)| a.abs_diff(*x) <= 1 && b.abs_diff(*y) <= 1;
                    all.iter().filter(near).count() > 1
                });
            }
            kept.sort_unstable();
            let (found, removed) = left(sensor, &events, Filter { region, isolated }, &hot);
            prop_assert_eq!(found, kept.clone());
            prop_assert_eq!(removed as usize, events.len() - kept.len());
        }
    }
}
