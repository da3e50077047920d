//! Corrects small disorder of event times across the boundaries of windows.
//!
//! The order inside a window does not matter. So only events *after* the open window are held back, for as long as
//! an earlier event can still arrive. An event in the open window goes into it at once. If times ascend, no more is
//! held than the events of the N microseconds after a window's end.
//!
//! * A window is complete when an event N us or more after its end has arrived, when the memory is full, when the
//!   input ends, or when [`Reorder::pass`] reports a time after its end.
//! * A run's first window begins at the earliest event of the run's first N us.
//! * An event before the open window ends the run: all held events go into windows, and a new run
//!   ([`crate::frame::Header::begins_run`]) begins. No event is ever too late.
//!
//! The result depends only on the events, N and the length of the memory, not on how many events arrive at a time.

use crate::window::{Push, Window};
use event_types::Event;

/// What the held events wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waits {
    /// Later events.
    Events,
    /// Nothing: a new run follows them.
    Run,
    /// Nothing: they are the last.
    End,
}

/// Holds events back between a source and its windows.
#[derive(Debug)]
pub struct Reorder<M> {
    /// A ring buffer of events.
    memory: M,
    reorder_us: u64,
    first: usize,
    len: usize,
    /// Times of the latest and of the earliest held event.
    newest_us: u64,
    oldest_us: u64,
    /// Whether no held event is earlier than one before it.
    is_ascending: bool,
    waits: Waits,
    /// No event before this time will arrive any more; 0 if unknown.
    now_us: u64,
}

impl<M: AsRef<[Event]> + AsMut<[Event]>> Reorder<M> {
    /// Creates a buffer that holds events for `reorder_us` microseconds in `memory`, whose content does not matter.
    /// If either is empty or 0, events go into windows as they arrive.
    #[must_use]
    pub const fn new(memory: M, reorder_us: u32) -> Self {
        Self {
            memory,
            reorder_us: reorder_us as u64,
            first: 0,
            len: 0,
            newest_us: 0,
            oldest_us: u64::MAX,
            is_ascending: true,
            waits: Waits::Events,
            now_us: 0,
        }
    }

    /// Returns the number of held events.
    #[must_use]
    pub const fn held(&self) -> usize {
        self.len
    }

    /// Takes events from the front until the window closes; returns how many it took.
    ///
    /// If the window has closed, encode it and call again with the remaining events and the window that follows it.
    pub fn fill(&mut self, window: &mut Window<'_>, events: &[Event]) -> usize {
        self.release(window);
        let mut taken = 0;
        while window.closed().is_none() {
            let rest = events.get(taken..).unwrap_or_default();
            taken += window.push_inside(rest);
            let rest = events.get(taken..).unwrap_or_default();
            let Some(event) = rest.first() else {
                break;
            };
            if self.len == 0 && self.is_complete(window, rest) {
                window.advance();
            } else if self.take(window, *event) {
                taken += 1;
            }
        }
        taken
    }

    /// Ends the input: moves held events into the window and closes it. Call again with the window that follows it,
    /// until the window stays open.
    pub fn flush(&mut self, window: &mut Window<'_>) {
        self.waits = Waits::End;
        self.release(window);
        if self.len == 0 && window.closed().is_none() {
            self.waits = Waits::Events;
            window.flush();
        }
    }

    /// Closes the window if its time is over at `now_us`, before which no event will arrive any more; see
    /// [`Window::pass`].
    pub fn pass(&mut self, window: &mut Window<'_>, now_us: u64) {
        self.now_us = now_us;
        self.release(window);
        self.now_us = 0;
        if self.len == 0 {
            window.pass(now_us);
        }
    }

    /// Returns whether the window has events and the next events, in order and after it, complete it. They then need
    /// not be held.
    fn is_complete(&self, window: &Window<'_>, events: &[Event]) -> bool {
        let (Some(start_us), 1..) = (window.next_start().us, window.events()) else {
            return false;
        };
        let sensor = window.config().sensor;
        let window_us = u64::from(window.duration_us());
        let mut before_us = start_us;
        for event in events {
            let since_us = event.t_us.wrapping_sub(start_us);
            let is_behind = event.t_us >= before_us && since_us >= window_us;
            if !is_behind || !sensor.contains(event.x, event.y) {
                return false;
            }
            before_us = event.t_us;
            if since_us - window_us >= self.reorder_us {
                return true;
            }
        }
        false
    }

    /// Takes an event into the window or holds it; returns `false` if the event must be offered again.
    fn take(&mut self, window: &mut Window<'_>, event: Event) -> bool {
        let sensor = window.config().sensor;
        let is_off = self.reorder_us == 0 || self.memory.as_ref().is_empty();
        if is_off || !sensor.contains(event.x, event.y) {
            return window.push(event) != Push::Closed;
        }
        let window_us = u64::from(window.duration_us());
        let since_us = match window.next_start().us {
            Some(start_us) => event.t_us.checked_sub(start_us),
            // The run has no window yet.
            None if event.t_us.saturating_add(self.reorder_us) < self.newest_us => None,
            None => Some(window_us),
        };
        match since_us {
            None => {
                self.waits = Waits::Run;
                self.release(window);
                false
            }
            Some(since_us) if since_us < window_us => window.push(event) != Push::Closed,
            Some(_) => {
                let held = self.hold(event);
                self.release(window);
                held
            }
        }
    }

    /// Moves held events into the window, and closes it if it is complete.
    fn release(&mut self, window: &mut Window<'_>) {
        while window.closed().is_none() {
            if self.len == 0 {
                if self.waits == Waits::Run {
                    window.end_run();
                    self.waits = Waits::Events;
                }
                return;
            }
            match window.next_start().us {
                // An event from before the window, left over when a full window took unsorted ones.
                Some(start_us) if self.oldest_us < start_us => window.fall_back(self.oldest_us),
                Some(start_us) => {
                    let window_us = u64::from(window.duration_us());
                    if self.oldest_us - start_us < window_us {
                        self.move_in(window, start_us);
                        continue;
                    }
                    let end_us = start_us.saturating_add(window_us);
                    if !self.is_due(end_us, end_us) {
                        return;
                    }
                    if window.events() > 0 {
                        window.advance();
                    } else {
                        // Not past the time up to which earlier events may still arrive, unless the window is due
                        // for another reason.
                        let settled_us = self.newest_us.saturating_sub(self.reorder_us);
                        window.skip_to(if settled_us >= end_us {
                            self.oldest_us.min(settled_us)
                        } else {
                            self.oldest_us
                        });
                    }
                }
                None if self.is_due(self.oldest_us, self.newest_us) => {
                    window.skip_to(self.oldest_us);
                }
                None => return,
            }
        }
    }

    /// Returns whether no event before `from_us` is expected any more: an event far enough after it has arrived,
    /// the memory is full, or `now_us` has passed `passed_us`.
    fn is_due(&self, from_us: u64, passed_us: u64) -> bool {
        self.waits != Waits::Events
            || self.len >= self.memory.as_ref().len()
            || self.newest_us.saturating_sub(from_us) >= self.reorder_us
            || (self.now_us > 0 && self.now_us >= passed_us)
    }

    /// Moves the held events that lie in the window into it, up to one that closes it.
    fn move_in(&mut self, window: &mut Window<'_>, start_us: u64) {
        let window_us = u64::from(window.duration_us());
        let is_inside = |event: &Event| event.t_us >= start_us && event.t_us - start_us < window_us;
        if self.is_ascending {
            while let Some(event) = self.front().filter(is_inside) {
                if window.push(event) == Push::Closed {
                    break;
                }
                self.drop_front();
            }
            self.oldest_us = self.front().map_or(u64::MAX, |event| event.t_us);
            return;
        }
        // Goes round the ring once, in order.
        let before = self.len;
        let mut is_open = true;
        (self.newest_us, self.oldest_us, self.is_ascending) = (0, u64::MAX, true);
        for _ in 0..before {
            let Some(event) = self.front() else {
                break;
            };
            self.drop_front();
            if is_open && is_inside(&event) {
                is_open = window.push(event) != Push::Closed;
                if is_open {
                    continue;
                }
            }
            self.hold(event);
        }
    }

    fn front(&self) -> Option<Event> {
        let event = self.memory.as_ref().get(self.first);
        event.copied().filter(|_| self.len > 0)
    }

    fn drop_front(&mut self) {
        self.first = self.place(1);
        self.len = self.len.saturating_sub(1);
        if self.len == 0 {
            (self.newest_us, self.oldest_us, self.is_ascending) = (0, u64::MAX, true);
        }
    }

    /// Holds an event; returns `false` if there is no room.
    fn hold(&mut self, event: Event) -> bool {
        let at = self.place(self.len);
        let is_full = self.len >= self.memory.as_ref().len();
        let Some(place) = self.memory.as_mut().get_mut(at).filter(|_| !is_full) else {
            return false;
        };
        *place = event;
        self.len += 1;
        self.is_ascending &= event.t_us >= self.newest_us;
        self.newest_us = self.newest_us.max(event.t_us);
        self.oldest_us = self.oldest_us.min(event.t_us);
        true
    }

    /// Returns the index in the ring of the place `further` after the first.
    fn place(&self, further: usize) -> usize {
        let at = self.first + further;
        let places = self.memory.as_ref().len();
        if at >= places { at - places } else { at }
    }
}
