//! Sensors' names, and the keys under which they speak.
//!
//! ```text
//! eecvs/NAME/frames   what a sensor sends: frames of docs/wire-format.md, each with a [`crate::message::Stamp`]
//! eecvs/NAME/status   what it says of itself, twice a second: [`crate::message::Status`]
//! eecvs/NAME/again    whom to ask for frames once more: [`crate::message::Wish`]
//! eecvs/NAME/budget   what it is allowed: [`crate::message::Budget`]
//! eecvs/NAME/alive    a token that is there while the sensor is connected
//! ```
//!
//! A name may have several parts: `hall-2/door/left`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// What all keys begin with.
pub const ROOT: &str = "eecvs";

/// Bytes of a name, at the most.
pub const NAME_BYTES_MAX: usize = 128;

/// What a sensor is called.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

/// A text that is no sensor's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no name: letters, digits, - and _, in parts between single slashes, 128 bytes at the most"
)]
pub struct BadName(String);

impl Name {
    /// The name itself.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The key of what it says of a kind.
    #[must_use]
    pub fn key(&self, kind: Kind) -> String {
        format!("{ROOT}/{}/{}", self.0, kind.word())
    }
}

impl FromStr for Name {
    type Err = BadName;

    fn from_str(text: &str) -> Result<Self, BadName> {
        let is_part = |part: &str| {
            let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            !part.is_empty() && part.chars().all(good)
        };
        if text.len() <= NAME_BYTES_MAX && text.split('/').all(is_part) {
            return Ok(Self(text.to_owned()));
        }
        // What is told is no longer than what might have been one.
        Err(BadName(text.chars().take(NAME_BYTES_MAX).collect()))
    }
}

impl TryFrom<String> for Name {
    type Error = BadName;

    fn try_from(text: String) -> Result<Self, BadName> {
        text.parse()
    }
}

impl From<Name> for String {
    fn from(name: Name) -> Self {
        name.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

/// Kinds of what is said under a sensor's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Frames, as they are made.
    Frames,
    /// What the sensor says of itself.
    Status,
    /// Frames that are asked for once more.
    Again,
    /// What it is allowed.
    Budget,
    /// Whether it is connected.
    Alive,
}

impl Kind {
    /// The last part of its keys.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Status => "status",
            Self::Again => "again",
            Self::Budget => "budget",
            Self::Alive => "alive",
        }
    }

    /// The keys of all sensors whose names match: `**` is every name, `hall-2/**` those of a hall.
    #[must_use]
    pub fn of_all(self, names: &str) -> String {
        format!("{ROOT}/{names}/{}", self.word())
    }
}

/// The sensor that a key of a kind belongs to.
#[must_use]
pub fn name_of(key: &str, kind: Kind) -> Option<Name> {
    let name = key.strip_prefix(ROOT)?.strip_prefix('/')?;
    name.strip_suffix(kind.word())?
        .strip_suffix('/')?
        .parse()
        .ok()
}

/// Names that are meant: a name, or one with `*` for a part and `**` for any number of them.
///
/// # Errors
/// [`BadName`].
pub fn names(text: &str) -> Result<String, BadName> {
    let parts = text
        .split('/')
        .filter(|part| !matches!(*part, "*" | "**"))
        .all(|part| part.parse::<Name>().is_ok());
    if text.len() <= NAME_BYTES_MAX && parts && !text.is_empty() {
        return Ok(text.to_owned());
    }
    Err(BadName(text.chars().take(NAME_BYTES_MAX).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_and_names_belong_together() {
        let long = "a/".repeat(63) + "ab";
        for text in ["cam", "hall-2/door/left", "A_1", long.as_str()] {
            let name: Name = text.parse().unwrap();
            for kind in [
                Kind::Frames,
                Kind::Status,
                Kind::Again,
                Kind::Budget,
                Kind::Alive,
            ] {
                let key = name.key(kind);
                assert_eq!(name_of(&key, kind), Some(name.clone()), "{key}");
            }
            assert_eq!(name_of(&name.key(Kind::Frames), Kind::Status), None);
        }
        assert_eq!(Kind::Frames.of_all("hall-2/**"), "eecvs/hall-2/**/frames");
    }

    #[test]
    fn what_is_no_name_is_refused() {
        let long = "a".repeat(129);
        for text in [
            "",
            "/",
            "a/",
            "/a",
            "a//b",
            "a b",
            "*",
            "a/**",
            "ä",
            "@a",
            "a$b",
            long.as_str(),
        ] {
            assert!(text.parse::<Name>().is_err(), "{text}");
        }
        for key in [
            "eecvs/frames",
            "eecvs//frames",
            "other/a/frames",
            "eecvs/a/status",
            "eecvs",
        ] {
            assert_eq!(name_of(key, Kind::Frames), None, "{key}");
        }
        for good in ["**", "a", "a/*/b", "hall/**"] {
            assert!(names(good).is_ok(), "{good}");
        }
        for bad in ["", "a//b", "a*", "$*", "a/ /b"] {
            assert!(names(bad).is_err(), "{bad}");
        }
    }
}
