//! The part of a sensor shown in small pictures: all of a small sensor, the densest part of a large one.

use std::fmt;

use eecvs_nostd::{Event, Sensor};

/// The largest sensor that is shown whole: four panels of this size fit beside each other.
const WHOLE_MAX: Sensor = Sensor {
    width: 346,
    height: 260,
};
/// Size of the part shown of a larger sensor: enlarged twice, four of them fill a page.
const CUT: Sensor = Sensor {
    width: 200,
    height: 150,
};

/// A rectangle of a sensor's pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Leftmost column.
    pub x: u16,
    /// Uppermost row.
    pub y: u16,
    /// Columns and rows of the part.
    pub size: Sensor,
    of: Sensor,
}

impl Part {
    /// Returns the part to show: all of a sensor of at most 346 x 260 pixels. Of a larger one, the 200 x 150 pixels
    /// (limited to its own sides) that hold most of `events`; of equals the uppermost, then the leftmost.
    #[must_use]
    pub fn densest(sensor: Sensor, events: &[Event]) -> Self {
        let is_small = sensor.width <= WHOLE_MAX.width && sensor.height <= WHOLE_MAX.height;
        let size = if is_small {
            sensor
        } else {
            Sensor {
                width: sensor.width.min(CUT.width),
                height: sensor.height.min(CUT.height),
            }
        };
        let (x, y) = densest(sensor, size, events);
        Self {
            x,
            y,
            size,
            of: sensor,
        }
    }

    /// Returns the events inside, with coordinates relative to the part.
    #[must_use]
    pub fn cut(&self, events: &[Event]) -> Vec<Event> {
        let inside = |event: &Event| {
            let (x, y) = (event.x.checked_sub(self.x)?, event.y.checked_sub(self.y)?);
            let moved = Event { x, y, ..*event };
            self.size.contains(x, y).then_some(moved)
        };
        events.iter().filter_map(inside).collect()
    }

    /// Returns whether the part is smaller than the sensor.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.size != self.of
    }
}

impl fmt::Display for Part {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { x, y, size, of } = self;
        if !self.is_cut() {
            return write!(formatter, "all {} x {} pixels", of.width, of.height);
        }
        write!(
            formatter,
            "the {} x {} pixels from ({x}, {y}) on, of {} x {}",
            size.width, size.height, of.width, of.height
        )
    }
}

/// Returns the upper left corner of the rectangle of `size` with the most events.
fn densest(sensor: Sensor, size: Sensor, events: &[Event]) -> (u16, u16) {
    let [width, height, part_width, part_height] =
        [sensor.width, sensor.height, size.width, size.height].map(usize::from);
    // Summed-area table: entry (x, y) counts the events above y and left of x. A row and a column of zeros avoid
    // special cases at the borders.
    let pitch = width + 1;
    let mut sums = vec![0_u64; pitch * (height + 1)];
    for event in events
        .iter()
        .filter(|event| sensor.contains(event.x, event.y))
    {
        let at = (usize::from(event.y) + 1) * pitch + usize::from(event.x) + 1;
        if let Some(sum) = sums.get_mut(at) {
            *sum += 1;
        }
    }
    for at in pitch..sums.len() {
        let before = |back: usize| {
            let at = at.checked_sub(back)?;
            sums.get(at).copied()
        };
        // The first entry of a row is 0 and stays so.
        let (left, above, corner) = if at.is_multiple_of(pitch) {
            (0, 0, 0)
        } else {
            (
                before(1).unwrap_or(0),
                before(pitch).unwrap_or(0),
                before(pitch + 1).unwrap_or(0),
            )
        };
        if let Some(sum) = sums.get_mut(at) {
            *sum += left + above - corner;
        }
    }
    let at = |x: usize, y: usize| sums.get(y * pitch + x).copied().unwrap_or(0);
    let count = |x: usize, y: usize| {
        let (right, below) = (x + part_width, y + part_height);
        at(right, below) + at(x, y) - at(right, y) - at(x, below)
    };
    let mut best = (0, 0);
    let mut most = count(0, 0);
    for y in 0..=height.saturating_sub(part_height) {
        for x in 0..=width.saturating_sub(part_width) {
            if count(x, y) > most {
                (best, most) = ((x, y), count(x, y));
            }
        }
    }
    // Both are inside of the sensor, whose sides are u16.
    (best.0 as u16, best.1 as u16)
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    fn sensor(width: u16, height: u16) -> Sensor {
        Sensor::new(width, height).unwrap()
    }

    #[test]
    fn a_small_sensor_is_whole_and_a_large_one_cut() {
        for (width, height, cut_width, cut_height) in [
            (1, 1, 1, 1),
            (346, 260, 346, 260),
            (347, 260, 200, 150),
            (346, 261, 200, 150),
            (640, 480, 200, 150),
            (2048, 3, 200, 3),
            (2, 2048, 2, 150),
        ] {
            let part = Part::densest(sensor(width, height), &[]);
            assert_eq!(part.size, sensor(cut_width, cut_height), "{width}");
            assert_eq!((part.x, part.y), (0, 0));
            assert_eq!(part.is_cut(), part.size != sensor(width, height));
        }
    }

    #[test]
    fn the_part_is_where_most_events_are() {
        // One event in a corner, three far from it that just fit into one part, and many outside of the sensor.
        let mut events = vec![event(0, 0, 0, true)];
        events.extend([(400, 300), (599, 449), (450, 310)].map(|(x, y)| event(1, x, y, false)));
        events.extend(vec![event(2, 640, 480, true); 100]);
        let part = Part::densest(sensor(640, 480), &events);
        assert_eq!((part.x, part.y), (400, 300));
        assert_eq!(
            part.cut(&events),
            [
                event(1, 0, 0, false),
                event(1, 199, 149, false),
                event(1, 50, 10, false)
            ]
        );
        assert_eq!(
            part.to_string(),
            "the 200 x 150 pixels from (400, 300) on, of 640 x 480"
        );
        let whole = Part::densest(sensor(240, 180), &[event(0, 239, 179, true)]);
        assert_eq!(whole.to_string(), "all 240 x 180 pixels");
        assert_eq!(whole.cut(&events), [event(0, 0, 0, true)]);
    }

    /// Compares with a count over every position.
    #[test]
    fn no_other_part_holds_more() {
        let sensor = sensor(400, 270);
        let mut state = 7_u32;
        let mut next = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        for count in [1, 5, 60] {
            let events: Vec<Event> = (0..count)
                .map(|_| event(0, next(400) as u16, next(270) as u16, true))
                .collect();
            let part = Part::densest(sensor, &events);
            let held = part.cut(&events).len();
            for y in 0..=120 {
                for x in 0..=200 {
                    let other = Part { x, y, ..part };
                    let is_first = (other.y, other.x) >= (part.y, part.x);
                    let most = if is_first { held } else { held - 1 };
                    assert!(other.cut(&events).len() <= most, "{count}: {x}, {y}");
                }
            }
        }
    }
}
