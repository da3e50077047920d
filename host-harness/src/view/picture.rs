//! Draws a frame as a picture with captions and the colour scale.

use eecvs_nostd::Sensor;
use event_pictures::frame_picture::{FrameStyle, event_frame, strip};
use event_pictures::picture::{CELL, Picture};

use super::frames::Frame;

/// Width in pixels that the panels of a picture reach together by default.
const LEGIBLE_WIDTH: usize = 480;

/// Returns the smallest upscale that makes `panels` panels side by side 480 pixels wide or more.
#[must_use]
pub fn default_upscale(sensor: Sensor, panels: usize) -> usize {
    let width = usize::from(sensor.width.max(sensor.height)).max(1);
    LEGIBLE_WIDTH.div_ceil(width * panels.max(1))
}

/// Style and time origin of the pictures.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// Colours and size.
    pub style: FrameStyle,
    /// Time that captions count from, in us of the recording.
    pub origin_us: u64,
}

/// Draws one panel, or the three `original | decoded | decoded - original`, captioned with the slice's start in ms.
#[must_use]
pub fn picture(frame: &Frame, look: Look) -> Picture {
    let style = look.style;
    let original = event_frame(&frame.original, style);
    let time = milliseconds(frame.start_us, look.origin_us);
    // A truncated number would be a wrong time.
    let fits = |text: &str| text.len() * CELL * 2 <= original.width();
    let Some(decoded) = &frame.decoded else {
        let caption = if fits(&time) { time.as_str() } else { "" };
        return strip(&[(caption, original)], style);
    };
    let mut caption = format!("original, {time}");
    if !fits(&caption) {
        "original".clone_into(&mut caption);
    }
    let difference = decoded.minus(&frame.original);
    let panels = [
        (caption.as_str(), original),
        ("decoded", event_frame(decoded, style)),
        ("decoded - original", event_frame(&difference, style)),
    ];
    strip(&panels, style)
}

/// Formats the time since `origin_us` in ms, with three decimals.
#[must_use]
pub fn milliseconds(t_us: u64, origin_us: u64) -> String {
    let since_us = i128::from(t_us) - i128::from(origin_us);
    let sign = if since_us < 0 { "-" } else { "" };
    let since_us = since_us.unsigned_abs();
    format!("{sign}{}.{:03} ms", since_us / 1000, since_us % 1000)
}

#[cfg(test)]
pub(crate) mod tests {
    use eecvs_nostd::Polarity;
    use event_pictures::frame_picture::FrameSums;
    use event_types::test_events::event;

    use super::*;

    pub(crate) const SENSOR: Sensor = Sensor {
        width: 40,
        height: 30,
    };

    /// Makes a frame of one ON event at `original` and one OFF event at `decoded`.
    pub(crate) fn frame(original: (u16, u16), decoded: Option<(u16, u16)>) -> Frame {
        let sums = |(x, y), polarity| {
            let event = event(0, x, y, polarity == Polarity::On);
            FrameSums::new(SENSOR, &[event])
        };
        Frame {
            start_us: 12_345,
            events: 1,
            decoded_events: u64::from(decoded.is_some()),
            original: sums(original, Polarity::On),
            decoded: decoded.map(|at| sums(at, Polarity::Off)),
            skipped_us: 0,
        }
    }

    pub(crate) const LOOK: Look = Look {
        style: FrameStyle {
            clip: 4,
            upscale: 5,
        },
        origin_us: 2_000,
    };

    #[test]
    fn panels_show_original_decoded_and_difference() {
        let shown = picture(&frame((3, 2), Some((7, 2))), LOOK);
        let (on, off) = (LOOK.style.colour(1), LOOK.style.colour(-1));
        // Panels of 200 x 150 pixels begin after a margin and a line, and are 10 pixels apart.
        let (left, top, pitch) = (CELL + 1, 2 * CELL + 1, 200 + 2 + CELL);
        let at = |panel: usize, x: usize, y: usize| {
            shown.pixel(left + panel * pitch + 5 * x + 2, top + 5 * y + 2)
        };
        let white = Some([255; 3]);
        for (panel, at_original, at_decoded) in [
            (0, Some(on), white),
            (1, white, Some(off)),
            (2, Some(off), Some(off)),
        ] {
            assert_eq!(at(panel, 3, 2), at_original, "{panel}");
            assert_eq!(at(panel, 7, 2), at_decoded, "{panel}");
            assert_eq!(at(panel, 8, 2), white, "{panel}");
        }
        assert_eq!(shown.width(), 3 * pitch + CELL);
        let alone = picture(&frame((3, 2), None), LOOK);
        assert_eq!(alone.width(), pitch + CELL);
    }

    #[test]
    fn times_are_exact() {
        assert_eq!(milliseconds(12_345, 2_000), "10.345 ms");
        assert_eq!(milliseconds(1_000, 2_001), "-1.001 ms");
        let most = milliseconds(u64::MAX, 0);
        assert_eq!(most, "18446744073709551.615 ms");
    }

    #[test]
    fn small_sensors_become_legible() {
        let of = |width, height| Sensor::new(width, height).unwrap();
        assert_eq!(default_upscale(of(34, 34), 1), 15);
        assert_eq!(default_upscale(of(34, 34), 3), 5);
        assert_eq!(default_upscale(of(1280, 720), 3), 1);
    }
}
