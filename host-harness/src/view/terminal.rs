//! Shows frames in a terminal: two pixels per character, in the colours it supports, scaled down by summing.

use std::fmt::Write as _;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use event_pictures::frame_picture::FrameStyle;
use event_pictures::picture::Colour;

use super::frames::Frame;
use super::keys::{Key, Keys, Way};
use super::pace::{Pace, Turn};
use super::palette::Palette;
use super::picture::milliseconds;
use super::{Screen, Wish};

/// Upper half in the foreground colour, lower half in the background colour.
const HALVES: char = '\u{2580}';
/// Columns between panels.
const BETWEEN: usize = 2;
/// Longest time until a request to stop is noticed.
const NAP: Duration = Duration::from_millis(20);

const HIDE_CURSOR: &str = "\x1b[?25l";
const SHOW_CURSOR: &str = "\x1b[?25h";
const CLEAR: &str = "\x1b[2J";
const HOME: &str = "\x1b[H";
const CLEAR_LINE: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";
const PLAIN: &str = "\x1b[0m";

/// Space for a frame, in characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    /// Number of columns.
    pub columns: usize,
    /// Number of rows; unlimited if `None`.
    pub rows: Option<usize>,
}

/// Formats a frame as lines of at most `room.columns` characters: captions if there is a second input, pixels, and
/// one line of text.
///
/// Each pixel shown is the sum of s x s pixels of the sensor, with the smallest s that makes the frame fit; the
/// darkest colour then stands for a |sum| of `clip` x s.
#[must_use]
pub fn lines(frame: &Frame, room: Room, look: Look) -> Vec<String> {
    let difference = frame
        .decoded
        .as_ref()
        .map(|decoded| decoded.minus(&frame.original));
    let mut panels = vec![("original", &frame.original)];
    if let (Some(decoded), Some(difference)) = (&frame.decoded, &difference) {
        panels.push(("decoded", decoded));
        panels.push(("decoded - original", difference));
    }
    let count = panels.len();
    let words = if count > 1 { 2 } else { 1 };
    let columns = (room.columns.saturating_sub(BETWEEN * (count - 1)) / count).max(1);
    let rows = room.rows.map(|rows| rows.saturating_sub(words).max(1));
    let sensor = frame.original.sensor();
    let across = usize::from(sensor.width).div_ceil(columns);
    let down = rows.map_or(1, |rows| usize::from(sensor.height).div_ceil(2 * rows));
    // No side is above 2048.
    let factor = across.max(down).max(1) as u16;
    let style = FrameStyle {
        clip: look.clip.saturating_mul(u32::from(factor)),
        upscale: 1,
    };
    let shrunk: Vec<_> = panels.iter().map(|(_, sums)| sums.shrunk(factor)).collect();
    let (width, height) = shrunk
        .first()
        .map_or((0, 0), |sums| (sums.sensor().width, sums.sensor().height));

    let mut lines = Vec::new();
    if count > 1 {
        let pitch = usize::from(width) + BETWEEN;
        let captions = panels.iter().map(|(caption, _)| {
            // At least one column stays blank before the next caption.
            let letters: String = caption.chars().take(pitch - 1).collect();
            format!("{letters:<pitch$}")
        });
        let captions: String = captions.collect();
        lines.push(cut(captions.trim_end(), room.columns));
    }
    for y in (0..height).step_by(2) {
        let mut line = Line::new(look.palette);
        for (number, sums) in shrunk.iter().enumerate() {
            if number > 0 {
                line.gap();
            }
            for x in 0..width {
                if look.palette == Palette::Characters {
                    line.character(sums.sum(x, y), sums.sum(x, y + 1), style.clip);
                    continue;
                }
                let upper = style.colour(sums.sum(x, y));
                // Below an odd number of rows there is no lower pixel.
                let lower = (y + 1 < height).then(|| style.colour(sums.sum(x, y + 1)));
                line.pixels(upper, lower);
            }
        }
        lines.push(line.end());
    }
    let mut said = milliseconds(frame.start_us, look.origin_us);
    let _ = write!(said, "  events {}", frame.events);
    if frame.decoded.is_some() {
        let _ = write!(said, "  decoded {}", frame.decoded_events);
    }
    if frame.skipped_us > 0 {
        let skipped = milliseconds(frame.skipped_us, 0);
        let _ = write!(said, "  after {skipped} without events");
    }
    lines.push(cut(&said, room.columns));
    lines
}

fn cut(text: &str, columns: usize) -> String {
    text.chars().take(columns).collect()
}

/// Characters of a line; the colours are written only where they change.
#[derive(Debug)]
struct Line {
    palette: Palette,
    text: String,
    upper: Option<Colour>,
    lower: Option<Colour>,
}

impl Line {
    const fn new(palette: Palette) -> Self {
        Self {
            palette,
            text: String::new(),
            upper: None,
            lower: None,
        }
    }

    /// Appends one character for the sum of two pixels, one below the other.
    fn character(&mut self, upper: i64, lower: i64, clip: u32) {
        let sum = upper + lower;
        let is_full = sum.unsigned_abs() >= u64::from(clip);
        self.text.push(match (sum.signum(), is_full) {
            (1, false) => '+',
            (1, true) => '#',
            (-1, false) => '-',
            (-1, true) => '=',
            _ => ' ',
        });
    }

    /// Switches back to the terminal's own colours.
    fn plain(&mut self) {
        if self.palette != Palette::Characters {
            self.text += PLAIN;
        }
        (self.upper, self.lower) = (None, None);
    }

    fn pixels(&mut self, upper: Colour, lower: Option<Colour>) {
        if lower.is_none() && self.lower.is_some() {
            self.plain();
        }
        if self.upper != Some(upper) {
            self.palette.select(upper, false, &mut self.text);
            self.upper = Some(upper);
        }
        if let Some(colour) = lower.filter(|_| self.lower != lower) {
            self.palette.select(colour, true, &mut self.text);
            self.lower = lower;
        }
        self.text.push(HALVES);
    }

    fn gap(&mut self) {
        self.plain();
        self.text.extend(std::iter::repeat_n(' ', BETWEEN));
    }

    fn end(mut self) -> String {
        self.plain();
        self.text
    }
}

/// How frames look in a terminal.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    /// sum| of the darkest colour if frames are not scaled down.
    pub clip: u32,
    /// Time that is shown as 0, in us of the recording.
    pub origin_us: u64,
    /// Colours of the terminal.
    pub palette: Palette,
}

/// A terminal in which each frame replaces the one before when it is due.
pub struct Terminal<W: Write> {
    out: W,
    look: Look,
    /// Returns the current size, since a terminal may be resized.
    room: Box<dyn FnMut() -> Room>,
    last_room: Option<Room>,
    pace: Pace,
    fps: u32,
    /// Last line of the frame that is shown.
    said: String,
    /// `None` if nobody can press any.
    keys: Option<Keys>,
    is_paused: bool,
    /// Whether a key asked for the next frame, which is shown at once then.
    is_asked: bool,
    stop: Arc<AtomicBool>,
}

impl<W: Write> Terminal<W> {
    /// Shows `fps` frames per second, unless `keys` ask for others; calls `room` before each.
    pub fn new(
        out: W,
        fps: u32,
        look: Look,
        room: Box<dyn FnMut() -> Room>,
        keys: Option<Keys>,
        stop: Arc<AtomicBool>,
    ) -> Self {
        Self {
            out,
            look,
            room,
            last_room: None,
            pace: Pace::new(fps),
            fps,
            said: String::new(),
            keys,
            is_paused: false,
            is_asked: false,
            stop,
        }
    }

    /// Waits for `time`, for a pause to end, or until `stop` is set. Returns what a key asks for in place of the frame
    /// that is waited for.
    fn wait(&mut self, time: Duration) -> Result<Option<Wish>> {
        let mut end = Instant::now() + time;
        while !self.stop.load(Ordering::Relaxed) {
            let left = end.saturating_duration_since(Instant::now());
            let nap = if self.is_paused { NAP } else { left.min(NAP) };
            // Keys are asked for at least once, however late the frame is.
            let key = match &mut self.keys {
                Some(keys) => keys.next(nap),
                None => {
                    std::thread::sleep(nap);
                    None
                }
            };
            let Some(key) = key else {
                if !self.is_paused && Instant::now() >= end {
                    break;
                }
                continue;
            };
            let by = |seconds: i64, way| {
                let slices = seconds * i64::from(self.fps);
                Wish::By(if way == Way::Back { -slices } else { slices })
            };
            let wish = match key {
                Key::Pause => {
                    self.is_paused = !self.is_paused;
                    self.pace.restart();
                    end = Instant::now();
                    let text = format!("\r{}{CLEAR_LINE}", self.status());
                    self.put(&text).context("stdout")?;
                    continue;
                }
                Key::Step => {
                    self.is_paused = true;
                    self.pace.restart();
                    break;
                }
                Key::Near(way) => by(1, way),
                Key::Far(way) => by(10, way),
                Key::Start => Wish::Start,
                Key::Quit => Wish::End,
            };
            self.is_asked = true;
            return Ok(Some(wish));
        }
        Ok(None)
    }

    /// The last line, and what keys do during a pause.
    fn status(&self) -> String {
        if !self.is_paused {
            return self.said.clone();
        }
        let columns = self.last_room.map_or(0, |room| room.columns);
        let keys =
            "  paused: space goes on, . steps, arrows go 1 or 10 s, home to the start, q ends";
        cut(&format!("{}{keys}", self.said), columns)
    }

    fn put(&mut self, text: &str) -> std::io::Result<()> {
        self.out.write_all(text.as_bytes())?;
        self.out.flush()
    }
}

impl<W: Write> Screen for Terminal<W> {
    fn show(&mut self, frame: &Frame) -> Result<Wish> {
        let is_asked = std::mem::take(&mut self.is_asked);
        if is_asked {
            self.pace.restart();
        } else {
            let (time, is_skipped) = match self.pace.turn(Instant::now()) {
                Turn::Skip => (Duration::ZERO, true),
                Turn::After(time) => (time, false),
            };
            if let Some(wish) = self.wait(time)? {
                return Ok(wish);
            }
            if is_skipped && !self.is_paused {
                return Ok(Wish::Next);
            }
        }
        let room = (self.room)();
        let mut text = String::new();
        if self.last_room.is_none() {
            text += HIDE_CURSOR;
        }
        if self.last_room.replace(room) != Some(room) {
            text += CLEAR;
        }
        text += HOME;
        let mut lines = lines(frame, room, self.look);
        self.said = lines.pop().unwrap_or_default();
        lines.push(self.status());
        // No line feed after the last line: it would scroll a full screen.
        text += &lines.join(&format!("{CLEAR_LINE}\n"));
        text += CLEAR_LINE;
        text += CLEAR_BELOW;
        self.put(&text).context("stdout")?;
        Ok(Wish::Next)
    }

    fn finish(self: Box<Self>) -> Result<()> {
        // Dropping restores the terminal.
        Ok(())
    }
}

impl<W: Write> Drop for Terminal<W> {
    fn drop(&mut self) {
        if self.last_room.is_some() {
            // If the terminal is gone, nothing needs to be restored.
            let _ = self.put(&format!("{PLAIN}{SHOW_CURSOR}\n"));
        }
    }
}

/// Frames written one below the other, each at once, for an output that is not a terminal.
#[derive(Debug)]
pub struct Text<W: Write> {
    out: W,
    look: Look,
    columns: usize,
}

impl<W: Write> Text<W> {
    /// Writes lines of at most `columns` characters.
    pub const fn new(out: W, look: Look, columns: usize) -> Self {
        Self { out, look, columns }
    }
}

impl<W: Write> Screen for Text<W> {
    fn show(&mut self, frame: &Frame) -> Result<Wish> {
        let room = Room {
            columns: self.columns,
            rows: None,
        };
        let lines = lines(frame, room, self.look);
        let text = lines.join("\n") + "\n";
        let written = self.out.write_all(text.as_bytes());
        written.and_then(|()| self.out.flush()).context("stdout")?;
        Ok(Wish::Next)
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Sensor;
    use event_pictures::frame_picture::FrameSums;
    use event_types::test_events::event;

    use super::*;

    const LOOK: Look = Look {
        clip: 4,
        origin_us: 1_000,
        palette: Palette::Bits24,
    };
    const ROOM: Room = Room {
        columns: 80,
        rows: Some(24),
    };

    fn frame(width: u16, height: u16, pixels: &[(u16, u16, bool)], two: bool) -> Frame {
        let sensor = Sensor::new(width, height).unwrap();
        let events: Vec<_> = pixels
            .iter()
            .map(|(x, y, on)| event(0, *x, *y, *on))
            .collect();
        Frame {
            start_us: 3_333,
            events: events.len() as u64,
            decoded_events: 0,
            original: FrameSums::new(sensor, &events),
            decoded: two.then(|| FrameSums::empty(sensor)),
            skipped_us: 0,
        }
    }

    /// Returns the characters that a terminal shows of a line.
    fn shown(line: &str) -> String {
        let mut parts = line.split('\x1b');
        let first = parts.next().unwrap().to_owned();
        let rest = parts.map(|part| part.split_once(['m', 'K', 'J', 'H', 'l', 'h']).unwrap().1);
        first + &rest.collect::<String>()
    }

    #[test]
    fn a_tiny_frame_is_shown_so() {
        let tiny = frame(2, 3, &[(0, 0, true), (1, 1, false), (1, 2, false)], false);
        let expected = [
            "\x1b[38;2;86;160;224m\x1b[48;2;255;255;255m\u{2580}\
             \x1b[38;2;255;255;255m\x1b[48;2;245;155;66m\u{2580}\x1b[0m",
            "\x1b[38;2;255;255;255m\u{2580}\x1b[38;2;245;155;66m\u{2580}\x1b[0m",
            "2.333 ms  events 3",
        ];
        assert_eq!(lines(&tiny, ROOM, LOOK), expected);
        let mut out = Vec::new();
        let stop = Arc::default();
        let room = || Box::new(|| ROOM);
        let mut screen = Box::new(Terminal::new(&mut out, 2, LOOK, room(), None, stop));
        screen.show(&tiny).unwrap();
        screen.show(&tiny).unwrap();
        screen.finish().unwrap();
        let once = format!("\x1b[H{}\x1b[K\x1b[J", expected.join("\x1b[K\n"));
        let all = format!("\x1b[?25l\x1b[2J{once}{once}\x1b[0m\x1b[?25h\n");
        assert_eq!(String::from_utf8(out).unwrap(), all);
    }

    #[test]
    fn where_there_are_no_colours_characters_tell() {
        let pixels = [
            (0, 0, true),
            (1, 1, false),
            (1, 2, false),
            (1, 2, false),
            (0, 2, true),
            (0, 2, true),
        ];
        let look = Look {
            clip: 2,
            palette: Palette::Characters,
            ..LOOK
        };
        let found = lines(&frame(2, 3, &pixels, false), ROOM, look);
        assert_eq!(found, ["+-", "#=", "2.333 ms  events 6"]);
        let look = Look {
            palette: Palette::Xterm256,
            ..LOOK
        };
        let found = lines(&frame(1, 1, &[(0, 0, true)], false), ROOM, look);
        assert_eq!(found[0], "\x1b[38;5;74m\u{2580}\x1b[0m");
    }

    #[test]
    fn frames_fit_the_room() {
        for (width, height, two) in [(1280, 720, true), (34, 34, true), (2048, 1, false)] {
            let frame = frame(width, height, &[(1, 0, true)], two);
            for (columns, rows) in [(80, 24), (1, 1), (10, 3), (237, 61)] {
                let room = Room {
                    columns,
                    rows: Some(rows),
                };
                let lines = lines(&frame, room, LOOK);
                let words = if two { 2 } else { 1 };
                assert!(lines.len() <= rows.max(words + 1), "{width} {rows}");
                // Three panels of one column each, with the gaps between them.
                let least = if two { 7 } else { 1 };
                for line in &lines {
                    let count = shown(line).chars().count();
                    assert!(count <= columns.max(least), "{width} {columns} {count}");
                }
            }
        }
    }

    #[test]
    fn scaling_down_sums() {
        let room = Room {
            columns: 2,
            rows: None,
        };
        // The left half sums to +2, the right half to 0.
        let pixels = [(0, 0, true), (1, 1, true), (2, 0, true), (3, 1, false)];
        let look = Look {
            clip: 1,
            origin_us: 0,
            ..LOOK
        };
        let lines = lines(&frame(4, 2, &pixels, false), room, look);
        let style = FrameStyle {
            clip: 2,
            upscale: 1,
        };
        let [r, g, b] = style.colour(2);
        let expected =
            format!("\x1b[38;2;{r};{g};{b}m\u{2580}\x1b[38;2;255;255;255m\u{2580}\x1b[0m");
        assert_eq!(lines, [expected.as_str(), "3."]);
    }

    #[test]
    fn a_reader_that_has_seen_enough_is_told_as_such() {
        struct Closed;
        impl Write for Closed {
            fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
                Err(std::io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let frame = frame(2, 2, &[], false);
        let error = Text::new(Closed, LOOK, 80).show(&frame).unwrap_err();
        let io = error.downcast_ref::<std::io::Error>().unwrap();
        assert_eq!(io.kind(), std::io::ErrorKind::BrokenPipe);
    }
}
