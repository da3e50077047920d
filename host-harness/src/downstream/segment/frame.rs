//! Event frames: how often each pixel fired, by polarity.

use eecvs_nostd::{Event, Polarity, Sensor};

/// Counts of events per pixel and polarity, in raster order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    sensor: Sensor,
    on: Vec<u32>,
    off: Vec<u32>,
}

impl Frame {
    /// Counts `events`, in any order; those outside of `sensor` are ignored.
    #[must_use]
    pub fn new(sensor: Sensor, events: &[Event]) -> Self {
        let pixels = sensor.pixels() as usize;
        let (mut on, mut off) = (vec![0_u32; pixels], vec![0_u32; pixels]);
        for event in events {
            if !sensor.contains(event.x, event.y) {
                continue;
            }
            let counts = match event.polarity {
                Polarity::On => &mut on,
                Polarity::Off => &mut off,
            };
            if let Some(count) = counts.get_mut(sensor.number((event.x, event.y)) as usize) {
                *count = count.saturating_add(1);
            }
        }
        Self { sensor, on, off }
    }

    /// Returns the size of the frame.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the ON events per pixel.
    #[must_use]
    pub fn on(&self) -> &[u32] {
        &self.on
    }

    /// Returns the OFF events per pixel.
    #[must_use]
    pub fn off(&self) -> &[u32] {
        &self.off
    }

    /// Returns the events of either polarity per pixel.
    pub fn counts(&self) -> impl Iterator<Item = u32> + '_ {
        let pairs = self.on.iter().zip(&self.off);
        pairs.map(|(on, off)| on.saturating_add(*off))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_counted_by_polarity_and_those_outside_are_ignored() {
        let sensor = Sensor::new(3, 2).unwrap();
        let event = |x, y, on| Event {
            t_us: 0,
            x,
            y,
            polarity: Polarity::from_bool(on),
        };
        let events = [
            event(2, 1, true),
            event(2, 1, true),
            event(2, 1, false),
            event(0, 0, false),
            event(3, 0, true),
            event(0, 2, true),
            event(u16::MAX, u16::MAX, true),
        ];
        let frame = Frame::new(sensor, &events);
        assert_eq!(frame.on(), [0, 0, 0, 0, 0, 2]);
        assert_eq!(frame.off(), [1, 0, 0, 0, 0, 1]);
        assert_eq!(frame.counts().collect::<Vec<_>>(), [1, 0, 0, 0, 0, 3]);
    }
}
