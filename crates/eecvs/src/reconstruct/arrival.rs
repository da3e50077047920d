//! Restores the arrival order of events of equal time.

use eecvs_nostd::coder::arrival_order::place::{Group, Learned, place};
use eecvs_nostd::coder::range::{Binary, RangeDecoder};
use eecvs_nostd::{Axis, Event, Frame, Header};

use super::hybrid::Refused;
use super::order::by_time;
use super::same_window;

/// Reorders the events of windows whose frames send the arrival order.
#[derive(Debug, Default)]
pub struct Arrivals {
    /// Header of the latest frame of the window.
    latest: Option<Header>,
    /// Number of the window's next part, if none is missing so far.
    next_part: Option<u32>,
    /// Window whose order has been received in part.
    open: Option<Open>,
    /// Whether the window's frames send an order that cannot be decoded.
    is_lost: bool,
    counts: OrderCounts,
}

/// Number of windows whose frames send the arrival order of their events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OrderCounts {
    /// Windows whose events are in arrival order.
    pub kept: u64,
    /// Windows whose order cannot be decoded, because a frame is missing or malformed.
    pub lost: u64,
}

/// An arrival order that has been received in part.
#[derive(Debug)]
struct Open {
    /// Sorted by time, and by place within equal times.
    sorted: Vec<Event>,
    places: Vec<u32>,
    ordered: Vec<Event>,
    /// The current group: events `start..end` of `sorted`, which have equal times.
    start: usize,
    end: usize,
    group: Group,
    tree: Vec<u32>,
}

impl Arrivals {
    /// Returns the numbers of windows so far.
    pub const fn counts(&self) -> OrderCounts {
        self.counts
    }

    /// Takes a frame and all events of its window up to this frame, in the order of the frames. The last frame that
    /// sends a part of the order puts the events into arrival order.
    ///
    /// # Errors
    /// [`Refused::Malformed`]; the events are then unchanged, and the window's order is lost.
    pub fn frame(&mut self, frame: &Frame<'_>, events: &mut Vec<Event>) -> Result<(), Refused> {
        let header = &frame.header;
        let is_part = |earlier: &Header| same_window(earlier, header);
        if !self.latest.as_ref().is_some_and(is_part) {
            self.end();
            self.next_part = Some(0);
            self.is_lost = false;
        }
        self.latest = Some(*header);
        let is_next = self.next_part == Some(header.part);
        self.next_part = is_next.then(|| header.part.saturating_add(1));
        let Some(told) = header.order else {
            self.counts.kept += u64::from(header.ends_arrival() && is_next);
            return Ok(());
        };
        let open = self.open.take().filter(|_| is_next);
        if !is_next {
            self.lose();
            return Ok(());
        }
        let ordered = self.told(open, frame, told.events, events);
        if ordered.is_err() {
            self.next_part = None;
            self.lose();
        }
        ordered
    }

    fn told(
        &mut self,
        open: Option<Open>,
        frame: &Frame<'_>,
        count: u32,
        events: &mut Vec<Event>,
    ) -> Result<(), Refused> {
        let header = &frame.header;
        // The arrival order is sent after all events of the window.
        if events.len() != header.window_events as usize {
            return Err(Refused::Malformed);
        }
        let mut decoder = RangeDecoder::new(frame.sections().1);
        let mut open = match open {
            Some(open) => open,
            None => Open::new(header, events, &mut decoder),
        };
        let left = open.sorted.len() - open.ordered.len();
        let count = if header.last { left } else { count as usize };
        if count > left {
            return Err(Refused::Malformed);
        }
        open.take(count, &mut decoder)?;
        if header.last {
            *events = open.ordered;
            self.counts.kept += 1;
        } else {
            self.open = Some(open);
        }
        Ok(())
    }

    /// Ends the current window; an order that is not complete is counted as lost.
    pub fn end(&mut self) {
        if self.open.take().is_some() {
            self.lose();
        }
    }

    fn lose(&mut self) {
        self.counts.lost += u64::from(!self.is_lost);
        self.is_lost = true;
    }
}

impl Open {
    fn new(header: &Header, events: &[Event], decoder: &mut RangeDecoder<'_>) -> Self {
        let axis = if !events.is_empty() && decoder.plain(0, 1) == 1 {
            Axis::Columns
        } else {
            Axis::Rows
        };
        let place = |event: &Event| place(axis, (event.x, event.y));
        let mut sorted = by_time(header, events);
        // The sort is stable: events of the same pixel keep their order.
        sorted.sort_by_key(|event| (event.t_us, place(event)));
        Self {
            places: sorted.iter().map(place).collect(),
            ordered: Vec::with_capacity(sorted.len()),
            sorted,
            start: 0,
            end: 0,
            group: Group::EMPTY,
            tree: Vec::new(),
        }
    }

    /// Decodes the places of the next `count` events; `count` is at most the number of events left.
    fn take(&mut self, count: usize, decoder: &mut RangeDecoder<'_>) -> Result<(), Refused> {
        let mut learned = Learned::START;
        for _ in 0..count {
            if self.ordered.len() == self.end {
                self.start = self.end;
                let rest = &self.sorted[self.start..];
                let t_us = rest.first().map(|event| event.t_us);
                let len = rest.iter().take_while(|event| Some(event.t_us) == t_us);
                self.end = self.start + len.count();
                self.tree.clear();
                self.tree.resize(self.end - self.start, 0);
                self.group = Group::new(&mut self.tree);
            }
            let group = self.start..self.end;
            let places = &self.places[group.clone()];
            let place = |rank: u32| places.get(rank as usize).copied().unwrap_or(0);
            let rank = learned.code(decoder, (&mut self.group, &mut self.tree), place, 0);
            let event = rank.and_then(|rank| self.sorted[group].get(rank as usize));
            match event.filter(|_| !decoder.is_beyond()) {
                Some(event) => self.ordered.push(*event),
                None => return Err(Refused::Malformed),
            }
        }
        if decoder.is_spent() {
            Ok(())
        } else {
            Err(Refused::Malformed)
        }
    }
}
