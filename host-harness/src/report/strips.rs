//! A slice of a recording as several methods bring it back, and what each gets wrong, in one picture.
//!
//! The first column is the original; each other one is a method's panel above its difference to the
//! original. Columns that do not fit beside each other go on below.

use eecvs_nostd::{Event, Sensor};

use super::frame_picture::{
    FrameStyle, FrameSums, INK, LINE, PAPER, draw_legend, event_frame, legend_width,
};
use super::picture::{CELL, Picture};

/// Width that a picture keeps below, in pixels: twice that of a page.
pub const WIDTH_MAX: usize = 1_720;
/// Letters are twice their size, so that they are legible on a page.
const SCALE: usize = 2;
const MARGIN: usize = CELL * SCALE;
/// Height of a caption and the space around it.
const BAR: usize = 2 * MARGIN;
/// Columns beside each other; more would cut most captions off.
const COLUMNS_MAX: usize = 5;

/// Size of the panels, and how many stand beside each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    columns: usize,
    /// A panel's pixel is the sum of this many squared of the sensor.
    factor: u16,
    upscale: usize,
}

impl Layout {
    /// As many columns as fit with a pixel per pixel, but two where there are two: then pixels are summed.
    fn new(sensor: Sensor, count: usize, upscale_max: usize) -> Self {
        let width = usize::from(sensor.width.max(1));
        let least = count.clamp(1, 2);
        let most = count.clamp(1, COLUMNS_MAX);
        let fitting = (least..=most).rev().find(|c| width <= room(*c));
        let columns = fitting.unwrap_or(least);
        // The same number of rows takes as few columns as it can: the last row is as full as can be.
        let rows = count.max(1).div_ceil(columns);
        let columns = count.max(1).div_ceil(rows).max(least);
        let room = room(columns).max(1);
        Self {
            columns,
            // No side is above 2048.
            factor: width.div_ceil(room) as u16,
            upscale: (room / width).clamp(1, upscale_max.max(1)),
        }
    }
}

/// Width of a panel where so many are beside each other, in pixels.
const fn room(columns: usize) -> usize {
    (WIDTH_MAX - MARGIN) / columns - MARGIN - 2
}

/// Draws the original's events of a slice, and below each method's name its events of that slice and
/// their difference to the original; 1,720 pixels wide at the most.
///
/// `style.upscale` is the largest that is used. Where a sensor is too wide, a pixel is the sum of s x s of
/// its pixels, and the darkest colour stands for s times the clip, as the colour scale says. A caption
/// that is longer than its panel is cut off.
#[must_use]
pub fn strips(
    sensor: Sensor,
    original: &[Event],
    methods: &[(String, Vec<Event>)],
    style: FrameStyle,
) -> Picture {
    let layout = Layout::new(sensor, methods.len() + 1, style.upscale);
    let style = FrameStyle {
        clip: style.clip.saturating_mul(u32::from(layout.factor)),
        upscale: layout.upscale,
    };
    let sums = |events: &[Event]| FrameSums::new(sensor, events).shrunk(layout.factor);
    let original = sums(original);
    let panel = event_frame(&original, style);
    let (pitch, slot) = (panel.width() + 2 + MARGIN, panel.height() + 2 + BAR);
    let rows = (methods.len() + 1).div_ceil(layout.columns);
    // Without methods there are no differences.
    let slots = if methods.is_empty() { 1 } else { 2 };
    let row_height = slots * slot + MARGIN / 2;
    let width = layout.columns * pitch + MARGIN;
    let mut canvas = Picture::new(
        width.max(legend_width(style, SCALE) + 2 * MARGIN),
        rows * row_height + BAR,
        PAPER,
    );
    let corner = |number: usize| {
        let (column, row) = (number % layout.columns, number / layout.columns);
        (MARGIN + column * pitch, row * row_height)
    };
    place(&mut canvas, corner(0), "original", &panel);
    for (number, (name, events)) in methods.iter().enumerate() {
        let decoded = sums(events);
        let (x, y) = corner(number + 1);
        place(&mut canvas, (x, y), name, &event_frame(&decoded, style));
        let difference = event_frame(&decoded.minus(&original), style);
        place(&mut canvas, (x, y + slot), "- original", &difference);
    }
    let y = rows * row_height + MARGIN / 2;
    draw_legend(&mut canvas, MARGIN, y, style, SCALE);
    canvas
}

/// A panel with its caption, the upper left corner of both together at (x, y).
fn place(canvas: &mut Picture, (x, y): (usize, usize), caption: &str, panel: &Picture) {
    let letters = panel.width() / (CELL * SCALE);
    let caption: String = caption.chars().take(letters).collect();
    canvas.text(x + 1, y + MARGIN / 2, SCALE, &caption, INK);
    canvas.fill(x, y + BAR, panel.width() + 2, panel.height() + 2, LINE);
    canvas.place(x + 1, y + BAR + 1, panel);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::memory_reader::event;

    fn sensor(width: u16, height: u16) -> Sensor {
        Sensor::new(width, height).unwrap()
    }

    #[test]
    fn every_method_stands_above_its_difference() {
        let sensor = sensor(100, 80);
        let style = FrameStyle {
            clip: 4,
            upscale: 3,
        };
        let original = [event(0, 10, 20, true)];
        let methods = [
            ("same".to_owned(), original.to_vec()),
            ("other".to_owned(), vec![event(0, 50, 60, true)]),
        ];
        let picture = strips(sensor, &original, &methods, style);
        let (on, off) = (Some(style.colour(1)), Some(style.colour(-1)));
        let white = Some(style.colour(0));
        let at = |column: usize, slot: usize, x: usize, y: usize| {
            let left = MARGIN + 1 + column * (300 + 2 + MARGIN);
            let top = BAR + 1 + slot * (240 + 2 + BAR);
            picture.pixel(left + 3 * x + 1, top + 3 * y + 1)
        };
        for (column, slot, at_original, at_other) in [
            (0, 0, on, white),
            (1, 0, on, white),
            (1, 1, white, white),
            (2, 0, white, on),
            (2, 1, off, on),
        ] {
            assert_eq!(at(column, slot, 10, 20), at_original, "{column} {slot}");
            assert_eq!(at(column, slot, 50, 60), at_other, "{column} {slot}");
        }
        // Below the original is nothing.
        assert_eq!(at(0, 1, 10, 20), Some(PAPER));
        assert_eq!(picture.width(), 3 * (300 + 2 + MARGIN) + MARGIN);
    }

    #[test]
    fn methods_go_on_in_further_rows() {
        let layout = |width, count| Layout::new(sensor(width, 100), count, 100);
        for (width, count, columns) in [
            (346, 3, 3),
            (346, 5, 3),
            (346, 8, 4),
            (128, 6, 3),
            (128, 5, 5),
            (640, 3, 2),
            (1280, 1, 1),
            (1280, 4, 2),
        ] {
            assert_eq!(layout(width, count).columns, columns, "{width} {count}");
        }
        assert_eq!(layout(1280, 4).factor, 2);
        assert_eq!(layout(346, 8).factor, 1);
        assert_eq!(layout(128, 5).upscale, 2);
    }

    #[test]
    fn pictures_keep_to_the_width() {
        let style = FrameStyle {
            clip: 4,
            upscale: 100,
        };
        for (width, height) in [(1, 1), (34, 34), (346, 260), (1280, 720), (2048, 4)] {
            for count in [0, 1, 2, 4, 7, 11] {
                let methods = vec![("a name of some length".to_owned(), vec![]); count];
                let picture = strips(sensor(width, height), &[], &methods, style);
                assert!(picture.width() <= WIDTH_MAX, "{width} {count}");
            }
        }
    }

    #[test]
    fn a_wide_sensor_is_summed() {
        let events = [event(0, 1200, 100, true), event(0, 1201, 101, true)];
        let style = FrameStyle {
            clip: 3,
            upscale: 1,
        };
        let methods = [("none".to_owned(), vec![])];
        let picture = strips(sensor(1280, 720), &events, &methods, style);
        let summed = FrameStyle {
            clip: 6,
            upscale: 1,
        };
        let at = picture.pixel(MARGIN + 1 + 600, BAR + 1 + 50);
        assert_eq!(at, Some(summed.colour(2)));
    }
}
