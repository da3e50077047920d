//! What a reader found besides events, in the form in which every command shows it.

use std::collections::BTreeMap;

use crate::EventReader;

/// What a reader assumed, and what it skipped because it was not an event or not a valid one. The fields are the
/// keys of a command's JSON.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Findings {
    /// What the file does not state, or states otherwise than it was read: what, as what, and why.
    #[cfg_attr(feature = "serde", serde(skip_serializing_if = "Vec::is_empty"))]
    pub assumptions: Vec<String>,
    /// Number of items that are not events, or that were left out, by kind.
    pub skipped: BTreeMap<String, u64>,
}

impl Findings {
    /// Collects the findings from everything that `reader` has read so far: some appear only while reading.
    #[must_use]
    pub fn of(reader: &dyn EventReader) -> Self {
        let taken = reader.assumptions().iter();
        let skipped = reader.skipped().iter();
        Self {
            assumptions: taken.map(ToString::to_string).collect(),
            skipped: skipped.map(|(kind, n)| (kind.to_owned(), n)).collect(),
        }
    }

    /// Returns a table row, name and value, for each finding.
    pub fn rows(&self) -> impl Iterator<Item = (&'static str, String)> {
        let taken = self.assumptions.iter();
        let skipped = self.skipped.iter();
        taken
            .map(|taken| ("taken for", taken.clone()))
            .chain(skipped.map(|(kind, count)| ("skipped", format!("{count} {kind}"))))
    }
}
