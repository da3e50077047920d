//! From received bytes to closed windows, two windows taking turns: one is filled while the other
//! is encoded.
//!
//! Runs in an interrupt: every step is short, and when no window is free it stops in the middle of
//! a packet and goes on there later.

use crate::event::Event;
use crate::event_link::{Kind, Packet, Receiver, Setup};
use crate::evt2::{Evt2Decoder, Word};
use crate::window::{Push, Window};

/// What the encoding side gets to do, in order.
#[derive(Debug)]
pub enum Work<'b> {
    /// Encode this closed window, then give it back as free.
    Window(Window<'b>),
    /// Set up anew: no window is in use any more. Ends with [`Ingest::set_up`].
    Setup(Setup, Counts),
    /// Everything before was sent: answer.
    Flush(Counts),
}

/// The two directions between ingest and the encoding side.
pub trait Exchange<'b> {
    /// A window that is free, if there is one.
    fn free(&mut self) -> Option<Window<'b>>;

    /// Hands over work, or gives it back where there is no room.
    ///
    /// # Errors
    /// The work itself.
    fn hand_over(&mut self, work: Work<'b>) -> Result<(), Work<'b>>;
}

/// What was received, since the start; all wrap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts {
    /// Events decoded.
    pub events: u32,
    /// Events of damaged packets, by the positions of the packets around them.
    pub lost: u32,
    /// Events that found no free window, or no encoder set up.
    pub dropped: u32,
    /// Words that were neither events nor times, events without a time (before the first, or after
    /// a loss), bytes left over in a packet, and packets that came twice.
    pub ignored: u32,
    /// Bytes that belonged to no packet.
    pub damaged_bytes: u32,
}

/// Why [`Ingest::poll`] came back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Poll {
    /// All bytes are used up.
    Idle,
    /// It cannot go on before the encoding side has done something.
    Stalled,
}

/// What is still to be done with the packet in the receiver.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// Nothing: more bytes are needed.
    Bytes,
    /// Words, from this offset of the body on.
    Words { at: usize, end: usize },
    /// Hand over the open window, for a flush.
    Flush,
    /// Tell that the flush is done.
    FlushDone,
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
    receiver: Receiver,
    decoder: Evt2Decoder,
    step: Step,
    open: Option<Window<'b>>,
    /// Start of the next window, where its grid continues that of the one before.
    next_start_us: Option<u64>,
    /// Position that the next packet of words should have.
    position: u32,
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
    /// Before the first byte and without a setup.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            receiver: Receiver::new(),
            decoder: Evt2Decoder::new(0),
            step: Step::Bytes,
            open: None,
            next_start_us: None,
            position: 0,
            windows: 0,
            drops_when_full: false,
            missed: 0,
            lost_time: false,
            counts: Counts {
                events: 0,
                lost: 0,
                dropped: 0,
                ignored: 0,
                damaged_bytes: 0,
            },
        }
    }

    /// What was received so far.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        Counts {
            damaged_bytes: self.receiver.damaged_bytes(),
            ..self.counts
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
        self.position = 0;
        self.missed = 0;
        self.lost_time = false;
        self.next_start_us = None;
        self.step = Step::Bytes;
    }

    /// Takes bytes until there are none or it has to wait.
    pub fn poll(
        &mut self,
        mut next_byte: impl FnMut() -> Option<u8>,
        exchange: &mut impl Exchange<'b>,
    ) -> Poll {
        loop {
            let went_on = match self.step {
                Step::Bytes => {
                    if let Some(packet) = self.receiver.next_packet() {
                        let (kind, position, len) =
                            (packet.kind, packet.position, packet.body.len());
                        let setup = match kind {
                            Kind::Setup => Setup::parse(packet.body),
                            _ => None,
                        };
                        self.step = self.begin(kind, position, len, setup);
                    } else if let Some(byte) = next_byte() {
                        self.receiver.put(byte);
                    } else {
                        return Poll::Idle;
                    }
                    true
                }
                Step::Words { at, end } => self.words(at, end, exchange),
                Step::Flush => self.close(exchange) && self.go_to(Step::FlushDone),
                Step::FlushDone => {
                    let work = Work::Flush(self.counts());
                    exchange.hand_over(work).is_ok() && self.go_to(Step::Bytes)
                }
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

    const fn go_to(&mut self, step: Step) -> bool {
        self.step = step;
        true
    }

    fn begin(&mut self, kind: Kind, position: u32, len: usize, setup: Option<Setup>) -> Step {
        if matches!(kind, Kind::Words | Kind::Flush) && self.windows > 0 {
            let ahead = position.wrapping_sub(self.position);
            if ahead >= 1 << 31 {
                // Its events were counted, or taken, before.
                self.ignore(1);
                return Step::Bytes;
            }
            if ahead > 0 {
                self.counts.lost = self.counts.lost.wrapping_add(ahead);
                self.miss(ahead);
                self.lost_time = true;
            }
            self.position = position;
        }
        match kind {
            Kind::Words => {
                self.ignore(len as u32 % 4);
                Step::Words {
                    at: 0,
                    end: len - len % 4,
                }
            }
            Kind::Flush if self.windows > 0 => Step::Flush,
            Kind::Flush => Step::FlushDone,
            Kind::Setup => match setup {
                Some(setup) => Step::SetupFlush(setup),
                None => {
                    self.ignore(1);
                    Step::Bytes
                }
            },
            Kind::Status => {
                self.ignore(1);
                Step::Bytes
            }
        }
    }

    const fn ignore(&mut self, count: u32) {
        self.counts.ignored = self.counts.ignored.wrapping_add(count);
    }

    /// Counts events that no window will hold, in the open window or the next one.
    const fn miss(&mut self, events: u32) {
        match &mut self.open {
            Some(window) if window.closed().is_none() => window.count_dropped(events),
            _ => self.missed = self.missed.saturating_add(events),
        }
    }

    fn words(&mut self, mut at: usize, end: usize, exchange: &mut impl Exchange<'b>) -> bool {
        while at < end {
            let word = match self.receiver.packet() {
                Some(Packet { body, .. }) => match body.get(at..at + 4) {
                    Some(bytes) => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
                    None => break,
                },
                None => break,
            };
            match self.decoder.decode(word) {
                Word::Event(event) if !self.lost_time => {
                    if !self.event(event, exchange) {
                        // The same word again, once a window is free: an event's word leaves the
                        // decoder as it was.
                        self.step = Step::Words { at, end };
                        return false;
                    }
                    self.position = self.position.wrapping_add(1);
                }
                Word::Time => self.lost_time = false,
                Word::Event(_) | Word::Untimed => {
                    self.position = self.position.wrapping_add(1);
                    self.ignore(1);
                    self.miss(u32::from(self.windows > 0));
                }
                Word::Other => self.ignore(1),
            }
            at += 4;
        }
        self.go_to(Step::Bytes)
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
                self.miss(u32::from(self.windows > 0));
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
            window.follow(self.next_start_us);
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
        let Some(window) = self.window(exchange) else {
            return false;
        };
        window.flush();
        if window.closed().is_none() {
            // Nothing in it and nothing to tell: it stays open.
            return true;
        }
        self.next_start_us = window.next_start_us();
        match self
            .open
            .take()
            .map(|window| exchange.hand_over(Work::Window(window)))
        {
            None | Some(Ok(())) => true,
            Some(Err(Work::Window(window))) => {
                self.open = Some(window);
                false
            }
            Some(Err(_)) => false,
        }
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
        let work = Work::Setup(setup, self.counts());
        exchange.hand_over(work).is_ok() && self.go_to(Step::SettingUp)
    }
}

impl Default for Ingest<'_> {
    fn default() -> Self {
        Self::new()
    }
}
