//! Draws a slice of a recording as several methods decode it, with the errors of each, in one picture.
//!
//! The first column is the original. Every other column is a method's panel above its difference from the original.
//! Columns that do not fit beside each other continue below.

use eecvs_nostd::{Event, Sensor};
use event_pictures::frame_picture::{
    FrameStyle, FrameSums, INK, LINE, PAPER, draw_legend, event_frame, legend_width,
};
use event_pictures::picture::{CELL, Picture};

use super::part::Part;

/// Largest width of a picture in pixels: twice the width of a page.
pub const WIDTH_MAX: usize = 1_720;
/// Letters are drawn at twice their size, to be legible on a page.
const SCALE: usize = 2;
/// Height and width of a letter, in pixels.
pub const LETTER: usize = CELL * SCALE;
const MARGIN: usize = 16;
/// Height of a caption with the space around it.
const BAR: usize = LETTER + MARGIN;
/// Largest number of columns beside each other; more would cut most captions off.
const COLUMNS_MAX: usize = 4;

/// A slice as decoded by several methods.
#[derive(Debug, Clone)]
pub struct Strips {
    /// The picture, at most 1,720 pixels wide.
    pub picture: Picture,
    /// Part of the sensor shown, the same in every panel.
    pub part: Part,
}

/// Number of panels beside each other, and their scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    columns: usize,
    upscale: usize,
}

impl Layout {
    /// Uses the least number of rows, and for it the fewest columns, so that the last row is as full as possible.
    fn new(part: Sensor, count: usize, upscale_max: usize) -> Self {
        let count = count.max(1);
        let rows = count.div_ceil(COLUMNS_MAX);
        let columns = count.div_ceil(rows);
        let width = usize::from(part.width.max(1));
        Self {
            columns,
            upscale: (room(columns) / width).clamp(1, upscale_max.max(1)),
        }
    }
}

/// Returns the width of a panel in pixels if there are `columns` beside each other.
const fn room(columns: usize) -> usize {
    (WIDTH_MAX - MARGIN) / columns - MARGIN - 2
}

/// Draws the original's events of a slice, and for each method its name, its events of that slice and their
/// difference from the original.
///
/// Of a large sensor, the densest part of the original is shown, see [`Part::densest`]. Panels are enlarged as far
/// as [`FrameStyle::for_sensor`] asks for and the width allows. Captions longer than their panel are cut off.
#[must_use]
pub fn strips(sensor: Sensor, original: &[Event], methods: &[(String, Vec<Event>)]) -> Strips {
    let part = Part::densest(sensor, original);
    let style = FrameStyle::for_sensor(part.size);
    let layout = Layout::new(part.size, methods.len() + 1, style.upscale);
    let style = FrameStyle {
        upscale: layout.upscale,
        ..style
    };
    let sums = |events: &[Event]| FrameSums::new(part.size, &part.cut(events));
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
    Strips {
        picture: canvas,
        part,
    }
}

/// Draws a panel with its caption; (x, y) is the upper left corner of both together.
fn place(canvas: &mut Picture, (x, y): (usize, usize), caption: &str, panel: &Picture) {
    let letters = panel.width() / LETTER;
    let caption: String = caption.chars().take(letters).collect();
    canvas.text(x + 1, y + MARGIN / 2, SCALE, &caption, INK);
    canvas.fill(x, y + BAR, panel.width() + 2, panel.height() + 2, LINE);
    canvas.place(x + 1, y + BAR + 1, panel);
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    fn sensor(width: u16, height: u16) -> Sensor {
        Sensor::new(width, height).unwrap()
    }

    #[test]
    fn every_method_stands_above_its_difference() {
        let sensor = sensor(100, 80);
        let style = FrameStyle::for_sensor(sensor);
        let original = [event(0, 10, 20, true)];
        let methods = [
            ("same".to_owned(), original.to_vec()),
            ("other".to_owned(), vec![event(0, 50, 60, true)]),
        ];
        let picture = strips(sensor, &original, &methods).picture;
        let (on, off) = (Some(style.colour(1)), Some(style.colour(-1)));
        let white = Some(style.colour(0));
        let at = |column: usize, slot: usize, x: usize, y: usize| {
            let left = MARGIN + 1 + column * (500 + 2 + MARGIN);
            let top = BAR + 1 + slot * (400 + 2 + BAR);
            picture.pixel(left + 5 * x + 1, top + 5 * y + 1)
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
        // Below the original, the picture is empty.
        assert_eq!(at(0, 1, 10, 20), Some(PAPER));
        assert_eq!(picture.width(), 3 * (500 + 2 + MARGIN) + MARGIN);
    }

    #[test]
    fn methods_go_on_in_further_rows() {
        let layout = |width, count| Layout::new(sensor(width, 100), count, 100);
        for (width, count, columns, upscale) in [
            (346, 1, 1, 4),
            (346, 3, 3, 1),
            (346, 4, 4, 1),
            (346, 5, 3, 1),
            (200, 11, 4, 2),
            (128, 9, 3, 4),
            (1, 2, 2, 100),
        ] {
            let expected = Layout { columns, upscale };
            assert_eq!(layout(width, count), expected, "{width} {count}");
        }
    }

    #[test]
    fn pictures_keep_to_the_width() {
        for (width, height) in [(1, 1), (34, 34), (346, 260), (1280, 720), (2048, 4)] {
            for count in [0, 1, 2, 4, 7, 11] {
                let methods = vec![("a name of some length".to_owned(), vec![]); count];
                let picture = strips(sensor(width, height), &[], &methods).picture;
                assert!(picture.width() <= WIDTH_MAX, "{width} {count}");
            }
        }
    }

    #[test]
    fn every_panel_of_a_wide_sensor_shows_the_same_part() {
        let at = |x, y| event(0, x, y, true);
        // The part is the densest of the original, whatever a method decodes.
        let original = [at(900, 500), at(1099, 649), at(3, 3)];
        let moved = vec![at(901, 500), at(3, 3), at(4, 4), at(5, 5), at(6, 6)];
        let Strips { picture, part } =
            strips(sensor(1280, 720), &original, &[("moved".to_owned(), moved)]);
        let style = FrameStyle::for_sensor(part.size);
        assert_eq!((part.x, part.y, part.size), (900, 500, sensor(200, 150)));
        let pixel = |column: usize, slot: usize, x: usize, y: usize| {
            let left = MARGIN + 1 + column * (600 + 2 + MARGIN);
            let top = BAR + 1 + slot * (450 + 2 + BAR);
            picture.pixel(left + 3 * x, top + 3 * y)
        };
        let [on, off, white] = [1, -1, 0].map(|sum| Some(style.colour(sum)));
        for (column, slot, expected) in [
            (0, 0, [on, white, on, white]),
            (1, 0, [white, on, white, white]),
            (1, 1, [off, on, off, white]),
        ] {
            let places = [(0, 0), (1, 0), (199, 149), (3, 3)];
            let seen = places.map(|(x, y)| pixel(column, slot, x, y));
            assert_eq!(seen, expected, "{column} {slot}");
        }
        assert_eq!(picture.width(), 2 * (600 + 2 + MARGIN) + MARGIN);
    }
}
