//! What a reader found beside events, for every command to show.

use std::collections::BTreeMap;

use crate::EventReader;

/// What was taken to be so, and what was no event or was left out.
/// The fields are the keys of a command's JSON.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Findings {
    /// What the file does not state, or states otherwise than it was read: what, as what, and why.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty"))]
    pub assumptions: Vec<String>,
    /// Items that are no events, or were left out, by their kind.
    pub skipped: BTreeMap<String, u64>,
}

impl Findings {
    /// Of all that was read so far: some show only on the way.
    #[must_use]
    pub fn of(reader: &dyn EventReader) -> Self {
        let taken = reader.assumptions().iter();
        let skipped = reader.skipped().iter();
        Self {
            assumptions: taken.map(ToString::to_string).collect(),
            skipped: skipped.map(|(kind, n)| (kind.to_owned(), n)).collect(),
        }
    }

    /// A row of a table for each: its name and its value.
    pub fn rows(&self) -> impl Iterator<Item = (&'static str, String)> {
        let taken = self.assumptions.iter();
        let skipped = self.skipped.iter();
        taken
            .map(|taken| ("taken for", taken.clone()))
            .chain(skipped.map(|(kind, count)| ("skipped", format!("{count} {kind}"))))
    }
}
