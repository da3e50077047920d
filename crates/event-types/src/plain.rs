//! Text from outside, such as names of files and messages of devices, made harmless for a terminal.
//!
//! What a terminal acts on is written as its number instead: control characters, among them those that begin escape
//! sequences, and characters that change the direction of the text or end a line.

use std::borrow::Cow;
use std::fmt::Write;

/// Returns whether a terminal may act on a character, or show the text around it in another order.
const fn is_harmful(c: char) -> bool {
    matches!(c,
        '\0'..='\x1f'
        | '\x7f'..='\u{9f}'
        | '\u{61c}'
        | '\u{200e}'..='\u{200f}'
        | '\u{2028}'..='\u{202e}'
        | '\u{2066}'..='\u{2069}')
}

/// Returns one line: `\u{1b}` for an escape character, `\n` for a newline.
#[must_use]
pub fn line(text: &str) -> Cow<'_, str> {
    escaped(text, is_harmful, rust)
}

/// Returns text of several lines: like [`line()`], but newlines and tabs stay.
#[must_use]
pub fn lines(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_harmful(c) && c != '\n' && c != '\t', rust)
}

/// Returns JSON with the same content, in which newlines between values stay.
#[must_use]
pub fn json(text: &str) -> Cow<'_, str> {
    // Only strings can have other ones, where this is an escape of JSON; all of them have four digits.
    escaped(
        text,
        |c| is_harmful(c) && c != '\n',
        |c, out| {
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        },
    )
}

fn rust(c: char, out: &mut String) {
    out.extend(c.escape_default());
}

fn escaped(
    text: &str,
    is_escaped: impl Fn(char) -> bool,
    put: impl Fn(char, &mut String),
) -> Cow<'_, str> {
    if !text.chars().any(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_escaped(c) {
            true => put(c, &mut out),
            false => out.push(c),
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_acts_on_nothing() {
        for (text, want) in [
            ("a.raw", "a.raw"),
            ("Grüße, 事件 👋", "Grüße, 事件 👋"),
            ("a\x1b[2Jb", "a\\u{1b}[2Jb"),
            ("a\nb\tc\r", "a\\nb\\tc\\r"),
            ("\u{9b}2J\x7f", "\\u{9b}2J\\u{7f}"),
            ("a\u{202e}war.", "a\\u{202e}war."),
            ("\u{2066}x\u{2069}\u{2028}", "\\u{2066}x\\u{2069}\\u{2028}"),
        ] {
            assert_eq!(line(text), want);
            assert!(!line(text).chars().any(is_harmful));
        }
        assert_eq!(lines("a\n\tb\x1b\n"), "a\n\tb\\u{1b}\n");
    }

    #[test]
    fn json_stays_the_same_value() {
        let text = "{\"a\u{9b}\u{202e}\": \"\u{7f}\"}\n";
        assert_eq!(json(text), "{\"a\\u009b\\u202e\": \"\\u007f\"}\n");
    }
}
