//! Counts of words that are not events, and of losses.

use event_files::Skipped;

macro_rules! counts {
    ($($(#[$doc:meta])* $kind:ident = $name:literal, $of:ident;)*) => {
        /// Kinds of words and losses that are counted.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Count {
            $($(#[$doc])* $kind,)*
        }

        const NAMES: &[(&str, Of)] = &[$(($name, Of::$of),)*];
    };
}

/// How a count is reported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Of {
    /// As a word that is not an event.
    Word,
    /// As a lost word.
    LostWord,
    /// As a loss or error that is not a word by itself.
    Note,
}

counts! {
    /// A time word.
    Times = "times", Word;
    /// The counter wrapped.
    Wraps = "wraps", Word;
    /// The counter was reset.
    Resets = "resets", Word;
    /// The address of a row.
    Rows = "rows", Word;
    /// The address of a column.
    Columns = "columns", Word;
    /// The addresses of two groups of 8 rows.
    Groups = "groups", Word;
    /// The pixels of a group that changed: events.
    Masks = "masks of events", Word;
    /// Edges and pulses at the external input.
    Inputs = "external inputs", Word;
    /// Edges of the signal generator.
    Generator = "generator edges", Word;
    /// Samples of the inertial sensor.
    Imu = "inertial samples", Word;
    /// Starts and ends of frames, columns and exposures.
    Frames = "frame marks", Word;
    /// Pixels of frames.
    Samples = "frame samples", Word;
    /// Exposures and regions of interest.
    Exposures = "exposures and regions", Word;
    /// Zero words between others.
    Padding = "padding", Word;
    /// A code that the device does not send.
    Unknown = "words the device does not send", LostWord;
    /// A row beyond the last.
    RowsOutside = "rows outside", LostWord;
    /// A column beyond the last.
    ColumnsOutside = "columns outside", LostWord;
    /// A group beyond the last.
    GroupsOutside = "groups outside", LostWord;
    /// A row, a column or an event before the first time word.
    WithoutTime = "words without a time", LostWord;
    /// An event or a mask whose row or column is unknown.
    WithoutPlace = "words without a row or column", LostWord;
    /// A column or a frame that cannot follow the one before it.
    OutOfOrder = "columns out of order", LostWord;
    /// Events of a mask beyond the last row.
    EventsOutside = "events outside", Note;
    /// Time ran back by at most half a period.
    TimesBack = "times that ran back", Note;
    /// Time ran back by more than half a period.
    WrapsMissing = "wraps found missing", Note;
    /// Bytes of a word that a loss cut off.
    BytesIncomplete = "bytes of incomplete words", Note;
    /// Bytes skipped to reach the beginning of a word.
    BytesMisaligned = "bytes left out to realign", Note;
}

/// Counters by kind.
#[derive(Debug, Clone)]
pub struct Tally([u64; NAMES.len()]);

impl Tally {
    pub(super) const fn new() -> Self {
        Self([0; NAMES.len()])
    }

    /// Adds 1 to a counter.
    #[inline(always)]
    pub fn add(&mut self, count: Count) {
        self.add_many(count, 1);
    }

    /// Adds `n` to a counter.
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

    /// Returns the number of words counted, of whatever kind.
    pub(super) fn all_words(&self) -> u64 {
        let counts = self.0.iter().zip(NAMES);
        counts
            .map(|(n, (_, of))| if *of == Of::Note { 0 } else { *n })
            .sum()
    }

    /// Returns the count of one kind.
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
