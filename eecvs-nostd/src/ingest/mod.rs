//! From an event source to closed windows, two windows taking turns: one is filled while the other
//! is encoded.
//!
//! Runs in an interrupt: every step is short, and when no window is free it stops and goes on
//! there later.

pub mod from_link;
pub mod from_sensor;
pub mod reorder;

use crate::event_link::Setup;
use crate::window::{NextStart, Push, Window};
use event_types::Event;
use event_types::evt2::{Evt2Decoder, Word};

/// What an event source brings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Input {
    /// An EVT 2.0 word.
    Word(u32),
    /// This many events, and perhaps a time, were lost here.
    Lost(u32),
    /// The stream has ended: close the open window and send it.
    Flush,
    /// Start anew.
    Setup(Setup),
    /// A pixel, by its number y * width + x, that is never sent.
    Hot(u32),
    /// These were all: answer.
    HotEnd,
}

/// Where EVT 2.0 words come from: a link ([`crate::ingest::from_link`]), or a sensor on a port of the
/// microcontroller.
pub trait EventSource {
    /// What comes next, `None` where nothing has come.
    fn next(&mut self) -> Option<Input>;

    /// Words that come next, little-endian, where there are several in one place: they may be
    /// taken at once instead of one by one.
    fn words(&self) -> &[[u8; 4]] {
        &[]
    }

    /// Leaves out the first `words` of [`EventSource::words`], which held `events` events.
    fn skip(&mut self, words: usize, events: u32) {
        let _ = (words, events);
    }
}

/// What the encoding side gets to do, in order.
#[derive(Debug)]
pub enum Work<'b> {
    /// Encode this closed window, then give it back as free.
    Window(Window<'b>),
    /// Set up anew: no window is in use any more. Ends with [`Ingest::set_up`].
    Setup(Setup, Counts),
    /// Everything before was sent: answer.
    Flush(Counts),
    /// Keep this pixel, by its number y * width + x, out of the windows that follow.
    Hot(u32),
    /// These were all: answer.
    HotEnd(Counts),
}

/// The two directions between ingest and the encoding side.
pub trait Exchange<'b> {
    /// A window that is free, if there is one.
    fn free(&mut self) -> Option<Window<'b>>;

    /// Whether a further piece of work can be handed over.
    fn has_room(&self) -> bool;

    /// Hands over work; asked only where there is room.
    fn hand_over(&mut self, work: Work<'b>);
}

/// What was received, since the start; all wrap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Events decoded.
    pub events: u32,
    /// Events that the source lost.
    pub lost: u32,
    /// Events that found no free window, or no encoder set up.
    pub dropped: u32,
    /// Words that were neither events nor times, and events without a time: before the first, or
    /// after a loss.
    pub ignored: u32,
}

/// Why [`Ingest::poll`] came back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Poll {
    /// The source has nothing more.
    Idle,
    /// It cannot go on before the encoding side has done something.
    Stalled,
}

/// What is to be done next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Take what the source brings.
    Input,
    /// Put an event into a window.
    Event(Event),
    /// Hand over the open window, for a flush.
    Flush,
    /// Tell that the flush is done.
    FlushDone,
    /// Hand over a hot pixel.
    Hot(u32),
    /// Tell that these were all.
    HotEnd,
    /// Hand over the open window, for a setup.
    SetupFlush(Setup),
    /// Wait for the windows to come back.
    SetupWindows(Setup),
    /// The encoding side sets up.
    SettingUp,
}

/// The receiving side.
#[derive(Debug)]
pub struct Ingest<'b> {
    decoder: Evt2Decoder,
    step: Step,
    open: Option<Window<'b>>,
    /// Start of the next window, where its grid continues that of the one before.
    next_start: NextStart,
    /// Windows in existence; none before a setup.
    windows: usize,
    drops_when_full: bool,
    /// Losses that no window has counted yet.
    missed: u32,
    /// A time may have been lost: events have none before the next one.
    lost_time: bool,
    counts: Counts,
}

impl<'b> Ingest<'b> {
    /// Before the first word and without a setup.
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

    /// Whether a [`Work::Setup`] waits for [`Ingest::set_up`].
    #[must_use]
    pub const fn is_setting_up(&self) -> bool {
        matches!(self.step, Step::SettingUp)
    }

    /// Goes on after a [`Work::Setup`]: `windows` windows will come as free ones, none where the
    /// setup was refused.
    pub const fn set_up(&mut self, setup: &Setup, windows: usize) {
        self.decoder = Evt2Decoder::new(setup.time_base_us);
        self.drops_when_full = setup.when_full == Setup::DROP;
        self.windows = windows;
        self.missed = 0;
        self.lost_time = false;
        self.next_start = NextStart::ANY;
        self.step = Step::Input;
    }

    /// Takes what the source brings until there is nothing or it has to wait.
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

    /// Hands over work and goes on; `false` asks to wait.
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

    /// Takes words at once up to the first that is out of the ordinary.
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
            Input::Flush => self.step = Step::Flush,
            Input::Setup(setup) => self.step = Step::SetupFlush(setup),
            Input::Hot(number) => self.step = Step::Hot(number),
            Input::HotEnd => self.step = Step::HotEnd,
        }
    }

    const fn ignore(&mut self) {
        self.counts.ignored = self.counts.ignored.wrapping_add(1);
    }

    /// Counts events that no window will hold, in the open window or the next one. Without a setup
    /// there is no window to count in.
    const fn miss(&mut self, events: u32) {
        match &mut self.open {
            Some(window) if window.closed().is_none() => window.count_dropped(events),
            _ if self.windows > 0 => self.missed = self.missed.saturating_add(events),
            _ => {}
        }
    }

    /// Puts an event into a window, or counts it; `false` asks to wait.
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
            if self.windows == 0 || self.drops_when_full {
                self.counts.dropped = self.counts.dropped.wrapping_add(1);
                self.miss(1);
                break;
            }
            return false;
        }
        self.counts.events = self.counts.events.wrapping_add(1);
        true
    }

    /// The open window; takes a free one where none is open.
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

    /// Closes the open window and hands it over; `false` asks to wait.
    ///
    /// A window that its own rule closed is handed over as it is. Losses without a window wait for
    /// one, so that a frame tells them.
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
            // Nothing in it and nothing to tell: it stays open.
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
