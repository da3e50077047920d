//! The frames from which a sensor's next picture is made.

use std::sync::Arc;

use eecvs_nostd::Header;

/// Maximum bytes of a sensor's frames.
pub const KEPT_BYTES_MAX: usize = 4 << 20;

/// Consecutive frames that begin with a key frame, which decodes on its own.
#[derive(Debug, Default)]
struct Chain {
    frames: Vec<Arc<[u8]>>,
    bytes: usize,
    /// Number of whole windows with events in the chain.
    windows: u64,
}

/// The frames since a key frame, enough of them for a whole window.
#[derive(Debug, Default)]
pub struct Kept {
    now: Chain,
    /// The previous chain, kept until `now` contains a window.
    before: Chain,
    /// Number of the frame that follows the last one; `None` if a key frame has to come next.
    next: Option<u64>,
    /// Number of whole windows so far.
    windows: u64,
}

impl Kept {
    /// Adds a frame that arrived in order, or ignores it if it does not continue the chain.
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
            // If there is a window, it is shown until the next key frame.
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

    /// Forgets all frames; the count of windows goes on, so that pictures stay distinguishable.
    pub fn clear(&mut self) {
        *self = Self {
            windows: self.windows,
            ..Self::default()
        };
    }

    /// Returns a number that identifies the picture; `None` if there is no whole window.
    #[must_use]
    pub fn picture(&self) -> Option<u64> {
        (self.now.windows + self.before.windows > 0).then_some(self.windows)
    }

    /// Returns the frames to decode, the oldest first.
    #[must_use]
    pub fn frames(&self) -> Vec<Arc<[u8]>> {
        let chain = if self.now.windows > 0 {
            &self.now
        } else {
            &self.before
        };
        chain.frames.clone()
    }

    /// Returns the bytes of the frames held.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.now.bytes + self.before.bytes
    }
}
