//! When the dense coder begins anew with a key frame.

/// Default spacing of key frames in windows.
pub const KEY_WINDOWS: u16 = 128;
/// Number of events after which the next window begins with a key frame, however few windows they came in, so that
/// what a host has to encode in one go stays bounded.
pub const KEY_EVENTS: u32 = 1 << 20;

/// Counts windows and events since the last key frame that was due.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Chain {
    windows: u16,
    events: u32,
}

impl Chain {
    /// State before the first window, which begins with a key frame.
    pub const START: Self = Self {
        windows: 0,
        events: 0,
    };

    /// Counts a window of `events` events. Returns whether the window begins with a key frame.
    ///
    /// The spacing `key_windows` is in windows; 0 acts as 1.
    pub const fn next(&mut self, events: u32, key_windows: u16) -> bool {
        let is_key = self.windows == 0 || self.windows >= key_windows || self.events >= KEY_EVENTS;
        if is_key {
            *self = Self::START;
        }
        self.windows = self.windows.saturating_add(1);
        self.events = self.events.saturating_add(events);
        is_key
    }

    /// Returns whether the next window will begin with a key frame.
    #[must_use]
    pub const fn ends(self, key_windows: u16) -> bool {
        let mut after = self;
        after.next(0, key_windows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_comes_after_windows_or_events() {
        let mut chain = Chain::START;
        let keys: std::vec::Vec<_> = (0..7).map(|_| chain.next(10, 3)).collect();
        assert_eq!(keys, [true, false, false, true, false, false, true]);
        let mut chain = Chain::START;
        let keys: std::vec::Vec<_> = (0..5).map(|_| chain.next(KEY_EVENTS / 2, 100)).collect();
        assert_eq!(keys, [true, false, true, false, true]);
        // A spacing of 0 acts as 1.
        let mut chain = Chain::START;
        assert!(chain.next(1, 0) && chain.ends(0) && chain.next(1, 0));
    }
}
