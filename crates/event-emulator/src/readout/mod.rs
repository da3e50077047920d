//! From the pixels' events to a stream in order, and through a sensor's bus to the host.
//!
//! `queue` puts the pixels' events in order; without a camera, that is all. With one, `arbiter` or `scan` reads them from the
//! pixels, and `link` takes them to the host, or loses them.

mod arbiter;
mod link;
pub(crate) mod parameters;
mod queue;
mod scan;

use event_types::stream::Result;
use event_types::{Event, Sensor};

pub(crate) use queue::Queue;

use crate::noise::Cause;
use arbiter::Arbiter;
use link::Link;
use parameters::ReadoutParameters;
use scan::Scan;

/// Events that a readout has lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Losses {
    /// Events of pixels whose last event had not been read.
    pub unread: u64,
    /// Events that found the link's buffer full.
    pub link: u64,
}

/// A pixel's event that is to be read.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Waiting {
    event: Event,
    cause: Cause,
    /// When its pixel fired, in ns since the readout's beginning.
    fired_ns: f64,
}

/// The readout of a sensor: events go in when pixels fire, and come out as the host gets them, with its times.
///
/// ```
/// use event_emulator::{Camera, Readout};
/// use event_types::{Event, Polarity, Sensor};
///
/// # fn main() -> Result<(), event_types::stream::Error> {
/// let camera = Camera::from_name("davis346").expect("a camera");
/// let mut readout = Readout::new(camera.sensor, &camera.readout)?;
/// // All pixels fire at once: the host gets 12 events per microsecond at most.
/// let (mut events, mut out) = (Vec::new(), Vec::new());
/// for y in 0..260 {
///     events.extend((0..346).map(|x| Event { t_us: 1_000, x, y, polarity: Polarity::On }));
/// }
/// readout.push(&events, None, &mut out, None);
/// readout.finish(&mut out, None);
/// let last_us = out.last().map_or(0, |event| event.t_us);
/// assert!((8_000..9_000).contains(&last_us));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Readout {
    order: Order,
    link: Link,
    tick_us: u64,
    unread: u64,
    read: Vec<Read>,
    /// The readout's beginning, a multiple of [`ERA_US`]; `None` before the first event.
    begin_us: Option<u64>,
}

/// Times in nanoseconds are exact for so long, and times in microseconds since 1970 are not.
const ERA_US: u64 = 1_000_000_000;

#[derive(Debug, Clone)]
enum Order {
    Arbiter(Arbiter),
    Scan(Scan),
}

/// An event that has been read from its pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Read {
    waiting: Waiting,
    /// When it goes to the link, and the time that it gets, both in ns.
    at_ns: f64,
    stamp_ns: f64,
}

impl Readout {
    /// Creates the readout of a sensor on which no event waits.
    ///
    /// # Errors
    /// Parameters that [`ReadoutParameters::check`] refuses.
    pub fn new(sensor: Sensor, parameters: &ReadoutParameters) -> Result<Self> {
        parameters.check()?;
        let order = if parameters.scan_us > 0.0 {
            Order::Scan(Scan::new(sensor, parameters))
        } else {
            Order::Arbiter(Arbiter::new(sensor, parameters))
        };
        Ok(Self {
            order,
            link: Link::new(parameters),
            tick_us: parameters.tick_us as u64,
            unread: 0,
            read: Vec::new(),
            begin_us: None,
        })
    }

    /// Takes events of pixels, which are on the sensor and none earlier than one before, with their causes if they are
    /// known; appends those that the host gets meanwhile, and their causes.
    pub fn push(
        &mut self,
        events: &[Event],
        causes: Option<&[Cause]>,
        out: &mut Vec<Event>,
        mut out_causes: Option<&mut Vec<Cause>>,
    ) {
        for (index, event) in events.iter().enumerate() {
            let cause = causes.and_then(|causes| causes.get(index)).copied();
            let era_us = event.t_us - event.t_us % ERA_US;
            let begin_us = *self.begin_us.get_or_insert(era_us);
            let waiting = Waiting {
                event: *event,
                fired_ns: event.t_us.saturating_sub(begin_us) as f64 * 1e3,
                cause: cause.unwrap_or(Cause::Signal),
            };
            let is_taken = match &mut self.order {
                Order::Arbiter(arbiter) => arbiter.push(waiting, &mut self.read),
                Order::Scan(scan) => scan.push(waiting, &mut self.read),
            };
            self.unread += u64::from(!is_taken);
            self.send(out, out_causes.as_deref_mut());
        }
    }

    /// Reads all events that wait, and appends those that the host gets, and their causes.
    pub fn finish(&mut self, out: &mut Vec<Event>, out_causes: Option<&mut Vec<Cause>>) {
        match &mut self.order {
            Order::Arbiter(arbiter) => arbiter.finish(&mut self.read),
            Order::Scan(scan) => scan.finish(&mut self.read),
        }
        self.send(out, out_causes);
    }

    /// Returns what has been lost so far.
    #[must_use]
    pub fn losses(&self) -> Losses {
        Losses {
            unread: self.unread,
            link: self.link.lost(),
        }
    }

    /// Takes what has been read over the link.
    fn send(&mut self, out: &mut Vec<Event>, mut causes: Option<&mut Vec<Cause>>) {
        let begin_us = self.begin_us.unwrap_or(0);
        for read in self.read.drain(..) {
            if !self.link.takes(read.at_ns) {
                continue;
            }
            let t_us = begin_us.saturating_add((read.stamp_ns / 1e3) as u64);
            out.push(Event {
                t_us: t_us - t_us % self.tick_us,
                ..read.waiting.event
            });
            if let Some(causes) = &mut causes {
                causes.push(read.waiting.cause);
            }
        }
    }
}

#[cfg(test)]
mod tests;
