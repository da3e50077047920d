//! Vectors of 32 columns, as EVT 3 and EVT 4 have them: which events one can hold.

use event_types::Event;

/// Columns of a vector.
const VECTOR_COLUMNS: u16 = 32;

/// A run of events that one vector can hold.
#[derive(Debug, PartialEq, Eq)]
pub struct Run {
    /// Number of events.
    pub count: usize,
    /// First column of the vector.
    pub x: u16,
    /// Bit i is set if there is an event at column x + i.
    pub columns: u32,
}

impl Run {
    /// Returns the run at the start of `events`, in their order: the same time, row and polarity, with x rising
    /// within 32 columns that all lie on a sensor of `width` columns. It has at least one event, if there are any.
    pub fn of(events: &[Event], width: u16) -> Self {
        let (mut count, mut columns) = (0, 0_u32);
        let group = |event: &Event| (event.t_us, event.y, event.polarity);
        let first = events.first();
        // A narrower sensor has no room for a vector: its events are written one by one.
        let last_x = width.checked_sub(VECTOR_COLUMNS);
        let Some((first, x)) = first.map(|first| (first, first.x.min(last_x.unwrap_or(first.x))))
        else {
            return Self {
                count,
                x: 0,
                columns,
            };
        };
        for event in events {
            let column = event.x.checked_sub(x).map_or(u32::MAX, u32::from);
            // Stop at a column that is not above all columns so far.
            let is_next = columns.checked_shr(column) == Some(0);
            if group(event) != group(first) || !is_next || (count > 0 && last_x.is_none()) {
                break;
            }
            columns |= 1 << column;
            count += 1;
        }
        // An event outside the sensor fits no run; it is taken alone and refused later.
        count = count.max(1);
        Self { count, x, columns }
    }
}
