//! Segments event frames without a trained model, by the density of events.
//!
//! 1. *Activity*: events of either polarity per pixel, at most [`COUNT_MAX`], so that a hot pixel counts little; 0 if
//!    none of the 8 neighbours has an event (noise).
//! 2. *Density* s: sum of the activity over 5 x 5 pixels about each pixel, cut at the borders.
//! 3. *Threshold* by Otsu (1979) on ln(1 + s), since events per area span decades: on s itself, the densest spot would
//!    be the only segment. At least [`DENSITY_MIN`].
//! 4. *Closing*: dilation, then erosion, by 5 x 5 pixels, which joins the two edges of a thin object.
//! 5. *Components* of 8 neighbours; those below 1/1000 of the frame, or below [`AREA_MIN`] pixels, are dropped. Labels
//!    are numbered by the first pixel in raster order.
//!
//! Every step takes O(pixels) and uses integers, except for the threshold's logarithms. The result does not depend
//! on the order of the events.

use std::array::from_fn;

use anyhow::Result;
use eecvs_nostd::Sensor;
use rayon::prelude::*;

use super::{Frame, Masks, Segmenter};

/// Largest number of events counted per pixel.
pub const COUNT_MAX: u8 = 8;
/// Least density of a segment, in events per 5 x 5 pixels.
pub const DENSITY_MIN: u8 = 3;
/// Least area of a segment in pixels.
pub const AREA_MIN: u32 = 16;

/// Half the side of the squares, without the middle pixel.
const RADIUS: usize = 2;
/// Number of density values: the largest is 200, so that sums fit a byte.
const DENSITIES: usize = (2 * RADIUS + 1).pow(2) * COUNT_MAX as usize + 1;

/// Segmenter by the density of events; see [the module](self).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Classical;

impl Segmenter for Classical {
    fn name(&self) -> &str {
        "classical"
    }

    fn segment(&self, frame: &Frame) -> Result<Masks> {
        segment(frame)
    }

    fn segment_all(&self, frames: &[Frame]) -> Result<Vec<Masks>> {
        frames.par_iter().map(segment).collect()
    }
}

fn segment(frame: &Frame) -> Result<Masks> {
    let sensor = frame.sensor();
    let width = usize::from(sensor.width);
    let density = square_sum(width, RADIUS, &activity(frame));
    let threshold = otsu(&density).max(DENSITY_MIN);
    let foreground: Vec<u8> = density.iter().map(|s| u8::from(*s >= threshold)).collect();
    Masks::new(sensor, &components(sensor, &closed(width, &foreground)))
}

/// Returns the events per pixel, limited, without isolated pixels.
fn activity(frame: &Frame) -> Vec<u8> {
    let mut activity: Vec<u8> = frame
        .counts()
        .map(|count| count.min(u32::from(COUNT_MAX)) as u8)
        .collect();
    let active: Vec<u8> = activity.iter().map(|count| u8::from(*count > 0)).collect();
    let about = square_sum(usize::from(frame.sensor().width), 1, &active);
    for (count, active) in activity.iter_mut().zip(about) {
        // The sum includes the pixel itself.
        if active <= 1 {
            *count = 0;
        }
    }
    activity
}

/// Returns the sum over the square of 2 `radius` + 1 pixels about each pixel; outside of the image is 0.
///
/// The values must be small enough that no sum exceeds 255.
fn square_sum(width: usize, radius: usize, values: &[u8]) -> Vec<u8> {
    let mut rows = vec![0_u8; values.len()];
    for (sums, row) in rows.chunks_mut(width).zip(values.chunks(width)) {
        // One neighbour at a time, so that the loops can be vectorised.
        for shift in 0..=radius {
            add(sums.get_mut(shift..), row);
            if shift > 0 {
                add(Some(sums), row.get(shift..).unwrap_or_default());
            }
        }
    }
    let mut sums = vec![0_u8; values.len()];
    for shift in 0..=radius {
        add(sums.get_mut(shift * width..), &rows);
        if shift > 0 {
            add(
                Some(&mut sums),
                rows.get(shift * width..).unwrap_or_default(),
            );
        }
    }
    sums
}

/// Adds value by value, up to the end of the shorter slice.
fn add(sums: Option<&mut [u8]>, values: &[u8]) {
    for (sum, value) in sums.unwrap_or_default().iter_mut().zip(values) {
        *sum = sum.wrapping_add(*value);
    }
}

/// Returns the least density of the upper class, at the cut with the greatest variance between the classes (the
/// lowest of equals); 0 if all densities are equal.
fn otsu(density: &[u8]) -> u8 {
    let mut pixels = [0_u64; 256];
    for s in density {
        if let Some(count) = pixels.get_mut(usize::from(*s)) {
            *count += 1;
        }
    }
    let value: [f64; DENSITIES] = from_fn(|s| libm::log1p(s as f64));
    let classes = || pixels.iter().zip(&value);
    let sum = |class: (&u64, &f64)| *class.0 as f64 * class.1;
    let (all, total) = (
        classes().map(|(count, _)| count).sum::<u64>() as f64,
        classes().map(sum).sum::<f64>(),
    );
    let (mut below, mut total_below) = (0.0, 0.0);
    let (mut best, mut threshold) = (0.0, 0);
    for (s, class) in (0_u8..).zip(classes()) {
        // The cut is between the previous density and this one.
        let above = all - below;
        if below > 0.0 && above > 0.0 {
            let difference = total_below / below - (total - total_below) / above;
            let between = below * above * difference * difference;
            if between > best {
                (best, threshold) = (between, s);
            }
        }
        below += *class.0 as f64;
        total_below += sum(class);
    }
    threshold
}

/// Closes the foreground by a square; outside of the image there is neither foreground to dilate nor background to
/// erode.
fn closed(width: usize, foreground: &[u8]) -> Vec<u8> {
    let near = square_sum(width, RADIUS, foreground);
    let background: Vec<u8> = near.iter().map(|sum| u8::from(*sum == 0)).collect();
    let near = square_sum(width, RADIUS, &background);
    near.iter().map(|sum| u8::from(*sum == 0)).collect()
}

/// Labels the components that are large enough.
fn components(sensor: Sensor, foreground: &[u8]) -> Vec<u32> {
    /// Foreground pixel that no component has reached yet.
    const FREE: u32 = u32::MAX;
    let area_min = (sensor.pixels() / 1000).max(AREA_MIN) as usize;
    let (width, height) = (usize::from(sensor.width), usize::from(sensor.height));
    let mut labels: Vec<u32> = foreground
        .iter()
        .map(|is_foreground| if *is_foreground == 0 { 0 } else { FREE })
        .collect();
    let mut reached: Vec<usize> = Vec::new();
    let mut label = 1;
    for first in 0..labels.len() {
        let take = |labels: &mut [u32], reached: &mut Vec<usize>, pixel: usize| {
            if let Some(found) = labels.get_mut(pixel).filter(|found| **found == FREE) {
                *found = label;
                reached.push(pixel);
            }
        };
        reached.clear();
        take(&mut labels, &mut reached, first);
        let mut next = 0;
        while let Some(&pixel) = reached.get(next) {
            next += 1;
            let (x, y) = (pixel % width, pixel / width);
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    take(&mut labels, &mut reached, y * width + x);
                }
            }
        }
        if reached.len() >= area_min {
            label += 1;
            continue;
        }
        for pixel in &reached {
            if let Some(dropped) = labels.get_mut(*pixel) {
                *dropped = 0;
            }
        }
    }
    labels
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Event, Polarity};

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 64,
        height: 48,
    };

    /// Adds `n` events in each pixel of a box.
    fn filled(events: &mut Vec<Event>, x: std::ops::Range<u16>, y: std::ops::Range<u16>, n: usize) {
        for y in y {
            for x in x.clone() {
                let event = Event {
                    t_us: 0,
                    x,
                    y,
                    polarity: Polarity::from_bool((x + y) % 2 == 0),
                };
                events.extend(std::iter::repeat_n(event, n));
            }
        }
    }

    fn labels(events: &[Event]) -> Vec<u32> {
        Classical
            .segment(&Frame::new(SENSOR, events))
            .unwrap()
            .labels()
    }

    fn at(labels: &[u32], x: usize, y: usize) -> u32 {
        labels[y * 64 + x]
    }

    #[test]
    fn two_boxes_are_two_segments_about_as_large_as_they_are() {
        let mut events = Vec::new();
        filled(&mut events, 30..50, 5..20, 2);
        filled(&mut events, 5..15, 25..45, 1);
        let labels = labels(&events);
        assert_eq!(at(&labels, 40, 12), 1);
        assert_eq!(at(&labels, 10, 35), 2);
        assert_eq!(at(&labels, 25, 22), 0);
        for (label, (width, height)) in [(1, (20, 15)), (2, (10, 20))] {
            let area = labels.iter().filter(|l| **l == label).count();
            // The blur adds a border of at most RADIUS.
            assert!((width * height..=(width + 4) * (height + 4)).contains(&area));
        }
    }

    #[test]
    fn lone_events_hot_pixels_and_small_clusters_are_no_segment() {
        let mut events = Vec::new();
        for i in 0..8 {
            filled(&mut events, 8 * i..8 * i + 1, 5 * i..5 * i + 1, 1);
        }
        filled(&mut events, 60..61, 3..4, 100_000);
        filled(&mut events, 3..5, 40..41, 1);
        assert_eq!(labels(&events), vec![0; 64 * 48]);
        assert_eq!(labels(&[]), vec![0; 64 * 48]);
    }

    #[test]
    fn edges_of_a_thin_thing_are_one_segment() {
        let mut events = Vec::new();
        filled(&mut events, 20..21, 5..40, 3);
        filled(&mut events, 26..27, 5..40, 3);
        let labels = labels(&events);
        assert_eq!(at(&labels, 23, 20), 1);
        assert_eq!(labels.iter().max(), Some(&1));
    }

    #[test]
    fn the_border_is_a_place_like_others() {
        let mut events = Vec::new();
        filled(&mut events, 0..10, 0..10, 1);
        filled(&mut events, 54..64, 38..48, 1);
        let labels = labels(&events);
        for (x, y, label) in [(0, 0, 1), (9, 9, 1), (63, 47, 2), (55, 39, 2)] {
            assert_eq!(at(&labels, x, y), label, "{x}, {y}");
        }
    }

    #[test]
    fn sums_over_squares_are_those_of_a_loop() {
        let width = 9;
        let values: Vec<u8> = (0..63_u32).map(|i| (i * i % 9) as u8).collect();
        for radius in [1, 2] {
            let sums = square_sum(width, radius, &values);
            for (i, sum) in sums.iter().enumerate() {
                let expected: u32 = (0..63)
                    .filter(|j| (i % width).abs_diff(j % width) <= radius)
                    .filter(|j| (i / width).abs_diff(j / width) <= radius)
                    .map(|j| u32::from(values[j]))
                    .sum();
                assert_eq!(u32::from(*sum), expected, "{i}");
            }
        }
    }

    #[test]
    fn otsu_cuts_between_two_classes() {
        let density: Vec<u8> = [0; 50]
            .into_iter()
            .chain([2; 30])
            .chain([3; 30])
            .chain([40; 20])
            .chain([50; 20])
            .collect();
        assert_eq!(otsu(&density), 4);
        assert_eq!(otsu(&[5; 20]), 0);
        assert_eq!(otsu(&[]), 0);
        assert_eq!(otsu(&[200, 1]), 2);
    }

    #[test]
    fn any_sensor_is_segmented() {
        for (width, height) in [(1, 1), (1, 40), (40, 1), (2, 2), (3, 5)] {
            let sensor = Sensor::new(width, height).unwrap();
            let mut events = Vec::new();
            filled(&mut events, 0..width, 0..height, 5);
            let masks = Classical.segment(&Frame::new(sensor, &events)).unwrap();
            let is_large = u32::from(width) * u32::from(height) >= AREA_MIN;
            assert_eq!(masks.segments(), usize::from(is_large), "{width} {height}");
        }
    }
}
