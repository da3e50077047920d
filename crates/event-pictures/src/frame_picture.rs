//! Pictures of event windows: the signed sum of polarities per pixel, shown as a colour.
//!
//! ON is blue, OFF orange and a sum of 0 white; colour-blind readers can tell these hues apart. |sum| = 1 has a
//! saturated colour, so that a single event is visible. From there the colour darkens in equal steps up to
//! |sum| = clip; larger sums look like the clip.

use eecvs_nostd::{Event, Sensor};

use super::picture::{CELL, Colour, Picture};

const GROUND: Colour = [255, 255, 255];
/// Colour of the background around pictures.
pub const PAPER: Colour = [244, 244, 242];
/// Colour of lines and frames.
pub const LINE: Colour = [150, 150, 150];
/// Colour of text.
pub const INK: Colour = [40, 40, 40];
/// Lightest colour (|sum| = 1) and darkest colour (|sum| = clip).
const ON: [Colour; 2] = [[86, 160, 224], [4, 34, 94]];
const OFF: [Colour; 2] = [[245, 155, 66], [112, 42, 0]];

/// Longest side that scaling up may give a frame, in pixels.
const SIDE_MAX: usize = 4096;
/// Minimum of the longer side for [`FrameStyle::for_sensor`], in pixels.
const LEGIBLE_SIDE: usize = 480;

/// How the sums of a frame are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameStyle {
    /// |sum| that gets the darkest colour, 1 or more.
    pub clip: u32,
    /// Side in pixels of the square that shows a sensor pixel, 1 or more; reduced where a side of the picture would
    /// exceed 4096 pixels.
    pub upscale: usize,
}

impl FrameStyle {
    /// Returns clip 4 and the smallest upscale that makes the longer side at least 480 pixels.
    #[must_use]
    pub fn for_sensor(sensor: Sensor) -> Self {
        let longer = usize::from(sensor.width.max(sensor.height)).max(1);
        Self {
            clip: 4,
            upscale: LEGIBLE_SIDE.div_ceil(longer),
        }
    }

    fn upscale_of(self, sensor: Sensor) -> usize {
        let longer = usize::from(sensor.width.max(sensor.height)).max(1);
        self.upscale.clamp(1, (SIDE_MAX / longer).max(1))
    }

    /// Returns every colour of a [`strip`]: background, lines and text, then those of the sums from -clip to clip.
    #[must_use]
    pub fn palette(self) -> Vec<Colour> {
        let clip = i64::from(self.clip.max(1));
        [PAPER, LINE, INK]
            .into_iter()
            .chain((-clip..=clip).map(|sum| self.colour(sum)))
            .collect()
    }

    /// Returns the colour of a pixel whose polarities add up to `sum`.
    #[must_use]
    pub fn colour(self, sum: i64) -> Colour {
        let [light, dark] = match sum {
            0 => return GROUND,
            1.. => ON,
            _ => OFF,
        };
        let steps = u64::from(self.clip.max(2)) - 1;
        let step = (sum.unsigned_abs() - 1).min(steps);
        // With a clip of 1 there are no steps: every sum has the colour of a single event.
        let step = if self.clip <= 1 { 0 } else { step };
        std::array::from_fn(|i| {
            let mix = u64::from(light[i]) * (steps - step) + u64::from(dark[i]) * step;
            (mix / steps) as u8
        })
    }
}

/// A frame: the signed sum of polarities per pixel, row by row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameSums {
    sensor: Sensor,
    sums: Vec<i64>,
}

impl FrameSums {
    /// Creates a frame without events.
    #[must_use]
    pub fn empty(sensor: Sensor) -> Self {
        Self {
            sensor,
            sums: vec![0; sensor.pixels() as usize],
        }
    }

    /// Sums `events`, in any order; events outside `sensor` are ignored.
    #[must_use]
    pub fn new(sensor: Sensor, events: &[Event]) -> Self {
        let mut frame = Self::empty(sensor);
        events.iter().for_each(|event| frame.add(event));
        frame
    }

    /// Adds an event; an event outside the sensor is ignored.
    pub fn add(&mut self, event: &Event) {
        if !self.sensor.contains(event.x, event.y) {
            return;
        }
        let number = self.sensor.number((event.x, event.y)) as usize;
        if let Some(sum) = self.sums.get_mut(number) {
            *sum += i64::from(event.polarity.sign());
        }
    }

    /// Returns the size of the frame.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the sum of pixel (x, y); 0 outside the sensor.
    #[must_use]
    pub fn sum(&self, x: u16, y: u16) -> i64 {
        if !self.sensor.contains(x, y) {
            return 0;
        }
        let number = self.sensor.number((x, y)) as usize;
        self.sums.get(number).copied().unwrap_or(0)
    }

    /// Returns a smaller frame, each pixel of which is the sum of `factor` x `factor` pixels of this one.
    ///
    /// The squares at the right and lower borders may be cut; a factor of 0 counts as 1.
    #[must_use]
    pub fn shrunk(&self, factor: u16) -> Self {
        let factor = factor.max(1);
        let mut shrunk = Self::empty(Sensor {
            width: self.sensor.width.div_ceil(factor),
            height: self.sensor.height.div_ceil(factor),
        });
        let (from, to) = (usize::from(self.sensor.width), shrunk.sensor.width);
        for (y, row) in self.sums.chunks(from.max(1)).enumerate() {
            let start = y / usize::from(factor) * usize::from(to);
            let target = shrunk.sums.get_mut(start..).unwrap_or_default();
            for (pixels, sum) in row.chunks(usize::from(factor)).zip(target) {
                *sum += pixels.iter().sum::<i64>();
            }
        }
        shrunk
    }

    /// Returns this frame minus `other` of the same sensor; positive (ON) where this frame has the larger sum.
    #[must_use]
    pub fn minus(&self, other: &Self) -> Self {
        debug_assert_eq!(self.sensor, other.sensor);
        let differences = self.sums.iter().zip(&other.sums).map(|(a, b)| a - b);
        Self {
            sensor: self.sensor,
            sums: differences.collect(),
        }
    }
}

/// Draws a frame as a picture in which each sensor pixel is a square of upscale x upscale pixels.
#[must_use]
pub fn event_frame(frame: &FrameSums, style: FrameStyle) -> Picture {
    let upscale = style.upscale_of(frame.sensor);
    let width = usize::from(frame.sensor.width);
    let height = usize::from(frame.sensor.height);
    let mut picture = Picture::new(width * upscale, height * upscale, GROUND);
    for (y, row) in frame.sums.chunks(width.max(1)).enumerate() {
        for (x, sum) in row.iter().enumerate().filter(|(_, sum)| **sum != 0) {
            let colour = style.colour(*sum);
            picture.fill(x * upscale, y * upscale, upscale, upscale, colour);
        }
    }
    picture
}

/// Draws pictures side by side, each with a caption above it, and the colour scale below.
///
/// A caption longer than its picture is cut off; characters outside ASCII become question marks.
#[must_use]
pub fn strip(panels: &[(&str, Picture)], style: FrameStyle) -> Picture {
    let tallest = panels.iter().map(|(_, p)| p.height()).max().unwrap_or(0);
    let widest = panels.iter().map(|(_, p)| p.width()).max().unwrap_or(0);
    // A report shows a large picture scaled down, so its letters are drawn larger.
    let scale = if widest >= 640 { 2 } else { 1 };
    let (margin, bar) = (CELL * scale, CELL * scale * 2);
    let frames: usize = panels.iter().map(|(_, p)| p.width() + 2 + margin).sum();
    let scale_width = legend_width(style, scale);
    let width = frames.max(scale_width + margin) + margin;
    let height = bar + tallest + 2 + bar + margin / 2;
    let mut canvas = Picture::new(width, height, PAPER);
    let mut x = margin;
    for (caption, picture) in panels {
        let letters = picture.width() / (CELL * scale);
        let caption: String = caption.chars().take(letters).collect();
        canvas.text(x + 1, margin / 2, scale, &caption, INK);
        canvas.fill(x, bar, picture.width() + 2, picture.height() + 2, LINE);
        canvas.place(x + 1, bar + 1, picture);
        x += picture.width() + 2 + margin;
    }
    draw_legend(
        &mut canvas,
        margin,
        bar + tallest + 2 + margin * 3 / 4,
        style,
        scale,
    );
    canvas
}

/// Draws the strip `original | decoded | decoded - original` of one window.
#[must_use]
pub fn comparison_strip(original: &FrameSums, decoded: &FrameSums, style: FrameStyle) -> Picture {
    let difference = decoded.minus(original);
    let panels = [
        ("original", event_frame(original, style)),
        ("decoded", event_frame(decoded, style)),
        ("decoded - original", event_frame(&difference, style)),
    ];
    strip(&panels, style)
}

/// Number of colours that the legend shows on either side of 0.
fn legend_steps(style: FrameStyle) -> i64 {
    i64::from(style.clip.clamp(1, 8))
}

fn legend_labels(style: FrameStyle) -> (String, String) {
    let clip = style.clip.max(1);
    (format!("OFF -{clip}"), format!("+{clip} ON"))
}

/// Returns the width of the legend in pixels, with each font pixel drawn as `scale` x `scale` pixels.
#[must_use]
pub fn legend_width(style: FrameStyle, scale: usize) -> usize {
    let (left, right) = legend_labels(style);
    let swatches = (2 * legend_steps(style) + 1) as usize;
    (left.len() + right.len() + 2 + swatches) * CELL * scale
}

/// Draws the legend of `style` with its upper left corner at (x, y).
///
/// Each font pixel is drawn as `scale` x `scale` pixels; `y` must be at least 1.
pub fn draw_legend(canvas: &mut Picture, x: usize, y: usize, style: FrameStyle, scale: usize) {
    let cell = CELL * scale;
    let (left, right) = legend_labels(style);
    let steps = legend_steps(style);
    canvas.text(x, y, scale, &left, INK);
    let mut x = x + left.len() * cell + cell / 2;
    let count = (2 * steps + 1) as usize;
    canvas.fill(x, y - 1, count * cell + 2, cell + 2, LINE);
    for step in -steps..=steps {
        // With more colours than swatches, the swatches show evenly spaced sums.
        let sum = step * i64::from(style.clip.max(1)) / steps;
        canvas.fill(x + 1, y, cell, cell, style.colour(sum));
        x += cell;
    }
    canvas.text(x + 2 + cell / 2, y, scale, &right, INK);
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Polarity;

    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 4,
        height: 3,
    };

    fn events(x: u16, y: u16, polarity: Polarity, count: usize) -> Vec<Event> {
        let event = Event {
            t_us: 0,
            x,
            y,
            polarity,
        };
        vec![event; count]
    }

    fn sum_of(colour: Colour) -> u32 {
        colour.iter().map(|c| u32::from(*c)).sum()
    }

    #[test]
    fn colours_follow_the_convention() {
        let style = FrameStyle {
            clip: 3,
            upscale: 1,
        };
        assert_eq!(style.colour(0), GROUND);
        for (sign, expected) in [(1, ON), (-1, OFF)] {
            assert_eq!(style.colour(sign), expected[0]);
            assert_eq!(style.colour(3 * sign), expected[1]);
            assert_eq!(style.colour(i64::MAX * sign), expected[1]);
            assert!(sum_of(style.colour(2 * sign)) < sum_of(style.colour(sign)));
        }
        let [red, _, blue] = style.colour(1);
        assert!(blue > red);
        for clip in [0, 1] {
            assert_eq!(FrameStyle { clip, upscale: 1 }.colour(-9), OFF[0]);
        }
    }

    #[test]
    fn a_sensor_pixel_becomes_a_square() {
        let mut all = events(1, 2, Polarity::On, 1);
        all.extend(events(0, 0, Polarity::Off, 1));
        all.extend(events(4, 0, Polarity::On, 1));
        let style = FrameStyle {
            clip: 2,
            upscale: 3,
        };
        let picture = event_frame(&FrameSums::new(SENSOR, &all), style);
        assert_eq!((picture.width(), picture.height()), (12, 9));
        for y in 0..9 {
            for x in 0..12 {
                let expected = match (x / 3, y / 3) {
                    (1, 2) => ON[0],
                    (0, 0) => OFF[0],
                    _ => GROUND,
                };
                assert_eq!(picture.pixel(x, y), Some(expected));
            }
        }
    }

    #[test]
    fn differences_cancel_where_the_frames_agree() {
        let a = FrameSums::new(SENSOR, &events(1, 1, Polarity::On, 3));
        let b = FrameSums::new(SENSOR, &events(1, 1, Polarity::On, 1));
        assert!(a.minus(&a).sums.iter().all(|sum| *sum == 0));
        assert_eq!(b.minus(&a).sums[5], -2);
    }

    #[test]
    fn a_shrunk_frame_sums_squares() {
        let mut all = events(0, 0, Polarity::On, 3);
        all.extend(events(2, 1, Polarity::Off, 1));
        all.extend(events(3, 0, Polarity::Off, 2));
        all.extend(events(3, 2, Polarity::On, 1));
        let frame = FrameSums::new(SENSOR, &all);
        let shrunk = frame.shrunk(2);
        assert_eq!((shrunk.sensor.width, shrunk.sensor.height), (2, 2));
        assert_eq!(shrunk.sums, [3, -3, 0, 1]);
        assert_eq!(frame.shrunk(3).sums, [2, -1]);
        assert_eq!(frame.shrunk(u16::MAX).sums, [1]);
        for factor in [0, 1] {
            assert_eq!(frame.shrunk(factor), frame);
        }
        assert_eq!((frame.sum(3, 0), frame.sum(4, 0)), (-2, 0));
    }

    #[test]
    fn the_palette_has_every_colour_of_a_strip() {
        let style = FrameStyle {
            clip: 3,
            upscale: 40,
        };
        let frame = FrameSums::new(SENSOR, &events(1, 1, Polarity::Off, 2));
        let picture = comparison_strip(&frame, &FrameSums::empty(SENSOR), style);
        let palette = style.palette();
        assert_eq!(palette.len(), 3 + 7);
        for y in 0..picture.height() {
            for x in 0..picture.width() {
                let colour = picture.pixel(x, y).unwrap();
                assert!(palette.contains(&colour), "{x},{y}: {colour:?}");
            }
        }
    }

    #[test]
    fn pictures_stay_within_bounds() {
        let wide = Sensor {
            width: 2048,
            height: 1,
        };
        let style = FrameStyle {
            clip: 4,
            upscale: usize::MAX,
        };
        let picture = event_frame(&FrameSums::new(wide, &[]), style);
        assert_eq!(picture.width(), 4096);
        assert_eq!(FrameStyle::for_sensor(SENSOR).upscale, 120);
        assert_eq!(FrameStyle::for_sensor(wide).upscale, 1);
        let empty = strip(
            &[],
            FrameStyle {
                clip: u32::MAX,
                upscale: 1,
            },
        );
        assert!(empty.width() < 1000);
    }

    #[test]
    fn a_strip_shows_every_panel() {
        let frame = FrameSums::new(SENSOR, &events(0, 0, Polarity::On, 1));
        let style = FrameStyle {
            clip: 2,
            upscale: 20,
        };
        let picture = comparison_strip(&frame, &FrameSums::new(SENSOR, &[]), style);
        let count = |colour| {
            let at = |i| picture.pixel(i % picture.width(), i / picture.width());
            let pixels = picture.width() * picture.height();
            (0..pixels).filter(|i| at(*i) == Some(colour)).count()
        };
        let swatch = CELL * CELL;
        assert_eq!(count(ON[0]), 20 * 20 + swatch);
        assert_eq!(count(OFF[0]), 20 * 20 + swatch);
    }
}
