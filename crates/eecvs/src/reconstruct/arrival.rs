//! The order in which events of equal time came, put back.

use eecvs_nostd::coder::arrival_order::place::{Group, Learned, place};
use eecvs_nostd::coder::range::{Binary, RangeDecoder};
use eecvs_nostd::{Axis, Event, Frame, Header};

use super::hybrid::Refused;
use super::order::by_time;
use super::same_window;

/// Puts the events of windows that tell their order into it.
#[derive(Debug, Default)]
pub struct Arrivals {
    /// The window's frame that came last.
    latest: Option<Header>,
    /// Number of its next part, where none is missing.
    next_part: Option<u32>,
    /// A window whose order has begun.
    open: Option<Open>,
    /// The window's frames tell an order that cannot be read.
    is_lost: bool,
    counts: OrderCounts,
}

/// Windows whose frames tell the order of their events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OrderCounts {
    /// They are in it.
    pub kept: u64,
    /// A frame is missing without which it cannot be told.
    pub lost: u64,
}

/// An order of which a part is told.
#[derive(Debug)]
struct Open {
    /// By time, and those of equal times by their places.
    sorted: Vec<Event>,
    places: Vec<u32>,
    ordered: Vec<Event>,
    /// The group at hand.
    start: usize,
    end: usize,
    group: Group,
    tree: Vec<u32>,
}

impl Arrivals {
    /// What was counted so far.
    pub const fn counts(&self) -> OrderCounts {
        self.counts
    }

    /// Takes a frame, and all events of its window up to it, in the order in which the frames have them.
    /// With the last frame that tells their order they are in it.
    ///
    /// # Errors
    /// [`Refused::Malformed`]; the events are as they were, and the window's order is lost.
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
        // The order follows all events.
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

    /// The window at hand has ended.
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
        // Those of the same pixel stay as they were.
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

    /// Reads the places of the next events, as many as are left at the most.
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
