//! Keeps the latest events of every pixel and polarity, which outlive their windows.

use eecvs_nostd::{Event, Polarity, Sensor};

use super::dense_array::{Active, Array, Window};

/// Times of the latest `depth` events of every pixel and polarity; only pixels that had events take memory.
#[derive(Debug, Clone)]
pub struct Recent {
    depth: usize,
    active: Active,
    /// Index of each pixel's queues, from 1; 0 before its first event.
    queues: Vec<u32>,
    /// The latest time first; the ON queue, then the OFF queue.
    times: Vec<Option<u64>>,
    /// Number of the previous window, and the pixels that had events in it.
    before: Option<(u64, Vec<u32>)>,
}

impl Recent {
    /// Starts without events.
    #[must_use]
    pub fn new(sensor: Sensor, depth: usize) -> Self {
        Self {
            depth,
            active: Active::new(sensor),
            queues: vec![0; sensor.pixels() as usize],
            times: Vec::new(),
            before: None,
        }
    }

    /// Returns the count of numbers per pixel: `depth` for ON, then `depth` for OFF.
    #[must_use]
    pub const fn channels(&self) -> usize {
        2 * self.depth
    }

    /// Adds a window's events and returns the array at the window's end.
    ///
    /// `number` maps the time of an event, or the lack of one, to a number. The array covers the pixels that have
    /// events in this window or the one right before it: no other pixel has an event that is young enough, even
    /// after rounding.
    pub fn array(
        &mut self,
        window: &Window<'_>,
        number: impl Fn(&Window<'_>, Option<u64>) -> f64,
    ) -> Array {
        for event in window.events {
            self.push(event);
        }
        let active = self.active.pixels(window.events);
        let mut pixels = active.clone();
        if let Some((number, before)) = self.before.replace((window.number, active))
            && number.checked_add(1) == Some(window.number)
        {
            pixels.extend(before);
            pixels.sort_unstable();
            pixels.dedup();
        }
        let mut values = Vec::with_capacity(pixels.len() * self.channels());
        for pixel in &pixels {
            let times = self.times_of(*pixel).iter();
            values.extend(times.map(|t_us| number(window, *t_us)));
        }
        Array { pixels, values }
    }

    fn push(&mut self, event: &Event) {
        let (number, channels) = (self.active.number(event), self.channels());
        let Some(queue) = self.queues.get_mut(number as usize) else {
            return;
        };
        if *queue == 0 {
            self.times.resize(self.times.len() + channels, None);
            *queue = (self.times.len() / channels) as u32;
        }
        let first = (*queue as usize - 1) * channels;
        let first = match event.polarity {
            Polarity::On => first,
            Polarity::Off => first + self.depth,
        };
        if let Some(times) = self.times.get_mut(first..first + self.depth) {
            times.rotate_right(1);
            if let Some(latest) = times.first_mut() {
                *latest = Some(event.t_us);
            }
        }
    }

    fn times_of(&self, pixel: u32) -> &[Option<u64>] {
        let queue = self.queues.get(pixel as usize).copied().unwrap_or(0) as usize;
        let range = (queue.saturating_sub(1) * self.channels())..queue * self.channels();
        self.times.get(range).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use event_types::test_events::{SENSOR, event};

    use super::*;

    fn window(number: u64, events: &[Event]) -> Window<'_> {
        Window {
            number,
            start_us: 32_768 * number,
            events,
        }
    }

    fn times(recent: &mut Recent, window: &Window<'_>) -> (Vec<u32>, Vec<i64>) {
        let array = recent.array(window, |_, t_us| t_us.map_or(-1.0, |t_us| t_us as f64));
        let values = array.values.iter().map(|value| *value as i64).collect();
        (array.pixels, values)
    }

    #[test]
    fn the_latest_are_kept_and_come_for_one_more_window() {
        let mut recent = Recent::new(SENSOR, 2);
        let first = [
            event(1, 5, 0, true),
            event(2, 5, 0, true),
            event(3, 5, 0, true),
            event(4, 5, 0, false),
        ];
        let found = times(&mut recent, &window(0, &first));
        assert_eq!(found, (vec![5], vec![3, 2, 4, -1]));
        let next = [event(32_769, 3, 0, false)];
        let expected = (vec![3, 5], vec![-1, -1, 32_769, -1, 3, 2, 4, -1]);
        assert_eq!(times(&mut recent, &window(1, &next)), expected);
        let next = [event(99_000, 5, 0, true)];
        let expected = (vec![5], vec![99_000, 3, 4, -1]);
        assert_eq!(times(&mut recent, &window(3, &next)), expected);
    }
}
