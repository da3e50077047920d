//! Sensors' names, and the Zenoh keys under which they publish.
//!
//! ```text
//! eecvs/NAME/frames     the sensor's frames of docs/wire-format.md, each with a [`crate::message::Stamp`]
//! eecvs/NAME/status     its report on itself, twice a second: [`crate::message::Status`]
//! eecvs/NAME/again      queried to have frames sent again: [`crate::message::Wish`]
//! eecvs/NAME/clock      queried for what its clock shows: [`crate::message::Time`]
//! eecvs/NAME/budget     a hub's limit on its rate: [`crate::message::Budget`]
//! eecvs/NAME/alive      a token that exists while the sensor is connected
//! ```
//!
//! A name may have several parts: `hall-2/door/left`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// First part of all keys.
pub const ROOT: &str = "eecvs";

/// Maximum length of a name in bytes.
pub const NAME_BYTES_MAX: usize = 128;

/// A valid name of a sensor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

/// Error: a text is not a valid name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is not a valid name: use letters, digits, - and _ in parts between single slashes, at most 128 bytes"
)]
pub struct BadName(String);

impl Name {
    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the sensor's key for a kind of message.
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
        // The error quotes no more text than a name may have.
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

/// Kinds of messages under a sensor's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Frames, as they are made.
    Frames,
    /// The sensor's reports on itself.
    Status,
    /// Frames that are sent again on request.
    Again,
    /// What the sensor's clock shows, on request.
    Clock,
    /// A hub's limits on the sensor's rate.
    Budget,
    /// Token that exists while the sensor is connected.
    Alive,
}

impl Kind {
    /// Returns the last part of this kind's keys.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Frames => "frames",
            Self::Status => "status",
            Self::Again => "again",
            Self::Clock => "clock",
            Self::Budget => "budget",
            Self::Alive => "alive",
        }
    }

    /// Returns the key expression for all sensors whose names match: `**` for every name, `hall-2/**` for those in
    /// a hall.
    #[must_use]
    pub fn of_all(self, names: &str) -> String {
        format!("{ROOT}/{names}/{}", self.word())
    }
}

/// Returns the sensor's name in a key of this kind, or `None` if the key is not one of this kind.
#[must_use]
pub fn name_of(key: &str, kind: Kind) -> Option<Name> {
    let name = key.strip_prefix(ROOT)?.strip_prefix('/')?;
    name.strip_suffix(kind.word())?
        .strip_suffix('/')?
        .parse()
        .ok()
}

/// Checks a pattern of names and returns it: a name in which `*` may stand for a part, and `**` for any number of
/// parts.
///
/// # Errors
/// [`BadName`] if the text is not such a pattern.
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
                Kind::Clock,
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
