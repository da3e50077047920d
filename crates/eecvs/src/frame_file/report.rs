//! What a reader of frames found damaged, lost or out of order.

use serde::Serialize;

use crate::reconstruct::hybrid::Refused;

/// Report of a reader: frames delivered, damage, losses and frames out of order.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct LinkReport {
    /// Frames delivered.
    pub frames: u64,
    /// Bytes that do not belong to any frame.
    pub damaged_bytes: u64,
    /// Runs of consecutive damaged bytes.
    pub damaged_runs: u64,
    /// Offset of the first damaged byte, and the reason why no frame begins there.
    pub first_damage: Option<(u64, String)>,
    /// Frames that never arrived.
    pub frames_lost: u64,
    /// Frames sent before the first one that arrived, by its sequence number: a reader that joins a running stream
    /// has missed them.
    pub frames_before: u64,
    /// Frames that arrived twice; the second copy was skipped.
    pub frames_repeated: u64,
    /// Frames that arrived after a later one; they are delivered in the order of arrival.
    pub frames_reordered: u64,
    /// Times that the sequence numbers started again, because files were concatenated or an encoder was restarted.
    /// No frame is skipped there.
    pub restarts: u64,
    /// Frames whose checksums match but whose payload contradicts its header.
    pub frames_malformed: u64,
    /// Undamaged frames that depend on a missing frame, up to the next key frame.
    pub frames_dependent: u64,
    /// Undamaged frames of windows with more events than the decoder accepts.
    pub frames_crowded: u64,
    /// Undamaged frames for whose decoding the system refused memory.
    pub frames_without_memory: u64,
    /// Segments whose end mark is that of their frames: counts, hash and index.
    pub segments_ended: u64,
    /// Segments whose end mark is another one: frames are missing, or the mark is wrong.
    pub segments_different: u64,
    /// Segments that begin with a mark and have no end mark: their writer was stopped, or their end is missing.
    pub segments_cut_short: u64,
    /// Frames in no segment: of streams, and of writers without marks. Whether others are missing behind them is not
    /// known.
    pub frames_unmarked: u64,
    /// Offset of the first frame of another sensor, and the size of that sensor. Nothing from there on was used.
    pub other_sensor: Option<(u64, String)>,
}

impl LinkReport {
    /// Returns whether nothing was damaged, lost, repeated or out of order.
    #[must_use]
    pub fn is_clean(&self) -> bool {
        *self
            == Self {
                frames: self.frames,
                segments_ended: self.segments_ended,
                frames_unmarked: self.frames_unmarked,
                ..Self::default()
            }
    }

    /// Returns whether anything is missing. Frames that are repeated or out of order and concatenated files are no
    /// loss.
    #[must_use]
    pub const fn has_loss(&self) -> bool {
        let missing = self.damaged_bytes
            + self.frames_lost
            + self.frames_malformed
            + self.frames_dependent
            + self.frames_crowded
            + self.frames_without_memory
            + self.segments_different
            + self.segments_cut_short;
        missing > 0 || self.other_sensor.is_some()
    }

    /// Counts a frame whose payload does not decode.
    pub const fn count_refused(&mut self, refused: Refused) {
        match refused {
            Refused::Malformed => self.frames_malformed += 1,
            Refused::Dependent => self.frames_dependent += 1,
            Refused::Crowded => self.frames_crowded += 1,
            Refused::Memory => self.frames_without_memory += 1,
        }
    }

    /// Returns one line that says why there is no frame in what was read.
    #[must_use]
    pub const fn why_empty(&self) -> &'static str {
        if self.damaged_bytes == 0 && self.segments_cut_short > 0 {
            "no frame: its writer was stopped before the first one, or all of them are missing"
        } else {
            "no frame found; is it a file that `eecvs encode` wrote?"
        }
    }

    /// Returns one line that describes the damage and losses, or `None` for a clean stream.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        if self.is_clean() {
            return None;
        }
        let mut met = Vec::new();
        if let Some((offset, why)) = &self.first_damage {
            met.push(format!(
                "{} damaged bytes in {} places, the first at byte {offset}: {why}",
                self.damaged_bytes, self.damaged_runs
            ));
        }
        for (frames, what) in [
            (self.frames_before, "missing before the first one"),
            (self.frames_lost, "lost"),
            (self.frames_repeated, "repeated"),
            (self.frames_reordered, "out of order"),
            (self.frames_malformed, "malformed"),
            (self.frames_dependent, "that depend on missing ones"),
            (
                self.frames_crowded,
                "with more events than a sensor sends or --max-events-per-window allows",
            ),
            (self.frames_without_memory, "without memory to decode them"),
        ] {
            if frames > 0 {
                met.push(format!("frames {what}: {frames}"));
            }
        }
        if self.restarts > 0 {
            met.push(format!("restarts of the numbering: {}", self.restarts));
        }
        for (segments, what) in [
            (
                self.segments_cut_short,
                "without an end mark, so that frames may be missing at the end: their writer was stopped, or the end was cut off",
            ),
            (
                self.segments_different,
                "whose end mark does not fit their frames",
            ),
        ] {
            if segments > 0 {
                met.push(format!("segments {what}: {segments}"));
            }
        }
        let Some((offset, sensor)) = &self.other_sensor else {
            return Some(format!("{}; everything else was used", met.join("; ")));
        };
        met.push(format!(
            "frames of another sensor ({sensor}) begin at byte {offset}: everything before was \
             used; `eecvs split` separates them"
        ));
        Some(met.join("; "))
    }
}
