//! Frames that the next picture of a sensor is made of.

use std::sync::Arc;

use eecvs_nostd::Header;

/// Bytes of a sensor's frames, at the most.
pub const KEPT_BYTES_MAX: usize = 4 << 20;

/// Frames one after the other, of which the first decodes by itself.
#[derive(Debug, Default)]
struct Chain {
    frames: Vec<Arc<[u8]>>,
    bytes: usize,
    /// Windows with events that it has whole.
    windows: u64,
}

/// From a frame on that decodes by itself, so that there is a whole window.
#[derive(Debug, Default)]
pub struct Kept {
    now: Chain,
    /// Until `now` has a window: the chain before.
    before: Chain,
    /// Number of the frame that goes on from the last one; none where the next one has to decode by itself.
    next: Option<u64>,
    /// Counts whole windows.
    windows: u64,
}

impl Kept {
    /// Takes a frame that has come in its turn, or leaves it.
    pub fn take(&mut self, number: u64, header: &Header, frame: &[u8]) {
        if header.is_key && header.part == 0 {
            let was = std::mem::take(&mut self.now);
            if was.windows > 0 {
                self.before = was;
            }
        } else if self.next != Some(number) {
            self.next = None;
            return;
        }
        if self.now.bytes + self.before.bytes + frame.len() > KEPT_BYTES_MAX
            && self.now.windows == 0
        {
            self.before = Chain::default();
        }
        if self.now.bytes + frame.len() > KEPT_BYTES_MAX {
            // Where it has a window, that is shown until the next frame that decodes by itself.
            if self.now.windows == 0 {
                self.now = Chain::default();
            }
            self.next = None;
            return;
        }
        self.now.frames.push(frame.into());
        self.now.bytes += frame.len();
        self.next = number.checked_add(1);
        if header.last && header.window_events > 0 {
            self.now.windows += 1;
            self.windows += 1;
            self.before = Chain::default();
        }
    }

    /// Forgets all frames.
    pub fn clear(&mut self) {
        *self = Self {
            windows: self.windows,
            ..Self::default()
        };
    }

    /// Tells pictures apart; none without a whole window.
    #[must_use]
    pub fn picture(&self) -> Option<u64> {
        (self.now.windows + self.before.windows > 0).then_some(self.windows)
    }

    /// The frames to decode, the oldest first.
    #[must_use]
    pub fn frames(&self) -> Vec<Arc<[u8]>> {
        let chain = if self.now.windows > 0 {
            &self.now
        } else {
            &self.before
        };
        chain.frames.clone()
    }

    /// Bytes held.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.now.bytes + self.before.bytes
    }
}
