//! Turns an event source into closed windows. Two windows alternate: one is filled while the other is encoded. With one
//! window, events stay in the source meanwhile ([`Exchange::may_wait`]).
//!
//! Runs in an interrupt: every step is short, and if no window is free, [`Ingest::poll`] returns and a later call
//! continues there.

pub mod from_link;
#[cfg(feature = "sensor")]
pub mod from_sensor;
pub mod reorder;

use crate::event_link::Setup;
use crate::window::{NextStart, Push, Window};
use event_types::Event;
use event_types::evt2::{Evt2Decoder, Word};

/// An item from an event source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Input {
    /// An EVT 2.0 word.
    Word(u32),
    /// This many events were lost here, and possibly a time.
    Lost(u32),
    /// This many events were dropped here, because there was no room for them; every time is known.
    Dropped(u32),
    /// The stream has ended: close the open window and send it.
    Flush,
    /// Restart with this setup.
    Setup(Setup),
    /// A pixel that must never be sent, as its number y * width + x.
    Hot(u32),
    /// The list of hot pixels is complete: answer.
    HotEnd,
}

/// A source of EVT 2.0 words: a link ([`crate::ingest::from_link`]) or a sensor on a port of the microcontroller
/// (`from_sensor`).
pub trait EventSource {
    /// Returns the next item, or `None` if nothing has arrived.
    fn next(&mut self) -> Option<Input>;

    /// Returns the little-endian words that come next, if several lie side by side in memory. They may be taken at
    /// once instead of one by one.
    fn words(&self) -> &[[u8; 4]] {
        &[]
    }

    /// Skips the first `words` of [`EventSource::words`], which held `events` events.
    fn skip(&mut self, words: usize, events: u32) {
        let _ = (words, events);
    }
}

/// A piece of work for the encoding side; the pieces must be done in order.
#[derive(Debug)]
pub enum Work<'b> {
    /// Encode this closed window, then give it back as a free one.
    Window(Window<'b>),
    /// Set up anew. No window is in use any more. Ends with [`Ingest::set_up`].
    Setup(Setup, Counts),
    /// Everything before this has been handed over: answer.
    Flush(Counts),
    /// Keep this pixel, number y * width + x, out of the windows that follow.
    Hot(u32),
    /// The list of hot pixels is complete: answer.
    HotEnd(Counts),
}

/// The exchange of windows and work between ingest and the encoding side.
pub trait Exchange<'b> {
    /// Returns a free window, if there is one.
    fn free(&mut self) -> Option<Window<'b>>;

    /// Returns whether another piece of work can be handed over.
    fn has_room(&self) -> bool;

    /// Hands over a piece of work. Called only if [`Self::has_room`].
    fn hand_over(&mut self, work: Work<'b>);

    /// Returns whether events for which no window is free can stay in the source for a while. If not, a setup that
    /// drops events drops them.
    fn may_wait(&self) -> bool {
        false
    }
}

/// What was received since the start. All counts wrap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Number of events decoded.
    pub events: u32,
    /// Number of events that the source reported as lost.
    pub lost: u32,
    /// Number of events for which no window was free, or no encoder was set up.
    pub dropped: u32,
    /// Number of words that were neither events nor times, and of events without a time: those before the first
    /// time, or after a loss.
    pub ignored: u32,
}

/// Why [`Ingest::poll`] returned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Poll {
    /// The source has nothing more.
    Idle,
    /// It must wait for the encoding side.
    Stalled,
}

/// What to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Take an item from the source.
    Input,
    /// Put an event into a window.
    Event(Event),
    /// Hand over the open window for a flush.
    Flush,
    /// Report that the flush is done.
    FlushDone,
    /// Hand over a hot pixel.
    Hot(u32),
    /// Report that the list of hot pixels is complete.
    HotEnd,
    /// Hand over the open window for a setup.
    SetupFlush(Setup),
    /// Wait until all windows have come back.
    SetupWindows(Setup),
    /// Wait until the encoding side has set up.
    SettingUp,
}

/// The receiving side: decodes the words of a source and fills windows with their events.
#[derive(Debug)]
pub struct Ingest<'b> {
    decoder: Evt2Decoder,
    step: Step,
    open: Option<Window<'b>>,
    /// Start of the next window, if it continues the grid of the one before.
    next_start: NextStart,
    /// Number of windows in existence; 0 before a setup.
    windows: usize,
    drops_when_full: bool,
    /// Lost events that no window has counted yet.
    missed: u32,
    /// A time may have been lost, so events have no time before the next one.
    lost_time: bool,
    counts: Counts,
}

impl<'b> Ingest<'b> {
    /// Creates a receiving side that has seen no word and no setup.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            decoder: Evt2Decoder::new(0),
            step: Step::Input,
            open: None,
            next_start: NextStart::ANY,
            windows: 0,
            drops_when_full: false,
            missed: 0,
            lost_time: false,
            counts: Counts {
                events: 0,
                lost: 0,
                dropped: 0,
                ignored: 0,
            },
        }
    }

    /// Returns whether a [`Work::Setup`] waits for [`Ingest::set_up`].
    #[must_use]
    pub const fn is_setting_up(&self) -> bool {
        matches!(self.step, Step::SettingUp)
    }

    /// Continues after a [`Work::Setup`]. `windows` windows will come back as free ones; 0 if the setup was
    /// refused.
    pub const fn set_up(&mut self, setup: &Setup, windows: usize) {
        self.decoder = Evt2Decoder::new(setup.time_base_us);
        self.drops_when_full = setup.when_full == Setup::DROP;
        self.windows = windows;
        self.missed = 0;
        self.lost_time = false;
        self.next_start = NextStart::ANY;
        self.step = Step::Input;
    }

    /// Processes items from the source until there are none, or until it must wait for the encoding side.
    pub fn poll(
        &mut self,
        source: &mut impl EventSource,
        exchange: &mut impl Exchange<'b>,
    ) -> Poll {
        loop {
            let went_on = match self.step {
                Step::Input => {
                    self.take_words(source, exchange);
                    match source.next() {
                        None => return Poll::Idle,
                        Some(input) => {
                            self.take(input);
                            true
                        }
                    }
                }
                Step::Event(event) => self.event(event, exchange) && self.go_to(Step::Input),
                Step::Flush => self.close(exchange) && self.go_to(Step::FlushDone),
                Step::FlushDone => self.hand_over(Work::Flush(self.counts), exchange),
                Step::Hot(number) => self.hand_over(Work::Hot(number), exchange),
                Step::HotEnd => self.hand_over(Work::HotEnd(self.counts), exchange),
                Step::SetupFlush(setup) => {
                    self.close(exchange) && self.go_to(Step::SetupWindows(setup))
                }
                Step::SetupWindows(setup) => self.collect(setup, exchange),
                Step::SettingUp => false,
            };
            if !went_on {
                return Poll::Stalled;
            }
        }
    }

    /// Hands over work and moves on; returns `false` if it must wait.
    fn hand_over(&mut self, work: Work<'b>, exchange: &mut impl Exchange<'b>) -> bool {
        exchange.has_room() && {
            exchange.hand_over(work);
            self.go_to(Step::Input)
        }
    }

    const fn go_to(&mut self, step: Step) -> bool {
        self.step = step;
        true
    }

    /// Takes words at once, up to the first that needs separate treatment.
    fn take_words(&mut self, source: &mut impl EventSource, exchange: &mut impl Exchange<'b>) {
        if self.lost_time || !self.decoder.has_time() || source.words().is_empty() {
            return;
        }
        if self.window(exchange).is_none() {
            return;
        }
        if let Some(window) = &mut self.open {
            let taken = window.push_words(&mut self.decoder, source.words());
            self.counts.events = self.counts.events.wrapping_add(taken.events);
            self.counts.ignored = self.counts.ignored.wrapping_add(taken.ignored);
            source.skip(taken.words, taken.events);
        }
    }

    fn take(&mut self, input: Input) {
        match input {
            Input::Word(word) => match self.decoder.decode(word) {
                Word::Event(event) if !self.lost_time => self.step = Step::Event(event),
                Word::Time => self.lost_time = false,
                Word::Event(_) | Word::Untimed => {
                    self.ignore();
                    self.miss(1);
                }
                Word::Other => self.ignore(),
            },
            Input::Lost(events) => {
                if self.windows > 0 {
                    self.counts.lost = self.counts.lost.wrapping_add(events);
                }
                self.miss(events);
                self.lost_time = true;
            }
            Input::Dropped(events) => {
                self.counts.dropped = self.counts.dropped.wrapping_add(events);
                self.miss(events);
            }
            Input::Flush => self.step = Step::Flush,
            Input::Setup(setup) => self.step = Step::SetupFlush(setup),
            Input::Hot(number) => self.step = Step::Hot(number),
            Input::HotEnd => self.step = Step::HotEnd,
        }
    }

    const fn ignore(&mut self) {
        self.counts.ignored = self.counts.ignored.wrapping_add(1);
    }

    /// Counts events that no window will hold, in the open window or else in the next one. Without a setup there is
    /// no window to count them in.
    const fn miss(&mut self, events: u32) {
        match &mut self.open {
            Some(window) if window.closed().is_none() => window.count_dropped(events),
            _ if self.windows > 0 => self.missed = self.missed.saturating_add(events),
            _ => {}
        }
    }

    /// Puts an event into a window, or counts it as dropped; returns `false` if it must wait.
    fn event(&mut self, event: Event, exchange: &mut impl Exchange<'b>) -> bool {
        loop {
            if let Some(window) = self.window(exchange) {
                if window.push(event) != Push::Closed {
                    break;
                }
                if self.close(exchange) {
                    continue;
                }
            }
            if self.windows == 0 || (self.drops_when_full && !exchange.may_wait()) {
                self.counts.dropped = self.counts.dropped.wrapping_add(1);
                self.miss(1);
                break;
            }
            return false;
        }
        self.counts.events = self.counts.events.wrapping_add(1);
        true
    }

    /// Returns the open window, after taking a free one if none is open.
    fn window(&mut self, exchange: &mut impl Exchange<'b>) -> Option<&mut Window<'b>> {
        if self.open.is_none() {
            let mut window = exchange.free()?;
            window.follow(self.next_start);
            window.count_dropped(self.missed);
            self.missed = 0;
            self.open = Some(window);
        }
        self.open.as_mut()
    }

    /// Closes the open window and hands it over; returns `false` if it must wait.
    ///
    /// A window that has already closed is handed over as it is. Losses without a window wait for one, so that a
    /// frame reports them.
    fn close(&mut self, exchange: &mut impl Exchange<'b>) -> bool {
        if self.windows == 0 || (self.open.is_none() && self.missed == 0) {
            return true;
        }
        if !exchange.has_room() {
            return false;
        }
        let Some(window) = self.window(exchange) else {
            return false;
        };
        window.flush();
        if window.closed().is_none() {
            // It holds neither events nor counts, so it stays open.
            return true;
        }
        self.next_start = window.next_start();
        if let Some(window) = self.open.take() {
            exchange.hand_over(Work::Window(window));
        }
        true
    }

    /// Takes every window out of use, then hands the setup over.
    fn collect(&mut self, setup: Setup, exchange: &mut impl Exchange<'b>) -> bool {
        if self.open.take().is_some() {
            self.windows -= 1;
        }
        while self.windows > 0 {
            if exchange.free().is_none() {
                return false;
            }
            self.windows -= 1;
        }
        exchange.has_room() && {
            exchange.hand_over(Work::Setup(setup, self.counts));
            self.go_to(Step::SettingUp)
        }
    }
}

impl Default for Ingest<'_> {
    fn default() -> Self {
        Self::new()
    }
}
