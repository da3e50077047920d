//! The open window: its event buffer and the rule that closes it.

pub mod filter;
pub mod hot_pixels;
mod take_events;
mod take_words;
pub mod vectors;

use core::num::{NonZeroU32, NonZeroU64};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::coder::quick;
use crate::window::take_events::Bounds;
use crate::window::take_words::Intake;
use event_types::evt2::{Evt2Decoder, SPAN_US, Word, X_SHIFT, is_event, low_us};
use event_types::{Event, Polarity, Sensor};

/// A buffered event of 8 bytes. An all-zero slot is valid and empty, so buffers can lie in `.bss`.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Default, FromBytes, Immutable, IntoBytes, KnownLayout,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub struct Slot {
    /// t - t0 in microseconds.
    offset_us: u32,
    /// From the highest bit down: the next slot of the list, x modulo 32 (5 bits) and, in the lowest bit, the
    /// polarity. [`LINK`] holds the positions. In a window that keeps the order of arrival, the place as in
    /// [`quick::Placed`].
    link: u32,
}

/// Bit positions of the next slot and of x in a link. On a microcontroller the next slot is a halfword (16 bits),
/// x is where an EVT 2.0 word has it, and the polarity has a byte to itself, so each field takes one instruction
/// to read, change or add. On a host slots are numbered with 24 bits.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
const LINK: (u32, u32) = (16, X_SHIFT);
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
const LINK: (u32, u32) = (8, 3);
pub(crate) const NEXT_SHIFT: u32 = LINK.0;
pub(crate) const COLUMN_SHIFT: u32 = LINK.1;
/// Width of the polarity's field; only its lowest bit is used.
const SIGN_BITS: u32 = if COLUMN_SHIFT < 8 { COLUMN_SHIFT } else { 8 };
const _: () = assert!(COLUMN_SHIFT <= X_SHIFT && COLUMN_SHIFT + COLUMN_BITS <= NEXT_SHIFT);

impl Slot {
    /// An empty slot.
    pub const EMPTY: Self = Self {
        offset_us: 0,
        link: 0,
    };

    /// Builds a slot. `next` is what [`Self::next`] returns; `column_and_sign` is x modulo 32 shifted left by
    /// [`COLUMN_SHIFT`], plus 1 for ON.
    #[inline]
    pub(crate) const fn new(offset_us: u32, next: u32, column_and_sign: u32) -> Self {
        Self {
            offset_us,
            link: (next << NEXT_SHIFT) | (column_and_sign & ((1 << NEXT_SHIFT) - 1)),
        }
    }

    /// Builds a slot of a window that keeps the order of arrival.
    #[inline(always)]
    const fn placed(event: Event, offset_us: u32) -> Self {
        Self {
            offset_us,
            link: quick::place(event.x, event.y, event.polarity),
        }
    }

    pub(crate) const fn offset_us(self) -> u32 {
        self.offset_us
    }

    /// Returns the next slot of the list, or [`NO_SLOT`] at its end.
    pub(crate) const fn next(self) -> u32 {
        self.link >> NEXT_SHIFT
    }

    pub(crate) const fn with_offset_us(self, offset_us: u32) -> Self {
        Self { offset_us, ..self }
    }

    pub(crate) const fn with_next(self, next: u32) -> Self {
        Self::new(self.offset_us, next, self.link)
    }

    /// Returns x modulo 32.
    pub(crate) const fn column(self) -> u32 {
        (self.link >> COLUMN_SHIFT) % SEGMENT_PIXELS as u32
    }

    /// Returns 1 for ON, 0 for OFF.
    pub(crate) const fn sign(self) -> u32 {
        self.link & ((1 << SIGN_BITS) - 1)
    }

    pub(crate) const fn is_on(self) -> bool {
        self.link & 1 == 1
    }
}

pub(crate) const COLUMN_BITS: u32 = 5;
/// Columns of a segment, the run of pixels in a row whose events share one list.
pub const SEGMENT_PIXELS: u16 = 1 << COLUMN_BITS;

/// Largest number of events in a window's buffer on any target. It keeps |c|^2 of any pixel within 64 bits and
/// fits the 24 bits of a host's link.
pub const EVENTS_MAX: usize = (1 << 24) - 1;

/// A slot number, all ones for an empty list. A microcontroller's windows are short, so 16 bits are enough there
/// and halve the memory for heads.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
pub type Head = u16;
/// A slot number, all ones for an empty list.
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
pub type Head = u32;

/// The end of a list, in place of a slot number; larger than that of any slot.
pub(crate) const NO_SLOT: u32 = u32::MAX >> NEXT_SHIFT;
const _: () = assert!(SLOTS_MAX <= NO_SLOT as usize);

/// The head of an empty list. The assembly also writes other values above [`SLOTS_MAX`], which mean the same.
pub(crate) const NO_HEAD: Head = NO_SLOT as Head;

/// Largest number of slots in a window on this target: [`EVENTS_MAX`], or as many as a [`Head`] can number with
/// its sign bit clear, because a set sign bit marks the end of a list.
pub const SLOTS_MAX: usize = if (Head::MAX as usize >> 1) < EVENTS_MAX {
    Head::MAX as usize >> 1
} else {
    EVENTS_MAX
};

/// Returns the number of segments of a sensor: `height` rows of ceil(`width` / 32).
#[must_use]
pub const fn segments(width: u16, height: u16) -> usize {
    width.div_ceil(SEGMENT_PIXELS) as usize * height as usize
}

/// Returns the number of 32-bit words in a bitmap over `segments` segments.
#[must_use]
pub const fn bitmap_words(segments: usize) -> usize {
    segments.div_ceil(32)
}

/// Largest number of consecutive empty windows that [`WindowConfig::every_window`] closes. A longer gap is taken
/// for a jump of the clock, rather than a scene without motion, and is skipped.
pub const EMPTY_WINDOWS_MAX: u64 = 1 << 16;

/// Configures a window: its sensor, its length, and where windows begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowConfig {
    /// The sensor that the events come from.
    pub sensor: Sensor,
    /// T in microseconds, at least 1.
    pub window_us: u32,
    /// A boundary of the grid of windows, in microseconds: windows begin at `origin_us` + i T for integer i, so
    /// that the windows of several sensors line up. `None`: the grid begins with each run's first event.
    pub origin_us: Option<u64>,
    /// Whether to close windows without events too, at most [`EMPTY_WINDOWS_MAX`] in a row, so that a receiver
    /// can tell a sensor that sees nothing from one that is gone.
    pub every_window: bool,
    /// Whether events are kept in their order of arrival, not by their pixels: for [`crate::Coder::Quick`] and
    /// [`crate::Coder::Keys`], and set by [`crate::Config::windows`]. Frames of such a window are of either coder, whatever
    /// the mode; isolated events stay.
    pub keeps_arrival: bool,
}

impl WindowConfig {
    /// Returns a configuration for windows of `window_us` microseconds that begin with the first event. Windows
    /// without events are skipped.
    #[must_use]
    pub const fn new(sensor: Sensor, window_us: u32) -> Self {
        Self {
            sensor,
            window_us,
            origin_us: None,
            every_window: false,
            keeps_arrival: false,
        }
    }

    /// Returns how many segments' lists a window has memory for: none where events are kept in their order of arrival.
    #[must_use]
    pub const fn segments(&self) -> usize {
        if HAS_QUICK && self.keeps_arrival {
            0
        } else {
            segments(self.sensor.width, self.sensor.height)
        }
    }

    /// Returns the time from the last boundary of the grid to `t_us`; 0 without an origin.
    const fn since_boundary_us(&self, t_us: u64) -> u64 {
        let (Some(origin_us), Some(window_us)) =
            (self.origin_us, NonZeroU64::new(self.window_us as u64))
        else {
            return 0;
        };
        let rest_us = t_us.abs_diff(origin_us) % window_us.get();
        if t_us >= origin_us || rest_us == 0 {
            rest_us
        } else {
            window_us.get() - rest_us
        }
    }

    /// Returns the start of a window that holds `t_us` and follows no other window.
    const fn start_us(&self, t_us: u64) -> u64 {
        t_us.saturating_sub(self.since_boundary_us(t_us))
    }

    /// Returns the time from a window's start to its end: T, or less if it starts between two boundaries.
    const fn duration_us(&self, start_us: u64) -> u32 {
        self.window_us - self.since_boundary_us(start_us) as u32
    }
}

/// Memory lent to a window, zeroed.
#[derive(Debug)]
pub struct WindowBuffers<'b> {
    /// The events: as many slots as the window may hold events, 1 to [`SLOTS_MAX`].
    pub slots: &'b mut [Slot],
    /// The newest event of each segment: at least [`WindowConfig::segments`] heads.
    pub heads: &'b mut [Head],
    /// The segments that have events: at least [`bitmap_words`] words of as many.
    pub bitmap: &'b mut [u32],
}

impl<'b> WindowBuffers<'b> {
    /// Divides `memory` in equal shares between the buffers of `windows` windows of a configuration, and zeroes it.
    /// Each window holds as many events as its share has room for. Returns `None` if a share has no room for even
    /// one event.
    ///
    /// One firmware image can thus serve every sensor that fits: a smaller sensor has fewer segments, which
    /// leaves more memory for events, and windows that keep the order of arrival have none.
    pub fn share(
        memory: &'b mut [u32],
        windows: usize,
        config: &WindowConfig,
    ) -> Option<impl Iterator<Item = Self> + use<'b>> {
        let segments = config.segments();
        let bitmap_words = bitmap_words(segments);
        let heads_words = (segments * size_of::<Head>()).div_ceil(size_of::<u32>());
        let share = memory.len() / windows.max(1);
        let slots = share.checked_sub(bitmap_words + heads_words)? / SLOT_WORDS;
        if slots == 0 {
            return None;
        }
        memory.fill(0);
        let mut rest = memory;
        Some((0..windows).filter_map(move |_| {
            let (share, after) = core::mem::take(&mut rest).split_at_mut_checked(share)?;
            rest = after;
            let (bitmap, share) = share.split_at_mut_checked(bitmap_words)?;
            let (heads, share) = share.split_at_mut_checked(heads_words)?;
            let events = (share.len() / SLOT_WORDS).min(SLOTS_MAX);
            let (slots, _) =
                <[Slot]>::mut_from_prefix_with_elems(share.as_mut_bytes(), events).ok()?;
            let (heads, _) =
                <[Head]>::mut_from_prefix_with_elems(heads.as_mut_bytes(), segments).ok()?;
            Some(Self {
                slots,
                heads,
                bitmap,
            })
        }))
    }
}

/// Largest number of words taken at once while the span of the current `TIME_HIGH` lies only partly in the
/// window.
const STRADDLING_WORDS: usize = 64;

/// Largest number of events per segment that [`Window::sample`] passes on.
const SAMPLES_OF_SEGMENT: u32 = 4;

/// Whether windows can keep the order of arrival; without the feature none of its code is compiled.
pub(crate) const HAS_QUICK: bool = cfg!(feature = "quick");

const SLOT_WORDS: usize = size_of::<Slot>() / size_of::<u32>();

/// The result of pushing an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Push {
    /// The event is in the window.
    Stored,
    /// Its pixel is not on the sensor. The event is counted as dropped.
    Outside,
    /// The window is closed and does not hold the event: encode the window, then push the event again.
    Closed,
}

/// What [`Window::push_words`] or [`Window::push_vectors`] took from the front of the words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Taken {
    /// Number of words taken from the front. If fewer than given, the window is closed and the next word is an
    /// event that it does not hold.
    pub words: usize,
    /// Events among them, including those outside the sensor.
    pub events: u32,
    /// Events among these outside the sensor.
    pub outside: u32,
    /// Words among them that were neither events nor times, and events before the first time.
    pub ignored: u32,
}

/// Events since the last frame that are in no window, by cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Too late for their window. Always 0 from this encoder, which begins a new run of windows instead.
    pub late: u32,
    /// Removed by a filter that the user configured.
    pub filtered: u32,
    /// Lost: outside the sensor, or reported with [`Window::count_dropped`].
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

/// How a window ended: its start, its duration, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Closed {
    /// Start t0 of the window, in microseconds.
    pub t0_us: u64,
    /// Duration T that the formulas use, in microseconds: see [`Window`].
    pub duration_us: u32,
    /// The buffer was full before the window's time was over.
    pub truncated: bool,
    /// The clock fell back before this window, which begins a new run.
    pub begins_run: bool,
}

/// Where the window after another one starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NextStart {
    /// Start in microseconds; `None` if the next event sets it.
    pub us: Option<u64>,
    /// Whether a new run begins there.
    pub begins_run: bool,
}

impl NextStart {
    /// Starts at the next event.
    pub const ANY: Self = Self {
        us: None,
        begins_run: false,
    };

    /// Returns a start at `start_us` within the same run.
    #[must_use]
    pub const fn at(start_us: u64) -> Self {
        Self {
            us: Some(start_us),
            begins_run: false,
        }
    }
}

/// A window [t0, t0 + T) that collects events by segment.
///
/// Windows are half-open and consecutive. They are aligned to the first event, or to [`WindowConfig::origin_us`].
/// A window closes
///
/// * when an event at or after t0 + T arrives. Its duration is T, and the next window starts on the grid t0 + i
///   T, at or before that event;
/// * early, when an event arrives while the buffer is full. Its duration is the time up to that event, but at
///   least until one microsecond after the latest event held, so that u < 1 for every event. The next window
///   starts at that event and, with an origin, ends at the next boundary of the grid;
/// * when an event before t0 arrives. Its duration is T, and the next window starts at that event, or with an
///   origin at the boundary before it. It begins a new *run*, so that no event is too late
///   ([`crate::ingest::reorder`] prevents this for small disorder);
/// * on [`Window::flush`]. Its duration is T, and the next window is aligned to the next event.
///
/// With an origin, a window that starts between two boundaries ends at the second one, so T is shorter there.
///
/// The order of events inside a window does not matter, and is kept if [`WindowConfig::keeps_arrival`] says so. An
/// event costs O(1), and no memory is used beyond what was lent.
#[derive(Debug)]
pub struct Window<'b> {
    config: WindowConfig,
    slots: &'b mut [Slot],
    /// One head per segment: [`WindowConfig::segments`].
    heads: &'b mut [Head],
    /// One bit per segment, starting from [`FIRST`].
    bitmap: &'b mut [u32],
    /// Segments in a row.
    stride: NonZeroU32,
    len: u32,
    /// Slots of events that were removed from their lists.
    removed: u32,
    latest: Latest,
    /// Start of the open window, or of the next one while this one is closed; `None` before the first event.
    start_us: Option<u64>,
    /// Time from `start_us` to that window's end.
    duration_us: u32,
    /// Whether that window begins a run.
    begins_run: bool,
    closed: Option<Closed>,
    counts: Counts,
}

impl<'b> Window<'b> {
    /// Creates an empty window over lent buffers. Returns `None` if they are too small for the sensor or have no
    /// slot, if there are more than [`SLOTS_MAX`] slots, if T is 0, or if a side of the sensor is 0 or above
    /// [`Sensor::SIDE_MAX`].
    #[must_use]
    pub const fn new(config: WindowConfig, buffers: WindowBuffers<'b>) -> Option<Self> {
        let segments = config.segments();
        let WindowBuffers {
            slots,
            heads,
            bitmap,
        } = buffers;
        // Every reader would refuse a frame of a sensor that `Sensor::new` refuses.
        if Sensor::new(config.sensor.width, config.sensor.height).is_none()
            || config.window_us == 0
            || slots.is_empty()
            || slots.len() > SLOTS_MAX
            || heads.len() < segments
            || bitmap.len() < bitmap_words(segments)
        {
            return None;
        }
        let stride = config.sensor.width.div_ceil(SEGMENT_PIXELS) as u32;
        let Some(stride) = NonZeroU32::new(stride) else {
            return None;
        };
        let (heads, _) = heads.split_at_mut(segments);
        // Not 0, which is a valid slot: an index then needs no offset of 1.
        let mut segment = 0;
        while segment < segments {
            heads[segment] = NO_HEAD;
            segment += 1;
        }
        let (bitmap, _) = bitmap.split_at_mut(bitmap_words(segments));
        Some(Self {
            config,
            slots,
            heads,
            bitmap,
            stride,
            len: 0,
            removed: 0,
            latest: Latest::NONE,
            start_us: None,
            duration_us: config.window_us,
            begins_run: false,
            closed: None,
            counts: Counts::NONE,
        })
    }

    /// Adds an event, or reports why it cannot.
    #[cfg_attr(target_pointer_width = "64", inline)]
    pub fn push(&mut self, event: Event) -> Push {
        // The common case on a host, inlined: the event lies in the open window.
        if cfg!(target_pointer_width = "64")
            && self.closed.is_none()
            && self.config.sensor.contains(event.x, event.y)
            && let Some(start_us) = self.start_us
            && let Some(offset_us) = event.t_us.checked_sub(start_us)
            && offset_us < u64::from(self.duration_us)
            && (self.len as usize) < self.slots.len()
        {
            self.store(event, offset_us as u32);
            return Push::Stored;
        }
        self.push_apart(event)
    }

    /// [`Self::push`] for any event, kept out of line on a host.
    #[cfg_attr(target_pointer_width = "64", inline(never))]
    #[cfg_attr(not(target_pointer_width = "64"), inline(always))]
    fn push_apart(&mut self, event: Event) -> Push {
        if self.closed.is_some() {
            return Push::Closed;
        }
        if !self.config.sensor.contains(event.x, event.y) {
            self.count_dropped(1);
            return Push::Outside;
        }
        let start_us = match self.start_us {
            Some(start_us) => start_us,
            None => self.start(self.config.start_us(event.t_us)),
        };
        let since_start = match event.t_us.checked_sub(start_us) {
            Some(since_start) => since_start,
            None => {
                self.fall_back(event.t_us);
                if self.len > 0 {
                    return Push::Closed;
                }
                event.t_us - self.start_us.unwrap_or(event.t_us)
            }
        };
        let mut offset_us = since_start;
        if since_start >= u64::from(self.duration_us) {
            if self.len > 0 {
                self.advance();
                return Push::Closed;
            }
            self.skip_to(event.t_us);
            if self.closed.is_some() {
                return Push::Closed;
            }
            offset_us = event.t_us - self.start_us.unwrap_or(event.t_us);
        }
        let offset_us = offset_us as u32;
        if self.len as usize >= self.slots.len() {
            let duration_us = offset_us.max(self.latest_us(offset_us).saturating_add(1));
            self.close(duration_us, true, NextStart::at(event.t_us));
            return Push::Closed;
        }
        self.store(event, offset_us);
        Push::Stored
    }

    #[inline(always)]
    fn store(&mut self, event: Event, offset_us: u32) {
        if self.keeps_arrival() {
            self.store_in_order(event, offset_us);
        } else {
            self.store_by_pixel(event, offset_us);
        }
    }

    #[cfg_attr(target_pointer_width = "64", inline(always))]
    #[cfg_attr(not(target_pointer_width = "64"), inline)]
    fn store_by_pixel(&mut self, event: Event, offset_us: u32) {
        let x = u32::from(event.x);
        let segment = u32::from(event.y) * self.stride.get() + x / u32::from(SEGMENT_PIXELS);
        let (Some(head), Some(slot), Some(bits)) = (
            self.heads.get_mut(segment as usize),
            self.slots.get_mut(self.len as usize),
            self.bitmap.get_mut(segment as usize / 32),
        ) else {
            debug_assert!(false, "the sensor and the capacity were checked");
            return;
        };
        let next = index(*head);
        *bits |= FIRST.rotate_right(segment);
        let column = x % u32::from(SEGMENT_PIXELS);
        let column_and_sign = (column << COLUMN_SHIFT) | event.polarity as u32;
        *slot = Slot::new(offset_us, next, column_and_sign);
        *head = self.len as Head;
        self.len += 1;
        self.latest.event_us = self.latest.event_us.max(offset_us);
    }

    /// Returns whether events are kept in their order of arrival.
    #[inline(always)]
    pub(crate) const fn keeps_arrival(&self) -> bool {
        HAS_QUICK && self.config.keeps_arrival
    }

    #[inline(always)]
    fn store_in_order(&mut self, event: Event, offset_us: u32) {
        let Some(slot) = self.slots.get_mut(self.len as usize) else {
            debug_assert!(false, "the capacity was checked");
            return;
        };
        *slot = Slot::placed(event, offset_us);
        self.len += 1;
        self.latest.event_us = self.latest.event_us.max(offset_us);
    }

    /// Adds the events of little-endian EVT 2.0 words, up to the event that closes the window.
    ///
    /// Gives the same result as [`Evt2Decoder::decode`] and [`Self::push`] word by word, at less than half the
    /// cost. If it takes fewer words than given, encode the window and push the rest again.
    pub fn push_words(&mut self, decoder: &mut Evt2Decoder, words: &[[u8; 4]]) -> Taken {
        let mut taken = Taken::default();
        while taken.words < words.len() {
            let rest = &words[taken.words..];
            let before = self.len;
            taken.words += self.store_words(decoder, rest);
            taken.events += self.len - before;
            // This word ended the fast path: anything out of the ordinary.
            let Some(word) = words.get(taken.words) else {
                break;
            };
            match decoder.decode(u32::from_le_bytes(*word)) {
                Word::Event(event) => {
                    match self.push(event) {
                        Push::Stored => {}
                        Push::Outside => taken.outside += 1,
                        Push::Closed => break,
                    }
                    taken.events += 1;
                }
                Word::Time => {}
                Word::Untimed | Word::Other => taken.ignored += 1,
            }
            taken.words += 1;
        }
        taken
    }

    /// Stores events on the sensor while there are free slots, and follows the decoder's time forwards while it
    /// lies in the window. Returns the number of words taken.
    fn store_words(&mut self, decoder: &mut Evt2Decoder, words: &[[u8; 4]]) -> usize {
        let (Some(time_us), Some(start_us), None) = (decoder.span_us(), self.start_us, self.closed)
        else {
            return 0;
        };
        // The last windows of the clock's range end with its last microsecond.
        let window_us = u64::from(self.duration_us).min((u64::MAX - start_us).saturating_add(1));
        let since_start = time_us.wrapping_sub(start_us) as i64;
        let to_end = (window_us as i64).saturating_sub(since_start);
        if since_start <= -i64::from(SPAN_US) || to_end <= 0 {
            return 0;
        }
        let (mut words, mut ahead_us) = (words, 0);
        if since_start < 0 || to_end < i64::from(SPAN_US) {
            // Some of the times that a word can add lie outside the window. Once the words with those times, and
            // any further `TIME_HIGH`, are cut off, the rest is handled as usual.
            let inside = (-since_start).max(0) as u32..to_end.min(i64::from(SPAN_US)) as u32;
            let is_inside = |word: &[u8; 4]| {
                let word = u32::from_le_bytes(*word);
                is_event(word) && inside.contains(&low_us(word))
            };
            // A few at a time: after one that is off the sensor, the rest is checked again.
            let few = words.iter().take(STRADDLING_WORDS);
            let few = few.take_while(|word| is_inside(word)).count();
            words = words.get(..few).unwrap_or_default();
        } else {
            ahead_us = (to_end - i64::from(SPAN_US)) as u32;
        }
        let span_us = since_start as u32;
        let keeps_arrival = self.keeps_arrival();
        let mut intake = Intake {
            slots: self.slots,
            heads: self.heads,
            bitmap: self.bitmap,
            width: self.config.sensor.width,
            stride: self.stride,
            len: self.len,
            time: decoder.time_word(),
            time_last: decoder.time_word_after(ahead_us),
            span_us,
            span_at: self.len,
            before_us: 0,
            before_at: self.len,
        };
        let taken = if keeps_arrival {
            intake.take_in_order(self.config.sensor.height, words)
        } else {
            intake.take(words)
        };
        let Intake {
            len,
            time,
            span_us,
            span_at,
            before_us,
            before_at,
            ..
        } = intake;
        self.latest.span(before_us, before_at, span_at);
        // A span that begins before the window is its first one: `Latest` starts out with it.
        if since_start >= 0 {
            self.latest.span(span_us, span_at, len);
        }
        self.len = len;
        decoder.step_to_word(time);
        taken
    }

    /// Returns the largest offset of the events held, or a smaller one if the largest is below `at_least_us`
    /// anyway.
    fn latest_us(&self, at_least_us: u32) -> u32 {
        let Latest {
            event_us,
            span_us,
            span_at,
        } = self.latest;
        if span_us.saturating_add(SPAN_US) <= at_least_us {
            return event_us;
        }
        let slots = self.slots.get(span_at as usize..self.len as usize);
        let offsets = slots.unwrap_or_default().iter().map(|slot| slot.offset_us);
        offsets.fold(event_us, u32::max)
    }

    /// Stores events from the front while they lie in the open window and on the sensor and there is room.
    /// Returns how many it stored.
    #[cfg_attr(target_pointer_width = "64", inline)]
    pub(crate) fn push_inside(&mut self, events: &[Event]) -> usize {
        let (Some(start_us), None) = (self.start_us, self.closed) else {
            return 0;
        };
        if self.keeps_arrival() {
            return self.push_inside_in_order(start_us, events);
        }
        let window_us = u64::from(self.duration_us);
        let free = self.slots.len().saturating_sub(self.len as usize);
        let mut stored = 0;
        for event in events.iter().take(free) {
            let offset_us = event.t_us.wrapping_sub(start_us);
            if event.t_us < start_us
                || offset_us >= window_us
                || !self.config.sensor.contains(event.x, event.y)
            {
                break;
            }
            self.store_by_pixel(*event, offset_us as u32);
            stored += 1;
        }
        stored
    }

    /// As [`Self::push_inside`], in the order of arrival.
    fn push_inside_in_order(&mut self, start_us: u64, events: &[Event]) -> usize {
        let bounds = Bounds {
            sensor: self.config.sensor,
            start_us,
            duration_us: self.duration_us,
        };
        let free = self.slots.get_mut(self.len as usize..).unwrap_or_default();
        let latest_us = &mut self.latest.event_us;
        let stored = take_events::take_in_order(bounds, free, events, latest_us);
        self.len += stored as u32;
        stored
    }

    /// Takes over a closed window that keeps the order of arrival: lists its events by pixel, as if each had been
    /// pushed here, with its end and its counts, and opens it again. `arrived` needs no memory for pixels, so that a host
    /// cuts many windows ahead and lists each of them in the same memory when it encodes it.
    ///
    /// Returns `false`, and changes neither, if `arrived` is not such a window, if this window is not open and empty or
    /// keeps the order of arrival itself, if their sensors differ, or if this one has fewer slots than `arrived` has
    /// events.
    pub fn list(&mut self, arrived: &mut Window<'_>) -> bool {
        if !arrived.keeps_arrival()
            || arrived.closed.is_none()
            || self.keeps_arrival()
            || self.closed.is_some()
            || self.len > 0
            || self.config.sensor != arrived.config.sensor
            || self.slots.len() < arrived.len as usize
        {
            return false;
        }
        for slot in arrived.slots.iter().take(arrived.len as usize) {
            let (x, y) = quick::position(slot.link);
            let event = Event {
                t_us: 0,
                x,
                y,
                polarity: Polarity::from_bool(slot.is_on()),
            };
            self.store_by_pixel(event, slot.offset_us);
        }
        self.closed = arrived.closed;
        self.counts = arrived.take_counts();
        self.follow_on(arrived.next_start());
        arrived.reopen();
        true
    }

    fn close(&mut self, duration_us: u32, truncated: bool, next: NextStart) {
        let t0_us = self.start_us.unwrap_or(0);
        self.closed = Some(Closed {
            t0_us,
            duration_us,
            truncated,
            begins_run: self.begins_run,
        });
        self.follow_on(next);
    }

    /// Sets the open window's start and duration, and returns the start.
    const fn start(&mut self, start_us: u64) -> u64 {
        self.start_us = Some(start_us);
        self.duration_us = self.config.duration_us(start_us);
        start_us
    }

    const fn follow_on(&mut self, next: NextStart) {
        self.begins_run = next.begins_run;
        match next.us {
            Some(start_us) => _ = self.start(start_us),
            None => self.start_us = None,
        }
    }

    /// Closes a window that holds events and begins a new run, whose first window holds `t_us`.
    pub(crate) fn fall_back(&mut self, t_us: u64) {
        self.begin_run(Some(self.config.start_us(t_us)));
    }

    /// Closes a window that holds events and begins a new run with the next event.
    pub(crate) fn end_run(&mut self) {
        self.begin_run(None);
    }

    fn begin_run(&mut self, us: Option<u64>) {
        if self.closed.is_some() {
            return;
        }
        let next = NextStart {
            us,
            begins_run: true,
        };
        if self.len > 0 {
            self.close(self.duration_us, false, next);
        } else {
            self.follow_on(next);
        }
    }

    /// Closes the open window because its time is over; the next one follows it on the grid.
    pub(crate) fn advance(&mut self) {
        if let (Some(start_us), None) = (self.start_us, self.closed) {
            let next_us = start_us.saturating_add(u64::from(self.duration_us));
            self.close(self.duration_us, false, NextStart::at(next_us));
        }
    }

    /// Moves an empty open window along the grid until it holds `t_us`, which must not be before its start. A
    /// window without a start is given one that holds `t_us`. With [`WindowConfig::every_window`] the window is
    /// closed instead, unless the gap is too long.
    pub(crate) fn skip_to(&mut self, t_us: u64) {
        if self.len > 0 || self.closed.is_some() {
            return;
        }
        let Some(start_us) = self.start_us else {
            self.start(self.config.start_us(t_us));
            return;
        };
        let Some(since_start) = t_us.checked_sub(start_us) else {
            return;
        };
        if since_start < u64::from(self.duration_us) {
            return;
        }
        let Some(window_us) = NonZeroU64::new(self.config.window_us.into()) else {
            return;
        };
        if self.config.every_window && since_start / window_us < EMPTY_WINDOWS_MAX {
            self.advance();
            return;
        }
        let start_us = match self.config.origin_us {
            Some(_) => self.config.start_us(t_us),
            None => t_us - since_start % window_us,
        };
        self.start(start_us);
    }

    /// Closes the window if it holds events or counts. The next window is aligned to the next event.
    pub fn flush(&mut self) {
        if self.closed.is_none() && (self.len > 0 || self.counts.any()) {
            self.close(self.duration_us, false, NextStart::ANY);
        }
    }

    /// Closes the window if its time is over at `now_us`, before which no event will arrive any more, and if it
    /// holds events or empty windows are wanted. The next window follows on the grid.
    ///
    /// A live sensor that sees nothing thus does not hold its last events back.
    pub fn pass(&mut self, now_us: u64) {
        if self.closed.is_some() {
            return;
        }
        let Some(start_us) = self.start_us else {
            if self.config.every_window {
                self.start(self.config.start_us(now_us));
            }
            return;
        };
        let since_start = now_us.saturating_sub(start_us);
        if since_start < u64::from(self.duration_us) {
            return;
        }
        if self.len > 0 {
            self.advance();
        } else if self.config.every_window {
            self.skip_to(now_us);
        }
    }

    /// Returns the start of the window after this one, or of this one while it is open.
    #[must_use]
    pub const fn next_start(&self) -> NextStart {
        NextStart {
            us: self.start_us,
            begins_run: self.begins_run,
        }
    }

    /// Continues another window's grid: if this window is empty and open, it starts at `start`, the other's
    /// [`Window::next_start`].
    pub const fn follow(&mut self, start: NextStart) {
        if self.len == 0 && self.closed.is_none() {
            self.follow_on(start);
        }
    }

    /// Counts events that were lost before they arrived here, for example on a link that overran.
    pub const fn count_dropped(&mut self, events: u32) {
        self.counts.dropped = self.counts.dropped.saturating_add(events);
    }

    /// Counts events that a filter removed.
    pub const fn count_filtered(&mut self, events: u32) {
        self.counts.filtered = self.counts.filtered.saturating_add(events);
    }

    /// Returns the configuration that the window was created with.
    #[must_use]
    pub const fn config(&self) -> WindowConfig {
        self.config
    }

    /// Returns the time from the open window's start to its end: T, or less if it starts between two boundaries.
    #[must_use]
    pub const fn duration_us(&self) -> u32 {
        self.duration_us
    }

    /// Returns the number of events in the window so far, N_w.
    #[must_use]
    pub const fn events(&self) -> u32 {
        self.len
    }

    /// Passes every event held to `each`, with the time since the window's start as `t_us`: in the order of arrival if the
    /// window keeps it, otherwise row by row.
    pub fn each_event(&self, mut each: impl FnMut(Event)) {
        let mut pass = |slot: &Slot, (x, y)| {
            each(Event {
                t_us: slot.offset_us.into(),
                x,
                y,
                polarity: Polarity::from_bool(slot.is_on()),
            });
        };
        if self.keeps_arrival() {
            for slot in self.slots.iter().take(self.len as usize) {
                pass(slot, quick::position(slot.link));
            }
            return;
        }
        let mut from = 0;
        while let Some(segment) = self.next_used(from) {
            let (x, y) = self.segment_origin(segment);
            let mut at = self.head_of(segment);
            while let Some(slot) = self.slots.get(at as usize) {
                pass(slot, (x + slot.column() as u16, y));
                at = slot.next();
            }
            from = segment + 1;
        }
    }

    /// Returns how the window ended, or `None` while it is open.
    #[must_use]
    pub const fn closed(&self) -> Option<Closed> {
        self.closed
    }

    /// Returns the counts and resets them to 0.
    pub(crate) const fn take_counts(&mut self) -> Counts {
        core::mem::replace(&mut self.counts, Counts::NONE)
    }

    /// Opens the next window. All segments must have been taken.
    pub(crate) fn reopen(&mut self) {
        debug_assert!(self.bitmap.iter().all(|word| *word == 0));
        self.len = 0;
        self.removed = 0;
        self.latest = Latest::NONE;
        self.closed = None;
    }

    /// Takes the next 32 segments if any of them has events, or a later group of 32: returns the index of the
    /// first, and a bit per segment from [`FIRST`] on.
    ///
    /// The cost grows with the segments that have events, plus 1/32 of all segments.
    #[inline]
    pub(crate) fn take_segments(&mut self, cursor: &mut usize) -> Option<(u32, u32)> {
        let words = self.bitmap.get_mut(*cursor..)?;
        let at = first_used(words)?;
        let segment = (*cursor + at) as u32 * 32;
        *cursor += at + 1;
        Some((segment, core::mem::take(words.get_mut(at)?)))
    }

    /// Takes a segment's list: returns the slot of its newest event and empties the list.
    #[inline]
    pub(crate) fn take_head(&mut self, segment: u32) -> u32 {
        let head = self.heads.get_mut(segment as usize);
        head.map_or(NO_SLOT, |head| index(core::mem::replace(head, NO_HEAD)))
    }

    /// Passes position and time of up to `most` events to `each`, the newest of every segment, before they are
    /// taken.
    pub(crate) fn sample(&self, most: u32, mut each: impl FnMut((u16, u16), u32)) {
        let (mut left, mut from) = (most, 0);
        while let Some(segment) = self.next_used(from).filter(|_| left > 0) {
            let (x, y) = self.segment_origin(segment);
            let mut at = self.head_of(segment);
            for _ in 0..SAMPLES_OF_SEGMENT.min(left) {
                let Some(slot) = self.slots.get(at as usize) else {
                    break;
                };
                each((x + slot.column() as u16, y), slot.offset_us());
                at = slot.next();
                left -= 1;
            }
            from = segment + 1;
        }
    }

    /// Returns the first segment at or after `from` that has events.
    pub(crate) fn next_used(&self, from: u32) -> Option<u32> {
        let at = from as usize / 32;
        let first = self.bitmap.get(at)? & (u32::MAX >> (from % 32));
        if first != 0 {
            return Some(at as u32 * 32 + first.leading_zeros());
        }
        let rest = self.bitmap.get(at + 1..)?;
        let next = first_used(rest)?;
        let word = rest.get(next)?;
        Some((at + 1 + next) as u32 * 32 + word.leading_zeros())
    }

    /// Returns the events of a window that keeps their order of arrival.
    pub(crate) fn in_order(&self) -> &[quick::Placed] {
        let slots = self.slots.get(..self.len as usize).unwrap_or_default();
        <[quick::Placed]>::ref_from_bytes(slots.as_bytes()).unwrap_or_default()
    }

    /// As [`Self::in_order`], to be put into another order.
    pub(crate) fn in_order_mut(&mut self) -> &mut [quick::Placed] {
        let slots = self.slots.get_mut(..self.len as usize).unwrap_or_default();
        <[quick::Placed]>::mut_from_bytes(slots.as_mut_bytes()).unwrap_or_default()
    }

    /// Removes from a closed window that keeps the order of arrival all events whose position `is_kept` refuses;
    /// returns how many.
    pub(crate) fn keep_in_order(&mut self, is_kept: impl Fn(u16, u16) -> bool) -> u32 {
        let mut kept = 0;
        for at in 0..self.len as usize {
            let Some(slot) = self.slots.get(at).copied() else {
                break;
            };
            let (x, y) = quick::position(slot.link);
            if is_kept(x, y)
                && let Some(to) = self.slots.get_mut(kept)
            {
                *to = slot;
                kept += 1;
            }
        }
        let removed = self.len - kept as u32;
        self.len = kept as u32;
        removed
    }

    /// Returns two bit sets of a segment's columns: those that have events, and those that have several.
    pub(crate) fn columns_of(&self, segment: u32) -> (u32, u32) {
        let (mut occupied, mut crowded) = (0, 0);
        let bits = self.bitmap.get(segment as usize / 32).copied();
        // A segment without events may still have an old list.
        let mut at = match bits {
            Some(bits) if bits & FIRST.rotate_right(segment) != 0 => self.head_of(segment),
            _ => NO_SLOT,
        };
        while let Some(slot) = self.slots.get(at as usize) {
            let column = 1 << slot.column();
            crowded |= occupied & column;
            occupied |= column;
            at = slot.next();
        }
        (occupied, crowded)
    }

    /// Returns the slot of the newest event of a segment that has events.
    pub(crate) fn head_of(&self, segment: u32) -> u32 {
        let head = self.heads.get(segment as usize).copied();
        head.map_or(NO_SLOT, index)
    }

    /// Replaces the list of a segment that has events by another one of the same events.
    pub(crate) fn put_head(&mut self, segment: u32, newest: u32) {
        if let Some(head) = self.heads.get_mut(segment as usize) {
            *head = newest as Head;
        }
    }

    /// Removes from a used segment all events outside `columns`; returns how many it removed.
    pub(crate) fn keep_columns(&mut self, segment: u32, columns: u32) -> u32 {
        self.keep(segment, |_, slot| columns >> slot.column() & 1 == 1)
    }

    /// Keeps `share_q16` / 2^16 of the events, spread evenly in order of arrival; returns how many it removed.
    pub(crate) fn thin(&mut self, share_q16: u32) -> u32 {
        let (mut removed, mut from) = (0, 0);
        while let Some(segment) = self.next_used(from) {
            removed += self.keep(segment, |at, _| {
                // The events at which the running sum of shares passes a whole number.
                at.wrapping_mul(share_q16) % (1 << 16) < share_q16
            });
            from = segment + 1;
        }
        removed
    }

    /// Removes the events of a used segment that `is_kept` refuses, after the window has closed; returns how
    /// many.
    fn keep(&mut self, segment: u32, is_kept: impl Fn(u32, Slot) -> bool) -> u32 {
        let mut removed = 0;
        let mut at = self.head_of(segment);
        // The last slot that was kept.
        let mut last: Option<u32> = None;
        let mut head = NO_HEAD;
        while let Some(slot) = self.slots.get(at as usize).copied() {
            let next = slot.next();
            if is_kept(at, slot) {
                match last.and_then(|last| self.slots.get_mut(last as usize)) {
                    Some(before) => *before = before.with_next(at),
                    None => head = at as Head,
                }
                last = Some(at);
            } else {
                removed += 1;
            }
            at = next;
        }
        if let Some(last) = last.and_then(|last| self.slots.get_mut(last as usize)) {
            *last = last.with_next(NO_SLOT);
        }
        if let Some(place) = self.heads.get_mut(segment as usize) {
            *place = head;
        }
        if last.is_none()
            && let Some(bits) = self.bitmap.get_mut(segment as usize / 32)
        {
            *bits &= !FIRST.rotate_right(segment);
        }
        self.len -= removed;
        self.removed += removed;
        removed
    }

    /// Returns how many slots from the first on have events or had one that was removed from its list.
    pub(crate) const fn slots_used(&self) -> u32 {
        self.len + self.removed
    }

    /// Returns the buffered events.
    #[inline]
    pub(crate) const fn slots(&mut self) -> &mut [Slot] {
        self.slots
    }

    /// Returns the buffered events for reading only.
    #[inline]
    pub(crate) const fn slots_now(&self) -> &[Slot] {
        self.slots
    }

    /// Returns the slots, the heads and the number of segments in a row, for the assembly.
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(crate) const fn parts(&mut self) -> (&mut [Slot], &mut [Head], NonZeroU32) {
        (self.slots, self.heads, self.stride)
    }

    /// Returns the position of a segment's first pixel.
    #[inline]
    pub(crate) fn segment_origin(&self, segment: u32) -> (u16, u16) {
        let y = segment / self.stride;
        let x = (segment - y * self.stride.get()) * u32::from(SEGMENT_PIXELS);
        (x as u16, y as u16)
    }
}

/// Returns the index of the first word that is not 0.
#[inline(always)]
fn first_used(words: &[u32]) -> Option<usize> {
    // On a large sensor few words are not 0, so a host tests several at once.
    let mut skipped = 0;
    if cfg!(target_pointer_width = "64") {
        let (chunks, _) = words.as_chunks::<16>();
        let is_empty = |chunk: &&[u32; 16]| chunk.iter().fold(0, |all, bits| all | bits) == 0;
        skipped = 16 * chunks.iter().take_while(is_empty).count();
    }
    let rest = words.get(skipped..)?;
    Some(skipped + rest.iter().position(|bits| *bits != 0)?)
}

/// What is known of the largest offset: enough to find it in the slots on demand.
///
/// Events from words are not compared one by one as they arrive; the latest of them lies in the latest span, the
/// events that share a `TIME_HIGH`.
#[derive(Debug, Clone, Copy)]
struct Latest {
    /// Largest offset of the events that were pushed one by one.
    event_us: u32,
    /// Offset of the latest span that has events.
    span_us: u32,
    /// Slot of that span's first event.
    span_at: u32,
}

impl Latest {
    const NONE: Self = Self {
        event_us: 0,
        span_us: 0,
        span_at: 0,
    };

    /// Notes that the slots `from..to` were filled in the span that begins at `span_us`.
    #[inline]
    const fn span(&mut self, span_us: u32, from: u32, to: u32) {
        if from < to && span_us > self.span_us {
            self.span_us = span_us;
            self.span_at = from;
        }
    }
}

/// Returns the slot number in a head, whatever the head's width on this target.
#[allow(clippy::unnecessary_cast)]
#[inline]
pub(crate) const fn index(head: Head) -> u32 {
    head as u32
}

/// The bit of the first of 32 segments in a word: the highest one, because words are rotated and their leading
/// zeros counted.
pub(crate) const FIRST: u32 = 1 << 31;
