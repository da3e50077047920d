//! The open window: its event buffer and its closing rule.

pub mod filter;
pub mod hot_pixels;
mod take_words;

use core::num::{NonZeroU32, NonZeroU64};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::window::take_words::Intake;
use event_types::evt2::{Evt2Decoder, SPAN_US, Word, X_SHIFT, is_event, low_us};
use event_types::{Event, Sensor};

/// One buffered event: 8 bytes. All zero is a valid empty slot, so buffers live in `.bss`.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Default, FromBytes, Immutable, IntoBytes, KnownLayout,
)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub struct Slot {
    /// t - t0 in microseconds.
    offset_us: u32,
    /// From the top: the next slot of the list, x modulo 32 (5 bits), and in the lowest bit the
    /// polarity. [`LINK`] has the places.
    link: u32,
}

/// Where a link's next slot and its x begin. On a microcontroller the former, of 16 bits, is a
/// halfword, x is where an EVT 2.0 word has it, and the polarity has a byte for itself: each is
/// taken, changed or added in one instruction. A host's slots have 24 bits.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
const LINK: (u32, u32) = (16, X_SHIFT);
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
const LINK: (u32, u32) = (8, 3);
pub(crate) const NEXT_SHIFT: u32 = LINK.0;
pub(crate) const COLUMN_SHIFT: u32 = LINK.1;
/// The polarity's bits, of which the lowest is in use.
const SIGN_BITS: u32 = if COLUMN_SHIFT < 8 { COLUMN_SHIFT } else { 8 };
const _: () = assert!(COLUMN_SHIFT <= X_SHIFT && COLUMN_SHIFT + COLUMN_BITS <= NEXT_SHIFT);

impl Slot {
    /// An empty slot.
    pub const EMPTY: Self = Self {
        offset_us: 0,
        link: 0,
    };

    /// `next` as [`Self::next`]; `column_and_sign` is x modulo 32 at [`COLUMN_SHIFT`], plus 1 for ON.
    #[inline]
    pub(crate) const fn new(offset_us: u32, next: u32, column_and_sign: u32) -> Self {
        Self {
            offset_us,
            link: (next << NEXT_SHIFT) | (column_and_sign & ((1 << NEXT_SHIFT) - 1)),
        }
    }

    pub(crate) const fn offset_us(self) -> u32 {
        self.offset_us
    }

    /// The next slot, [`NO_SLOT`] at the end of the list.
    pub(crate) const fn next(self) -> u32 {
        self.link >> NEXT_SHIFT
    }

    pub(crate) const fn with_offset_us(self, offset_us: u32) -> Self {
        Self { offset_us, ..self }
    }

    pub(crate) const fn with_next(self, next: u32) -> Self {
        Self::new(self.offset_us, next, self.link)
    }

    /// x modulo 32.
    pub(crate) const fn column(self) -> u32 {
        (self.link >> COLUMN_SHIFT) % SEGMENT_PIXELS as u32
    }

    /// 1 for ON, 0 for OFF.
    pub(crate) const fn sign(self) -> u32 {
        self.link & ((1 << SIGN_BITS) - 1)
    }

    pub(crate) const fn is_on(self) -> bool {
        self.link & 1 == 1
    }
}

pub(crate) const COLUMN_BITS: u32 = 5;
/// Columns of a segment: the run of pixels whose events share one list.
pub const SEGMENT_PIXELS: u16 = 1 << COLUMN_BITS;

/// Most events that a window's buffer can hold: keeps |c|^2 of any pixel within 64 bits, and the
/// 24 bits of a link address them.
pub const EVENTS_MAX: usize = (1 << 24) - 1;

/// A slot, all ones for none. On a microcontroller, whose windows are short, 16 bits halve the heads.
#[cfg(all(target_os = "none", target_pointer_width = "32"))]
pub type Head = u16;
/// A slot, all ones for none.
#[cfg(not(all(target_os = "none", target_pointer_width = "32")))]
pub type Head = u32;

/// The end of a list, in place of a slot: beyond those of any window.
pub(crate) const NO_SLOT: u32 = u32::MAX >> NEXT_SHIFT;
const _: () = assert!(SLOTS_MAX <= NO_SLOT as usize);

/// The head of an empty list. Assembly also leaves others beyond [`SLOTS_MAX`], which mean the same.
pub(crate) const NO_HEAD: Head = NO_SLOT as Head;

/// Most slots of a window on this target: [`EVENTS_MAX`], or what a [`Head`] can address with a bit
/// to spare, which is the sign that ends a list.
pub const SLOTS_MAX: usize = if (Head::MAX as usize >> 1) < EVENTS_MAX {
    Head::MAX as usize >> 1
} else {
    EVENTS_MAX
};

/// Segments of a sensor: rows of ceil(width / 32).
#[must_use]
pub const fn segments(width: u16, height: u16) -> usize {
    width.div_ceil(SEGMENT_PIXELS) as usize * height as usize
}

/// Words of the bitmap over `segments`.
#[must_use]
pub const fn bitmap_words(segments: usize) -> usize {
    segments.div_ceil(32)
}

/// Windows without events in a row that [`WindowConfig::every_window`] closes, at most: a longer gap is a clock's
/// jump rather than a scene without motion, and is skipped.
pub const EMPTY_WINDOWS_MAX: u64 = 1 << 16;

/// Which sensor, how long a window is, and where windows begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WindowConfig {
    /// Sensor that the events come from.
    pub sensor: Sensor,
    /// T in microseconds, at least 1.
    pub window_us: u32,
    /// A boundary of the grid of windows in microseconds: they begin at `origin_us` + i T for whole i, so that
    /// those of several sensors match. `None`: the grid begins with each run's first event.
    pub origin_us: Option<u64>,
    /// Windows without events are closed too, [`EMPTY_WINDOWS_MAX`] of them in a row at most, so that a receiver
    /// knows that the sensor is there and saw nothing.
    pub every_window: bool,
}

impl WindowConfig {
    /// Windows of `window_us` that begin with the first event; those without events are skipped.
    #[must_use]
    pub const fn new(sensor: Sensor, window_us: u32) -> Self {
        Self {
            sensor,
            window_us,
            origin_us: None,
            every_window: false,
        }
    }

    /// Time from the last boundary of the grid to `t_us`; 0 without an origin.
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

    /// Where a window begins that nothing is before and that holds `t_us`.
    const fn start_us(&self, t_us: u64) -> u64 {
        t_us.saturating_sub(self.since_boundary_us(t_us))
    }

    /// Time from a window's start to its end: T, or less where it begins within the grid.
    const fn duration_us(&self, start_us: u64) -> u32 {
        self.window_us - self.since_boundary_us(start_us) as u32
    }
}

/// Memory lent to a window, zeroed.
#[derive(Debug)]
pub struct WindowBuffers<'b> {
    /// The events; as many as the window may hold, at most [`SLOTS_MAX`].
    pub slots: &'b mut [Slot],
    /// [`segments`] of them: the newest event of each segment.
    pub heads: &'b mut [Head],
    /// [`bitmap_words`] words: which segments have events.
    pub bitmap: &'b mut [u32],
}

impl<'b> WindowBuffers<'b> {
    /// Divides memory between the buffers of `windows` windows of a sensor, in equal shares, and
    /// zeroes them; each holds as many events as its share has room for. `None` where a share has
    /// no room for an event.
    ///
    /// So one image serves every sensor that fits: what a smaller sensor's segments leave holds
    /// events.
    pub fn share(
        memory: &'b mut [u32],
        windows: usize,
        sensor: Sensor,
    ) -> Option<impl Iterator<Item = Self> + use<'b>> {
        let segments = segments(sensor.width, sensor.height);
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

/// Words taken at once of a time that lies in a window in part.
const STRADDLING_WORDS: usize = 64;

/// Events of a segment that [`Window::sample`] hands out.
const SAMPLES_OF_SEGMENT: u32 = 4;

const SLOT_WORDS: usize = size_of::<Slot>() / size_of::<u32>();

/// What became of a pushed event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Push {
    /// It is in the window.
    Stored,
    /// Its pixel is not on the sensor: counted as dropped.
    Outside,
    /// The window is closed and the event is not in it: encode the window, then push it again.
    Closed,
}

/// What [`Window::push_words`] took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Taken {
    /// Words taken from the front. Fewer than there were: the window is closed, and the next word
    /// is the event that is not in it.
    pub words: usize,
    /// Events among them, those outside of the sensor included.
    pub events: u32,
    /// Words among them that were no events and no times, and events before the first time.
    pub ignored: u32,
}

/// Events that are in no window, by cause, since the last frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Too old for their window: none of this encoder, whose windows begin anew for them.
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
    /// The clock fell back before the window: a new run of windows begins with it.
    pub begins_run: bool,
}

/// Where a window starts that follows another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NextStart {
    /// In microseconds; `None` where the next event will be the start.
    pub us: Option<u64>,
    /// A new run begins there.
    pub begins_run: bool,
}

impl NextStart {
    /// At the next event.
    pub const ANY: Self = Self {
        us: None,
        begins_run: false,
    };

    /// At a time, on the same run.
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
/// Windows are half-open, consecutive and aligned to the first event, or to [`WindowConfig::origin_us`]. A window
/// closes
///
/// * when an event at or after t0 + T comes: duration T, and the next window starts on the grid
///   t0 + i T at or before that event;
/// * early, when an event comes and the buffer is full: the duration is the time up to that
///   event, and at least one microsecond beyond the latest event held, so that u < 1 for all of
///   them; the next window starts at that event, and with an origin ends where the grid's window does;
/// * when an event before t0 comes: duration T, and the next window starts at that event and begins
///   a new *run*, so that no event is too late ([`crate::ingest::reorder`] keeps small disorder from it);
/// * on [`Window::flush`]: duration T; the next window is aligned to the next event.
///
/// Order inside a window does not matter. An event costs O(1); memory is what was lent.
#[derive(Debug)]
pub struct Window<'b> {
    config: WindowConfig,
    slots: &'b mut [Slot],
    /// Exactly as many as the sensor has segments.
    heads: &'b mut [Head],
    /// As many bits as there are segments, from [`FIRST`] on.
    bitmap: &'b mut [u32],
    /// Segments in a row.
    stride: NonZeroU32,
    len: u32,
    latest: Latest,
    /// Start of the open window, or of the next where none is open; None before the first event.
    start_us: Option<u64>,
    /// Time from there to the window's end.
    duration_us: u32,
    /// A run begins with the open window, or with the next where none is open.
    begins_run: bool,
    closed: Option<Closed>,
    counts: Counts,
}

impl<'b> Window<'b> {
    /// A window over lent buffers, or `None` where they are too small for the sensor, there is no
    /// room for an event, there are more than [`SLOTS_MAX`] slots, T is 0, or a side of the sensor
    /// is 0 or above [`Sensor::SIDE_MAX`].
    #[must_use]
    pub const fn new(config: WindowConfig, buffers: WindowBuffers<'b>) -> Option<Self> {
        let segments = segments(config.sensor.width, config.sensor.height);
        let WindowBuffers {
            slots,
            heads,
            bitmap,
        } = buffers;
        // A frame of a sensor that `Sensor::new` refuses would be refused by every reader.
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
        // Not 0, which is a slot: so an index needs no 1 off on its way.
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
            latest: Latest::NONE,
            start_us: None,
            duration_us: config.window_us,
            begins_run: false,
            closed: None,
            counts: Counts::NONE,
        })
    }

    /// Adds an event, or says why not.
    #[cfg_attr(target_pointer_width = "64", inline)]
    pub fn push(&mut self, event: Event) -> Push {
        // On a host the events of a window are stored in place, wherever they come from.
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

    /// [`Self::push`] of any event.
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

    #[cfg_attr(target_pointer_width = "64", inline(always))]
    #[cfg_attr(not(target_pointer_width = "64"), inline)]
    fn store(&mut self, event: Event, offset_us: u32) {
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

    /// Adds the events of EVT 2.0 words, little-endian, up to the one that closes the window: what
    /// [`Evt2Decoder::decode`] and [`Self::push`] do a word at a time, at less than half of their
    /// cost.
    ///
    /// Where fewer words are taken than there are, encode the window and push the rest again.
    pub fn push_words(&mut self, decoder: &mut Evt2Decoder, words: &[[u8; 4]]) -> Taken {
        let mut taken = Taken::default();
        while taken.words < words.len() {
            let rest = &words[taken.words..];
            let before = self.len;
            taken.words += self.store_words(decoder, rest);
            taken.events += self.len - before;
            // What ended the run: anything out of the ordinary.
            let Some(word) = words.get(taken.words) else {
                break;
            };
            match decoder.decode(u32::from_le_bytes(*word)) {
                Word::Event(event) => {
                    if self.push(event) == Push::Closed {
                        break;
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

    /// Stores events on the sensor while there are slots, and follows the decoder's time forwards
    /// while it lies in the window; returns how many words it took.
    fn store_words(&mut self, decoder: &mut Evt2Decoder, words: &[[u8; 4]]) -> usize {
        let (Some(time_us), Some(start_us), None) = (decoder.span_us(), self.start_us, self.closed)
        else {
            return 0;
        };
        // The last windows end with the last microsecond there is.
        let window_us = u64::from(self.duration_us).min((u64::MAX - start_us).saturating_add(1));
        let since_start = time_us.wrapping_sub(start_us) as i64;
        let to_end = (window_us as i64).saturating_sub(since_start);
        if since_start <= -i64::from(SPAN_US) || to_end <= 0 {
            return 0;
        }
        let (mut words, mut ahead_us) = (words, 0);
        if since_start < 0 || to_end < i64::from(SPAN_US) {
            // Some of the times that a word can add are not in the window: without the words of
            // those, and of the next time, the rest is as always.
            let inside = (-since_start).max(0) as u32..to_end.min(i64::from(SPAN_US)) as u32;
            let is_inside = |word: &[u8; 4]| {
                let word = u32::from_le_bytes(*word);
                is_event(word) && inside.contains(&low_us(word))
            };
            // A few at a time: the first one off the sensor has the rest looked at again.
            let few = words.iter().take(STRADDLING_WORDS);
            let few = few.take_while(|word| is_inside(word)).count();
            words = words.get(..few).unwrap_or_default();
        } else {
            ahead_us = (to_end - i64::from(SPAN_US)) as u32;
        }
        let span_us = since_start as u32;
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
        let taken = intake.take(words);
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
        // One from before the window is the first: no events are earlier than its own.
        if since_start >= 0 {
            self.latest.span(span_us, span_at, len);
        }
        self.len = len;
        decoder.step_to_word(time);
        taken
    }

    /// Largest offset of the events held, or less where that is below `at_least_us` anyway.
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

    /// Stores events from the front while they lie in the open window and on the sensor and there is
    /// room; returns how many.
    #[cfg_attr(target_pointer_width = "64", inline)]
    pub(crate) fn push_inside(&mut self, events: &[Event]) -> usize {
        let (Some(start_us), None) = (self.start_us, self.closed) else {
            return 0;
        };
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
            self.store(*event, offset_us as u32);
            stored += 1;
        }
        stored
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

    /// Opens at `start_us`, which is returned.
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

    /// Begins a new run with an event at `t_us`, after the events that the window holds.
    pub(crate) fn fall_back(&mut self, t_us: u64) {
        self.begin_run(Some(self.config.start_us(t_us)));
    }

    /// Begins a new run with the next event, after the events that the window holds.
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

    /// Closes the open window, whose time has run: the next one goes on along the grid.
    pub(crate) fn advance(&mut self) {
        if let (Some(start_us), None) = (self.start_us, self.closed) {
            let next_us = start_us.saturating_add(u64::from(self.duration_us));
            self.close(self.duration_us, false, NextStart::at(next_us));
        }
    }

    /// Moves an empty open window along the grid to where it holds `t_us`, which is not before it; one
    /// that has no start starts there. Where windows without events are wanted, it is closed instead.
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

    /// Closes the window where it holds events or counts; the stream starts anew after it.
    pub fn flush(&mut self) {
        if self.closed.is_none() && (self.len > 0 || self.counts.any()) {
            self.close(self.duration_us, false, NextStart::ANY);
        }
    }

    /// Closes the window where it holds events, or where those without are wanted, and its time has run at
    /// `now_us`, before which no event will come any more: a live sensor that sees nothing does not hold its
    /// last events back. The next window goes on along the grid.
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

    /// Start of the window after this one, or of this one while it is open.
    #[must_use]
    pub const fn next_start(&self) -> NextStart {
        NextStart {
            us: self.start_us,
            begins_run: self.begins_run,
        }
    }

    /// Continues the grid of another window: this one, empty and open, starts where the other's
    /// [`Window::next_start`] says.
    pub const fn follow(&mut self, start: NextStart) {
        if self.len == 0 && self.closed.is_none() {
            self.follow_on(start);
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

    /// Time from the open window's start to its end: T, or less where it begins within the grid.
    #[must_use]
    pub const fn duration_us(&self) -> u32 {
        self.duration_us
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
        debug_assert!(self.bitmap.iter().all(|word| *word == 0));
        self.len = 0;
        self.latest = Latest::NONE;
        self.closed = None;
    }

    /// Takes the next 32 segments of which some have events: the first one's index, and a bit for
    /// each.
    ///
    /// The cost follows the segments that have events and 1/32 of all segments.
    #[inline]
    pub(crate) fn take_segments(&mut self, cursor: &mut usize) -> Option<(u32, u32)> {
        let words = self.bitmap.get_mut(*cursor..)?;
        let at = first_used(words)?;
        let segment = (*cursor + at) as u32 * 32;
        *cursor += at + 1;
        Some((segment, core::mem::take(words.get_mut(at)?)))
    }

    /// Takes a segment's list: the slot of its newest event.
    #[inline]
    pub(crate) fn take_head(&mut self, segment: u32) -> u32 {
        let head = self.heads.get_mut(segment as usize);
        head.map_or(NO_SLOT, |head| index(core::mem::replace(head, NO_HEAD)))
    }

    /// Position and time of up to `most` events, of every segment the newest ones, before they are taken.
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

    /// The first segment from one on that has events.
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

    /// Which columns of a segment have events, and which have several.
    pub(crate) fn columns_of(&self, segment: u32) -> (u32, u32) {
        let (mut occupied, mut crowded) = (0, 0);
        let bits = self.bitmap.get(segment as usize / 32).copied();
        // Of a segment without events the list may be an old one.
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

    /// A used segment's list: the slot of its newest event.
    pub(crate) fn head_of(&self, segment: u32) -> u32 {
        let head = self.heads.get(segment as usize).copied();
        head.map_or(NO_SLOT, index)
    }

    /// Leaves of a used segment the events of these columns; returns how many went.
    pub(crate) fn keep_columns(&mut self, segment: u32, columns: u32) -> u32 {
        self.keep(segment, |_, slot| columns >> slot.column() & 1 == 1)
    }

    /// Leaves `share_q16` of 2^16 events, evenly by when they came; returns how many went.
    pub(crate) fn thin(&mut self, share_q16: u32) -> u32 {
        let (mut removed, mut from) = (0, 0);
        while let Some(segment) = self.next_used(from) {
            removed += self.keep(segment, |at, _| {
                // Those at which a sum of shares passes a whole number.
                at.wrapping_mul(share_q16) % (1 << 16) < share_q16
            });
            from = segment + 1;
        }
        removed
    }

    /// Leaves of a used segment what is to be kept, of a closed window.
    fn keep(&mut self, segment: u32, is_kept: impl Fn(u32, Slot) -> bool) -> u32 {
        let mut removed = 0;
        let mut at = self.head_of(segment);
        // The last one kept.
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
        removed
    }

    /// The buffered events.
    #[inline]
    pub(crate) const fn slots(&mut self) -> &mut [Slot] {
        self.slots
    }

    /// The same to look at.
    #[inline]
    pub(crate) const fn slots_now(&self) -> &[Slot] {
        self.slots
    }

    /// Slots, heads, and segments in a row, for assembly.
    #[allow(dead_code, reason = "assembly alone asks")]
    pub(crate) const fn parts(&mut self) -> (&mut [Slot], &mut [Head], NonZeroU32) {
        (self.slots, self.heads, self.stride)
    }

    /// Position of a segment's first pixel.
    #[inline]
    pub(crate) fn segment_origin(&self, segment: u32) -> (u16, u16) {
        let y = segment / self.stride;
        let x = (segment - y * self.stride.get()) * u32::from(SEGMENT_PIXELS);
        (x as u16, y as u16)
    }
}

/// Index of the first word that has bits.
#[inline(always)]
fn first_used(words: &[u32]) -> Option<usize> {
    // On a large sensor few of them have: a host looks at several at once.
    let mut skipped = 0;
    if cfg!(target_pointer_width = "64") {
        let (chunks, _) = words.as_chunks::<16>();
        let is_empty = |chunk: &&[u32; 16]| chunk.iter().fold(0, |all, bits| all | bits) == 0;
        skipped = 16 * chunks.iter().take_while(is_empty).count();
    }
    let rest = words.get(skipped..)?;
    Some(skipped + rest.iter().position(|bits| *bits != 0)?)
}

/// What is known of the largest offset: enough to find it in the slots when it is asked for.
///
/// Events of words are not looked at one by one as they come; the latest of them is in the latest
/// span of time, the events that share a `TIME_HIGH`.
#[derive(Debug, Clone, Copy)]
struct Latest {
    /// Largest offset of the events that were pushed as events.
    event_us: u32,
    /// Offset of the latest span that had events.
    span_us: u32,
    /// Slot of its first event.
    span_at: u32,
}

impl Latest {
    const NONE: Self = Self {
        event_us: 0,
        span_us: 0,
        span_at: 0,
    };

    /// The slots `from..to` were filled in this span.
    #[inline]
    const fn span(&mut self, span_us: u32, from: u32, to: u32) {
        if from < to && span_us > self.span_us {
            self.span_us = span_us;
            self.span_at = from;
        }
    }
}

/// What a head holds, whatever its width here.
#[allow(clippy::unnecessary_cast)]
#[inline]
pub(crate) const fn index(head: Head) -> u32 {
    head as u32
}

/// The first of 32 in a word: the highest bit, since a word is turned and counted from there.
pub(crate) const FIRST: u32 = 1 << 31;
