//! The fewest bits of each representation at errors that are asked for, over all settings measured.
//!
//! The largest error of a coefficient is not comparable across transforms, and the mean errors of Table I belong to
//! different bits. What can be compared is the fewest bits within an error of times, or of the smoothed volume.

use super::Results;
use super::claims::{FIXED, family, median};
use super::quality::Quality;

/// An error that is asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Asked {
    /// `emd_pixel`, in us.
    TimesUs(u32),
    /// Of the smoothed volume: [`crate::selection::errors`].
    Volume(f64),
}

/// The errors in the tables, from fine to coarse.
pub const ASKED: [Asked; 9] = [
    Asked::TimesUs(32),
    Asked::TimesUs(128),
    Asked::TimesUs(512),
    Asked::TimesUs(1024),
    Asked::TimesUs(2048),
    Asked::TimesUs(4096),
    Asked::Volume(0.01),
    Asked::Volume(0.1),
    Asked::Volume(0.5),
];

/// Representations in the columns, see [`family`].
pub const COMPARED: [&str; 9] = [
    "dct", "dtft", "dwt", "auto", "events", "best", "ces", "tore", "voxel",
];

impl Asked {
    /// Returns the row's heading.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::TimesUs(us) => format!("emd_pixel, {us} us"),
            Self::Volume(most) => format!("volume, {most}"),
        }
    }

    fn holds(self, row: &Quality) -> bool {
        match self {
            Self::TimesUs(us) => row.emd_pixel_us <= f64::from(us),
            Self::Volume(most) => row.volume_error <= most,
        }
    }
}

impl Results {
    /// Returns the fewest bits per event, packed, of a representation's settings that are within an error on a source;
    /// `None` if no setting is.
    #[must_use]
    pub fn fewest_bits(
        &self,
        set: &str,
        source: &str,
        representation: &str,
        asked: Asked,
    ) -> Option<f64> {
        self.quality
            .iter()
            .filter(|row| {
                (row.set.as_str(), row.source.as_str()) == (set, source)
                    && family(&row.method) == representation
                    && asked.holds(row)
            })
            .map(|row| row.packed_bits_per_event)
            .min_by(f64::total_cmp)
    }

    /// Compares a representation with the fixed transforms, over all sources of a set and all errors where both have a
    /// setting: returns in how many cases it takes fewer bits than each of them, and the number of cases.
    #[must_use]
    pub fn beats_fixed(&self, set: &str, representation: &str) -> (usize, usize) {
        let (mut wins, mut cases) = (0, 0);
        for source in self.sources(set) {
            for asked in ASKED {
                let bits = |name: &str| self.fewest_bits(set, source, name, asked);
                let fixed = FIXED.into_iter().filter_map(bits).min_by(f64::total_cmp);
                if let (Some(own), Some(fixed)) = (bits(representation), fixed) {
                    cases += 1;
                    wins += usize::from(own < fixed);
                }
            }
        }
        (wins, cases)
    }

    /// Returns the median of [`Self::fewest_bits`] over the sources of a set that have such settings, and their number.
    #[must_use]
    pub fn fewest_bits_median(
        &self,
        set: &str,
        representation: &str,
        asked: Asked,
    ) -> (Option<f64>, usize) {
        let sources = self.sources(set).into_iter();
        let bits: Vec<f64> = sources
            .filter_map(|source| self.fewest_bits(set, source, representation, asked))
            .collect();
        let count = bits.len();
        (median(bits), count)
    }
}
