//! Counts of words that are no events, and of what was lost.

use event_files::Skipped;

macro_rules! counts {
    ($($(#[$doc:meta])* $kind:ident = $name:literal, $of:ident;)*) => {
        /// What is counted.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Count {
            $($(#[$doc])* $kind,)*
        }

        const NAMES: &[(&str, Of)] = &[$(($name, Of::$of),)*];
    };
}

/// Where a count is reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Of {
    /// A word that is no event.
    Word,
    /// A word that was left out.
    LostWord,
    /// Something lost or found wrong that is not a word by itself.
    Note,
}

counts! {
    /// A word of time.
    Times = "times", Word;
    /// The counter wrapped.
    Wraps = "wraps", Word;
    /// The counter was reset.
    Resets = "resets", Word;
    /// A row's address.
    Rows = "rows", Word;
    /// A column's address.
    Columns = "columns", Word;
    /// Addresses of two groups of 8 rows.
    Groups = "groups", Word;
    /// Pixels of a group that changed: events.
    Masks = "masks of events", Word;
    /// Edges and pulses at the input.
    Inputs = "external inputs", Word;
    /// Edges of the generator.
    Generator = "generator edges", Word;
    /// Samples of the inertial sensor.
    Imu = "inertial samples", Word;
    /// Starts and ends of frames, columns and exposures.
    Frames = "frame marks", Word;
    /// Pixels of frames.
    Samples = "frame samples", Word;
    /// Exposures and regions of interest.
    Exposures = "exposures and regions", Word;
    /// Words of 0 between others.
    Padding = "padding", Word;
    /// Codes that the device does not send.
    Unknown = "words the device does not send", LostWord;
    /// A row beyond the last.
    RowsOutside = "rows outside", LostWord;
    /// A column beyond the last.
    ColumnsOutside = "columns outside", LostWord;
    /// A group beyond the last.
    GroupsOutside = "groups outside", LostWord;
    /// A row, a column or an event before the first word of time.
    WithoutTime = "words without a time", LostWord;
    /// An event or a mask whose row or column is not known.
    WithoutPlace = "words without a row or column", LostWord;
    /// A column that cannot follow the one before it, or a frame that cannot follow.
    OutOfOrder = "columns out of order", LostWord;
    /// Events of a mask beyond the last row.
    EventsOutside = "events outside", Note;
    /// Time ran back by less than half a period.
    TimesBack = "times that ran back", Note;
    /// Time ran back by more.
    WrapsMissing = "wraps found missing", Note;
    /// A loss within an incomplete word.
    BytesIncomplete = "bytes of incomplete words", Note;
    /// Left out to come to the beginning of a word.
    BytesMisaligned = "bytes left out to realign", Note;
}

/// Counts by kind.
#[derive(Debug, Clone)]
pub struct Tally([u64; NAMES.len()]);

impl Tally {
    pub(super) const fn new() -> Self {
        Self([0; NAMES.len()])
    }

    /// Counts one of a kind.
    #[inline(always)]
    pub fn add(&mut self, count: Count) {
        self.add_many(count, 1);
    }

    /// Counts `n` of a kind.
    #[inline(always)]
    pub fn add_many(&mut self, count: Count, n: u64) {
        self.0[count as usize] += n;
    }

    pub(super) fn words(&self) -> Skipped {
        self.of(|of| of == Of::Word)
    }

    pub(super) fn losses(&self) -> Skipped {
        self.of(|of| of != Of::Word)
    }

    /// Words counted, whatever they were.
    pub(super) fn all_words(&self) -> u64 {
        let counts = self.0.iter().zip(NAMES);
        counts
            .map(|(n, (_, of))| if *of == Of::Note { 0 } else { *n })
            .sum()
    }

    /// Count of one kind.
    #[must_use]
    pub const fn get(&self, count: Count) -> u64 {
        self.0[count as usize]
    }

    fn of(&self, wanted: impl Fn(Of) -> bool) -> Skipped {
        let mut skipped = Skipped::default();
        for (n, (name, of)) in self.0.iter().zip(NAMES) {
            if wanted(*of) {
                skipped.add(name, *n);
            }
        }
        skipped
    }
}
