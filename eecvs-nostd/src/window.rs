//! The open window: its event buffer and its closing rule.

use crate::event::{Event, Polarity, Sensor};

/// One buffered event: 8 bytes. All zero is a valid empty slot, so buffers live in `.bss`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Slot {
    /// t - t0 in microseconds.
    offset_us: u32,
    /// Index + 1 of the next slot of the list (26 bits), x modulo 32 (5 bits), polarity (1 bit).
    link: u32,
}

const LINK_SHIFT: u32 = 6;

impl Slot {
    /// An empty slot.
    pub const EMPTY: Self = Self {
        offset_us: 0,
        link: 0,
    };

    pub(crate) const fn offset_us(self) -> u32 {
        self.offset_us
    }

    /// Index + 1 of the next slot, 0 at the end of the list.
    pub(crate) const fn next(self) -> u32 {
        self.link >> LINK_SHIFT
    }

    pub(crate) const fn with_next(self, next: u32) -> Self {
        let kept = self.link & ((1 << LINK_SHIFT) - 1);
        Self {
            offset_us: self.offset_us,
            link: (next << LINK_SHIFT) | kept,
        }
    }

    /// x modulo 32.
    pub(crate) const fn column(self) -> u32 {
        (self.link >> 1) & 31
    }

    pub(crate) const fn is_on(self) -> bool {
        self.link & 1 == 1
    }
}

/// Columns of a segment: the run of pixels whose events share one list.
pub const SEGMENT_PIXELS: u16 = 32;

/// Most events that a window's buffer can hold: keeps |c|^2 of any pixel within 64 bits, and the
/// 26 bits of a link address them.
pub const EVENTS_MAX: usize = (1 << 24) - 1;

/// Segments of a sensor: rows of ceil(width / 32).
#[must_use]
pub const fn segments(width: u16, height: u16) -> usize {
    width.div_ceil(SEGMENT_PIXELS) as usize * height as usize
}

/// Words of the two-level bitmap over `segments`.
#[must_use]
pub const fn bitmap_words(segments: usize) -> usize {
    let words = segments.div_ceil(32);
    words + words.div_ceil(32)
}

/// Which sensor, and how long a window is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowConfig {
    /// Sensor that the events come from.
    pub sensor: Sensor,
    /// T in microseconds, at least 1.
    pub window_us: u32,
}

/// Memory lent to a window, zeroed.
#[derive(Debug)]
pub struct WindowBuffers<'b> {
    /// The events; as many as the window may hold.
    pub slots: &'b mut [Slot],
    /// [`segments`] words: the newest event of each segment.
    pub heads: &'b mut [u32],
    /// [`bitmap_words`] words: which segments have events.
    pub bitmap: &'b mut [u32],
}

/// What became of a pushed event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Push {
    /// It is in the window.
    Stored,
    /// It is older than the open window's start: counted, kept out.
    Late,
    /// Its pixel is not on the sensor: counted as dropped.
    Outside,
    /// The window is closed and the event is not in it: encode the window, then push it again.
    Closed,
}

/// Events that are in no window, by cause, since the last frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Older than the open window's start.
    pub late: u32,
    /// Kept out by a filter that the user asked for.
    pub filtered: u32,
    /// Lost: outside of the sensor, or reported with [`Window::count_dropped`].
    pub dropped: u32,
}

impl Counts {
    const NONE: Self = Self {
        late: 0,
        filtered: 0,
        dropped: 0,
    };

    const fn any(self) -> bool {
        self.late | self.filtered | self.dropped != 0
    }
}

/// How a window ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Closed {
    /// t0.
    pub t0_us: u64,
    /// T of the formulas: see [`Window`].
    pub duration_us: u32,
    /// The buffer was full before the window's time was up.
    pub truncated: bool,
}

/// A window [t0, t0 + T) that collects events by segment.
///
/// Windows are half-open, consecutive and aligned to the first event. A window closes
///
/// * when an event at or after t0 + T comes: duration T, and the next window starts on the grid
///   t0 + i T at or before that event;
/// * early, when an event comes and the buffer is full: the duration is the time up to that
///   event, and at least one microsecond beyond the latest event held, so that u < 1 for all of
///   them; the next window starts at that event;
/// * on [`Window::flush`]: duration T; the next window is aligned to the next event.
///
/// Order inside a window does not matter. An event costs O(1); memory is what was lent.
#[derive(Debug)]
pub struct Window<'b> {
    config: WindowConfig,
    buffers: WindowBuffers<'b>,
    /// Segments in a row.
    stride: u32,
    len: u32,
    latest_us: u32,
    /// Start of the open window, or of the next where none is open; None before the first event.
    start_us: Option<u64>,
    closed: Option<Closed>,
    counts: Counts,
}

impl<'b> Window<'b> {
    /// A window over lent buffers, or `None` where they are too small for the sensor, there is no
    /// room for an event, T is 0, or a side of the sensor is 0 or above [`Sensor::SIDE_MAX`].
    #[must_use]
    pub const fn new(config: WindowConfig, buffers: WindowBuffers<'b>) -> Option<Self> {
        let segments = segments(config.sensor.width, config.sensor.height);
        // A frame of a sensor that `Sensor::new` refuses would be refused by every reader.
        if Sensor::new(config.sensor.width, config.sensor.height).is_none()
            || config.window_us == 0
            || buffers.slots.is_empty()
            || buffers.slots.len() > EVENTS_MAX
            || buffers.heads.len() < segments
            || buffers.bitmap.len() < bitmap_words(segments)
        {
            return None;
        }
        Some(Self {
            config,
            buffers,
            stride: config.sensor.width.div_ceil(SEGMENT_PIXELS) as u32,
            len: 0,
            latest_us: 0,
            start_us: None,
            closed: None,
            counts: Counts::NONE,
        })
    }

    /// Adds an event, or says why not.
    pub fn push(&mut self, event: Event) -> Push {
        if self.closed.is_some() {
            return Push::Closed;
        }
        if !self.config.sensor.contains(event.x, event.y) {
            self.count_dropped(1);
            return Push::Outside;
        }
        let start_us = *self.start_us.get_or_insert(event.t_us);
        let Some(since_start) = event.t_us.checked_sub(start_us) else {
            self.counts.late = self.counts.late.saturating_add(1);
            return Push::Late;
        };
        let window_us = u64::from(self.config.window_us);
        let mut offset_us = since_start;
        if since_start >= window_us {
            if self.len > 0 {
                self.close(
                    self.config.window_us,
                    false,
                    Some(start_us.saturating_add(window_us)),
                );
                return Push::Closed;
            }
            // Empty windows are skipped: the open one moves along the grid.
            offset_us = since_start % window_us;
            self.start_us = Some(event.t_us - offset_us);
        }
        let offset_us = offset_us as u32;
        if self.len as usize == self.buffers.slots.len() {
            let duration_us = offset_us.max(self.latest_us.saturating_add(1));
            self.close(duration_us, true, Some(event.t_us));
            return Push::Closed;
        }
        self.store(event, offset_us);
        Push::Stored
    }

    fn store(&mut self, event: Event, offset_us: u32) {
        let x = u32::from(event.x);
        let segment = (u32::from(event.y) * self.stride + x / u32::from(SEGMENT_PIXELS)) as usize;
        let head = &mut self.buffers.heads[segment];
        let polarity = u32::from(event.polarity == Polarity::On);
        let column = x % u32::from(SEGMENT_PIXELS);
        let link = (*head << LINK_SHIFT) | (column << 1) | polarity;
        if *head == 0 {
            let word = segment / 32;
            self.buffers.bitmap[word] |= 1 << (segment % 32);
            self.buffers.bitmap[self.words() + word / 32] |= 1 << (word % 32);
        }
        self.buffers.slots[self.len as usize] = Slot { offset_us, link };
        self.len += 1;
        self.buffers.heads[segment] = self.len;
        self.latest_us = self.latest_us.max(offset_us);
    }

    /// Words of the bitmap's first level.
    const fn words(&self) -> usize {
        segments(self.config.sensor.width, self.config.sensor.height).div_ceil(32)
    }

    fn close(&mut self, duration_us: u32, truncated: bool, next_start_us: Option<u64>) {
        let t0_us = self.start_us.unwrap_or(0);
        self.closed = Some(Closed {
            t0_us,
            duration_us,
            truncated,
        });
        self.start_us = next_start_us;
    }

    /// Closes the window where it holds events or counts; the stream starts anew after it.
    pub fn flush(&mut self) {
        if self.closed.is_none() && (self.len > 0 || self.counts.any()) {
            self.close(self.config.window_us, false, None);
        }
    }

    /// Counts events that were lost before they came here, as on a link that overran.
    pub const fn count_dropped(&mut self, events: u32) {
        self.counts.dropped = self.counts.dropped.saturating_add(events);
    }

    /// Counts events that a filter kept out.
    pub const fn count_filtered(&mut self, events: u32) {
        self.counts.filtered = self.counts.filtered.saturating_add(events);
    }

    /// Sensor and T.
    #[must_use]
    pub const fn config(&self) -> WindowConfig {
        self.config
    }

    /// N_w so far.
    #[must_use]
    pub const fn events(&self) -> u32 {
        self.len
    }

    /// How the window ended, or `None` while it is open.
    #[must_use]
    pub const fn closed(&self) -> Option<Closed> {
        self.closed
    }

    /// Hands out the counts, which start again at 0.
    pub(crate) const fn take_counts(&mut self) -> Counts {
        core::mem::replace(&mut self.counts, Counts::NONE)
    }

    /// Opens the next window; the segments must have been taken.
    pub(crate) fn reopen(&mut self) {
        debug_assert!(self.buffers.bitmap.iter().all(|word| *word == 0));
        self.len = 0;
        self.latest_us = 0;
        self.closed = None;
    }

    /// Takes the next segment that has events: its index and its newest event's list.
    ///
    /// The cost follows the segments that have events and 1/1024 of all segments.
    pub(crate) fn take_segment(&mut self, cursor: &mut usize) -> Option<(u32, u32)> {
        let words = self.words();
        let (first, second) = self.buffers.bitmap.split_at_mut(words);
        while let Some(group) = second.get_mut(*cursor) {
            if *group == 0 {
                *cursor += 1;
                continue;
            }
            let word = *cursor * 32 + group.trailing_zeros() as usize;
            let bits = &mut first[word];
            let segment = word * 32 + bits.trailing_zeros() as usize;
            *bits &= *bits - 1;
            if *bits == 0 {
                *group &= *group - 1;
            }
            let head = core::mem::take(&mut self.buffers.heads[segment]);
            return Some((segment as u32, head));
        }
        None
    }

    /// The buffered events.
    pub(crate) const fn slots(&mut self) -> &mut [Slot] {
        self.buffers.slots
    }

    /// Position of a segment's first pixel.
    pub(crate) const fn segment_origin(&self, segment: u32) -> (u16, u16) {
        let x = (segment % self.stride) as u16 * SEGMENT_PIXELS;
        (x, (segment / self.stride) as u16)
    }
}
