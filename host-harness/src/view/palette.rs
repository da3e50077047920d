//! Colours that a terminal can show, and the environment variables that select them.

use std::fmt::Write as _;

use event_pictures::picture::Colour;

/// Colours of a terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Palette {
    /// 24-bit colours
    #[value(name = "24bit")]
    Bits24,
    /// The nearest of xterm's 256 colours
    #[value(name = "256")]
    Xterm256,
    /// No colours: + and # are ON, - and = are OFF; # and = from --clip on
    #[value(name = "none")]
    Characters,
}

impl Palette {
    /// Chooses by the variables of a terminal: no colours for `NO_COLOR` or a `TERM` that has none (see
    /// [`is_dumb`]; `vt100` and the like), 24 bits for a `COLORTERM` or a `TERM` that names them, else 256 colours.
    #[must_use]
    pub fn of_terminal(variable: impl Fn(&str) -> Option<String>) -> Self {
        let is_set = |name| variable(name).is_some_and(|value| !value.is_empty());
        let term = variable("TERM").unwrap_or_default();
        let has_none = ["vt1", "vt2", "vt5"].iter().any(|vt| term.starts_with(vt));
        if is_set("NO_COLOR") || is_dumb(&variable) || has_none {
            return Self::Characters;
        }
        let colours = variable("COLORTERM").unwrap_or_default();
        let names_bits = term.ends_with("-direct") || term.ends_with("-truecolor");
        if matches!(colours.as_str(), "truecolor" | "24bit") || names_bits {
            return Self::Bits24;
        }
        Self::Xterm256
    }

    /// Appends the escape sequence that sets the colour of the characters that follow, or of their background if
    /// `behind`.
    pub(super) fn select(self, colour: Colour, behind: bool, text: &mut String) {
        let layer = if behind { 48 } else { 38 };
        let [r, g, b] = colour;
        let _ = match self {
            Self::Bits24 => write!(text, "\x1b[{layer};2;{r};{g};{b}m"),
            Self::Xterm256 => write!(text, "\x1b[{layer};5;{}m", nearest(colour)),
            Self::Characters => Ok(()),
        };
    }
}

/// Returns whether a terminal only prints lines, one below the other: its `TERM` is `dumb` or missing.
#[must_use]
pub fn is_dumb(variable: impl Fn(&str) -> Option<String>) -> bool {
    let term = variable("TERM").unwrap_or_default();
    ["", "dumb", "unknown"].contains(&term.as_str())
}

/// Levels per channel of the 6 x 6 x 6 colour cube that begins at index 16.
const LEVELS: [u8; 6] = [0, 95, 135, 175, 215, 255];

/// Returns the index of the nearest of xterm's colours from 16 on: the cube and the 24 greys 8, 18, ..., 238.
fn nearest(colour: Colour) -> u8 {
    let distance = |other: Colour| -> u32 {
        let parts = colour.iter().zip(other);
        parts.map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
    };
    let level = |part: u8| {
        let levels = (0..6_u8).zip(LEVELS);
        let nearest = levels.min_by_key(|(_, level)| part.abs_diff(*level));
        nearest.unwrap_or((0, 0))
    };
    let [(r, red), (g, green), (b, blue)] = colour.map(level);
    let grey = (0..24_u8).map(|step| (232 + step, 8 + 10 * step));
    let of_cube = (16 + 36 * r + 6 * g + b, distance([red, green, blue]));
    let of_greys = grey.map(|(number, grey)| (number, distance([grey; 3])));
    let nearest = std::iter::once(of_cube).chain(of_greys);
    nearest
        .min_by_key(|(_, distance)| *distance)
        .map_or(16, |(number, _)| number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variables_tell_what_is_wanted() {
        for (variables, palette) in [
            (
                &[("TERM", "xterm-256color"), ("COLORTERM", "truecolor")][..],
                Palette::Bits24,
            ),
            (&[("TERM", "xterm-direct")], Palette::Bits24),
            (&[("TERM", "xterm-256color")], Palette::Xterm256),
            (&[("TERM", "linux"), ("NO_COLOR", "")], Palette::Xterm256),
            (
                &[("TERM", "xterm"), ("COLORTERM", "24bit"), ("NO_COLOR", "1")],
                Palette::Characters,
            ),
            (
                &[("TERM", "dumb"), ("COLORTERM", "truecolor")],
                Palette::Characters,
            ),
            (
                &[("TERM", "vt100"), ("COLORTERM", "truecolor")],
                Palette::Characters,
            ),
            (&[("TERM", "screen-256color")], Palette::Xterm256),
            (&[], Palette::Characters),
        ] {
            let value = |name: &str| {
                let mut found = variables.iter().filter(|(known, _)| *known == name);
                found.next().map(|(_, value)| (*value).to_owned())
            };
            assert_eq!(Palette::of_terminal(value), palette, "{variables:?}");
            let term = variables.iter().find(|(name, _)| *name == "TERM");
            let dumb = term.is_none_or(|(_, term)| *term == "dumb");
            assert_eq!(is_dumb(value), dumb, "{variables:?}");
        }
    }

    #[test]
    fn colours_are_the_nearest_of_256() {
        for (colour, number) in [
            ([0, 0, 0], 16),
            ([255, 255, 255], 231),
            ([255, 0, 0], 196),
            ([86, 160, 224], 74),
            ([245, 155, 66], 209),
            ([128, 128, 128], 244),
        ] {
            assert_eq!(nearest(colour), number, "{colour:?}");
        }
    }
}
