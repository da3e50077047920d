//! Codes a window's events into a hybrid frame: group, cells, then one of the coders.

use crate::coder::Times;
use crate::coder::bits_msb_first::BigWriter;
use crate::coder::content::{Content, END, Node, Parts, Walk};
use crate::coder::dense::Dense;
use crate::coder::fast::{Fast, ROOM_WORDS, Unordered, walk};
use crate::coder::range::RangeEncoder;
use crate::coder::tree::TreeEvent;
use crate::frame::Header;
use crate::group::sort::ascending;
use crate::group::{Group, Impulses, Pixel};
use crate::stage::{Stage, Trace};
use crate::window::{Slot, Window};

/// What one frame holds.
pub(crate) struct TakenEvents {
    pub(crate) payload_bytes: usize,
    pub(crate) events: u32,
    /// The window is coded to its end.
    pub(crate) is_last: bool,
    /// The output overran, so the next frame of the dense coder must be a key frame.
    pub(crate) overran: bool,
}

/// What is kept of a window between frames.
pub(crate) struct EventEncoder<'e, 'w, 'b> {
    group: &'e mut Group,
    window: &'w mut Window<'b>,
    times: Times,
    /// The next pixel was put back, so its offsets are replaced by coded times already.
    is_rest: &'e mut bool,
}

impl<'e, 'w, 'b> EventEncoder<'e, 'w, 'b> {
    pub(crate) const fn new(
        group: &'e mut Group,
        window: &'w mut Window<'b>,
        times: Times,
        is_rest: &'e mut bool,
    ) -> Self {
        Self {
            group,
            window,
            times,
            is_rest,
        }
    }

    /// Replaces a pixel's offsets by coded times, unless the pixel was put back after that was done.
    #[inline(always)]
    fn tell_times(&mut self, place: (u16, u16), head: u32) {
        if !*self.is_rest && !self.times.are_plain() {
            let slots = self.window.slots();
            let mut at = head;
            while let Some(slot) = slots.get_mut(at as usize) {
                at = slot.next();
                *slot = slot.with_offset_us(self.times.of(place, slot.offset_us()));
            }
        }
        *self.is_rest = false;
    }

    /// Returns the next pixel, its times coded and its list sorted by them.
    #[inline(always)]
    fn next(&mut self) -> Option<Pixel> {
        let mut pixel = self.group.next(self.window)?;
        self.tell_times((pixel.x, pixel.y), pixel.head);
        if pixel.on + pixel.off > 1 {
            pixel.head = ascending(self.window.slots(), pixel.head);
        }
        Some(pixel)
    }

    /// Returns the next pixel, its times coded, in the list's order and without ON and OFF counts.
    #[inline(always)]
    fn next_uncounted(&mut self) -> Option<Pixel> {
        let pixel = self.group.next_uncounted(self.window)?;
        self.tell_times((pixel.x, pixel.y), pixel.head);
        Some(pixel)
    }

    /// Puts back what is left of a pixel, from slot `head` on, for the next frame.
    fn put_back(&mut self, pixel: Pixel, head: u32) {
        let slots = self.window.slots();
        let mut rest = Pixel {
            on: 0,
            off: 0,
            head,
            ..pixel
        };
        for impulse in Impulses::new(rest, slots) {
            rest.on += u32::from(impulse.is_on);
            rest.off += u32::from(!impulse.is_on);
        }
        self.group.put_back(rest);
        *self.is_rest = true;
    }

    /// As [`Self::put_back`], for a pixel from [`Self::next_uncounted`].
    fn put_back_uncounted(&mut self, pixel: Pixel, head: u32) {
        self.group.put_back(Pixel { head, ..pixel });
        *self.is_rest = true;
    }

    /// Codes pixels with [`Fast`] into `out`.
    #[inline(never)]
    pub(crate) fn fast<T: Trace>(
        &mut self,
        header: &Header,
        out: &mut [u8],
        trace: &mut T,
    ) -> TakenEvents {
        let mut writer = BigWriter::new(out);
        let mut coder = Fast::new(header.sensor, header.window_events, self.times.count());
        let mut taken = TakenEvents {
            payload_bytes: 0,
            events: 0,
            is_last: true,
            overran: false,
        };
        loop {
            if walk::IS_THERE && !T::LISTENS && self.times.are_plain() {
                // The walk codes all pixels but those that it leaves to the loop below.
                *self.is_rest = false;
                let all = (&mut *self.group, &mut *self.window);
                taken.events += walk::walk(all, &mut coder, &mut writer);
            }
            let Some(mut pixel) = self.next_uncounted() else {
                break;
            };
            if !writer.has_words(ROOM_WORDS) {
                self.put_back_uncounted(pixel, pixel.head);
                taken.is_last = false;
                break;
            }
            trace.enter(Stage::Pack);
            let written = loop {
                let impulses = Impulses::new(pixel, self.window.slots());
                let events = impulses.map(|impulse| (impulse.offset_us, impulse.is_on));
                match coder.write((pixel.x, pixel.y), events, &mut writer) {
                    Ok(written) => break written,
                    // Events nearly always come in order, so checking first would cost more than a rare second
                    // attempt.
                    Err(Unordered) => pixel.head = ascending(self.window.slots(), pixel.head),
                }
            };
            taken.events += written.events;
            if !written.is_whole {
                let head = nth(self.window.slots(), pixel.head, written.events);
                self.put_back_uncounted(pixel, head);
                taken.is_last = false;
                break;
            }
            trace.enter(Stage::Group);
        }
        taken.payload_bytes = writer.finish();
        taken
    }

    /// Codes pixels with [`Dense`] into `out`; the window has `left` events that are not coded yet.
    #[inline(never)]
    pub(crate) fn dense<T: Trace>(
        &mut self,
        dense: &mut Dense<'_>,
        left: u32,
        out: &mut [u8],
        trace: &mut T,
    ) -> TakenEvents {
        trace.enter(Stage::Pack);
        let mut coder = RangeEncoder::new(out);
        let times = self.times;
        let mut content = Pixels {
            pixel: None,
            at: 0,
            slot: Slot::EMPTY,
            rest: 0,
            left,
            is_portable: T::IS_PORTABLE,
            encoder: self,
        };
        let coded = dense.code(&mut coder, &mut content, times);
        let (pixel, at, rest) = (content.pixel, content.at, content.rest);
        if let Some(pixel) = pixel
            && rest > 0
        {
            self.put_back(pixel, at);
        }
        trace.enter(Stage::Group);
        TakenEvents {
            payload_bytes: coder.finish(),
            events: coded.events,
            is_last: coded.events == left,
            overran: coded.overran,
        }
    }
}

impl EventEncoder<'_, '_, '_> {
    /// Takes all of the window's events, in raster order and in a pixel by coded time. Returns how many there are and
    /// how many pixels they have.
    #[inline(never)]
    pub(crate) fn gather(&mut self, events: &mut [TreeEvent]) -> (usize, u32) {
        let mut places = events.iter_mut();
        let (mut taken, mut pixels) = (0, 0);
        while let Some(pixel) = self.next() {
            pixels += 1;
            let impulses = Impulses::new(pixel, self.window.slots());
            // In this order: the other would take a place too many.
            for (impulse, place) in impulses.zip(places.by_ref()) {
                *place = TreeEvent::at((pixel.x, pixel.y), impulse.offset_us, impulse.is_on);
                taken += 1;
            }
        }
        (taken, pixels)
    }
}

/// Codes events of a window that were gathered, from `events` on, with [`Dense`] into `out`.
#[inline(never)]
pub(crate) fn dense_gathered(
    dense: &mut Dense<'_>,
    events: &[TreeEvent],
    times: Times,
    out: &mut [u8],
) -> TakenEvents {
    let mut coder = RangeEncoder::new(out);
    let mut content = Gathered {
        events,
        at: 0,
        end: 0,
    };
    let coded = dense.code(&mut coder, &mut content, times);
    TakenEvents {
        payload_bytes: coder.finish(),
        events: coded.events,
        is_last: coded.events as usize == events.len(),
        overran: coded.overran,
    }
}

/// Gathered events, as the dense coder reads them.
struct Gathered<'g> {
    events: &'g [TreeEvent],
    /// The next event, and where the current pixel ends.
    at: usize,
    end: usize,
}

impl Gathered<'_> {
    fn rest(&self) -> &[TreeEvent] {
        self.events.get(self.at..).unwrap_or_default()
    }

    fn next(&self) -> Option<TreeEvent> {
        self.rest().first().copied()
    }
}

/// Columns of a segment.
const SEGMENT: u16 = 32;

impl Content for Gathered<'_> {
    fn has_row(&mut self, y: u16) -> bool {
        self.next().is_some_and(|event| event.position().1 == y)
    }

    fn has_segment(&mut self, segment: u16, y: u16) -> bool {
        self.next().is_some_and(|event| {
            let (x, row) = event.position();
            (x / SEGMENT, row) == (segment, y)
        })
    }

    fn columns(&mut self) -> u32 {
        let segment = |event: &TreeEvent| {
            let (x, y) = event.position();
            (x / SEGMENT, y)
        };
        let Some(first) = self.next() else {
            return 0;
        };
        let same = self
            .rest()
            .iter()
            .take_while(|event| segment(event) == segment(&first));
        same.fold(0, |columns, event| {
            columns | 1 << (event.position().0 % SEGMENT)
        })
    }

    fn enter(&mut self, position: (u16, u16)) -> u32 {
        let same = self
            .rest()
            .iter()
            .take_while(|event| event.position() == position);
        self.end = self.at + same.count();
        self.at as u32
    }

    fn is_more(&self) -> bool {
        self.at < self.end
    }

    fn peek(&self) -> (u32, bool) {
        self.next()
            .map_or((0, false), |event| (event.coded_time(), event.is_on()))
    }

    fn take(&mut self, _cell: u32, _on: bool) {
        self.at += 1;
    }

    fn is_over(&self) -> bool {
        self.at >= self.events.len()
    }

    fn at(&self, list: u32) -> Option<Node> {
        let event = self.events.get(list as usize)?;
        let next = self.events.get(list as usize + 1);
        let is_same = next.is_some_and(|next| next.position() == event.position());
        Some(Node {
            cell: event.coded_time(),
            on: event.is_on(),
            next: if is_same { list + 1 } else { END },
        })
    }
}

fn nth(slots: &[Slot], mut at: u32, count: u32) -> u32 {
    for _ in 0..count {
        let Some(slot) = slots.get(at as usize) else {
            break;
        };
        at = slot.next();
    }
    at
}

/// The window, as the dense coder reads it.
struct Pixels<'p, 'e, 'w, 'b> {
    encoder: &'p mut EventEncoder<'e, 'w, 'b>,
    /// The current pixel, the number of its next event's slot, that slot's content, and how many events it has
    /// left.
    pixel: Option<Pixel>,
    at: u32,
    slot: Slot,
    rest: u32,
    /// Events of the window that are not coded yet.
    left: u32,
    /// [`Trace::IS_PORTABLE`].
    is_portable: bool,
}

impl Pixels<'_, '_, '_, '_> {
    #[inline(always)]
    fn go_to(&mut self, at: u32) {
        let slots = self.encoder.window.slots_now();
        self.at = at;
        self.slot = slots.get(at as usize).copied().unwrap_or(Slot::EMPTY);
    }
}

impl Content for Pixels<'_, '_, '_, '_> {
    fn has_row(&mut self, y: u16) -> bool {
        let EventEncoder { group, window, .. } = &mut *self.encoder;
        group.is_next_in_row(window, y)
    }

    fn has_segment(&mut self, segment: u16, y: u16) -> bool {
        let EventEncoder { group, window, .. } = &mut *self.encoder;
        group.is_next_in_segment(window, (segment, y))
    }

    fn columns(&mut self) -> u32 {
        // `has_segment` has moved the group to this segment.
        self.encoder.group.columns
    }

    fn enter(&mut self, _position: (u16, u16)) -> u32 {
        // The coder enters only pixels that `columns` has reported, so there is one.
        self.pixel = self.encoder.next();
        let (head, events) = self
            .pixel
            .map_or((0, 0), |pixel| (pixel.head, pixel.on + pixel.off));
        self.rest = events;
        self.go_to(head);
        head
    }

    #[inline(always)]
    fn is_more(&self) -> bool {
        self.rest > 0
    }

    #[inline(always)]
    fn peek(&self) -> (u32, bool) {
        (self.slot.offset_us(), self.slot.is_on())
    }

    #[inline(always)]
    fn take(&mut self, _cell: u32, _on: bool) {
        self.go_to(self.slot.next());
        self.rest = self.rest.saturating_sub(1);
        self.left = self.left.saturating_sub(1);
    }

    #[inline(always)]
    fn is_over(&self) -> bool {
        self.left == 0
    }

    #[inline(always)]
    fn with_parts<W: Walk>(&mut self, walk: W) -> Option<W::Walked> {
        if self.is_portable || !self.encoder.times.are_plain() {
            return None;
        }
        *self.encoder.is_rest = false;
        Some(walk.walk(Parts {
            group: &mut *self.encoder.group,
            window: &mut *self.encoder.window,
            left: &mut self.left,
            pixel: &mut self.pixel,
            at: &mut self.at,
            rest: &mut self.rest,
        }))
    }

    #[inline(always)]
    fn at(&self, list: u32) -> Option<Node> {
        let slot = self.encoder.window.slots_now().get(list as usize)?;
        Some(Node {
            cell: slot.offset_us(),
            on: slot.is_on(),
            next: slot.next(),
        })
    }
}
