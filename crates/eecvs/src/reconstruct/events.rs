//! Recovers events from coefficients: the exact number per pixel and polarity, at the times found.
//!
//! The frames carry the counts, so n times are sought. For the DCT and the DTFT, [`super::recover`] finds the times
//! that the coefficients determine, or, for comparison, [`super::pursuit`] finds the peaks of the summed atoms.
//! Haar coefficients are inverted to signed counts per bin, to which events are dealt ([`super::bins`]).
//!
//! The work of a window has a limit ([`WorkLimit`]). Events of pixels beyond it are spread by their lowest
//! coefficients ([`super::spread`]).

use eecvs_nostd::{Event, Header, Mode, Polarity, Transform};
use rayon::prelude::*;

use super::bins::dealt;
use super::cost::{self, OnGrid, Size};
use super::order::ByTime;
use super::pursuit::{Peaks, Placed};
use super::recover::{self, Confidence, Confidences};
use super::refine::Work;
use super::spread::Spread;
use super::volume::inverse::Inverse;
use super::{DecodedWindow, Pixel};
use crate::work_limit::WorkLimit;

/// Method that finds event times in the coefficients of the DCT and the DTFT.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Finder {
    /// Solves for all times jointly from all coefficients, and verifies them by encoding them again.
    #[default]
    Exact,
    /// Takes the peaks of the summed atoms one after the other: faster, and a baseline.
    Peaks,
}

impl Finder {
    /// All methods.
    pub const ALL: [Self; 2] = [Self::Exact, Self::Peaks];

    /// Returns the name used on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Peaks => "peaks",
        }
    }

    /// Returns a one-line description.
    #[must_use]
    pub const fn about(self) -> &'static str {
        match self {
            Self::Exact => {
                "Solved for jointly from all coefficients, and verified by encoding the times again"
            }
            Self::Peaks => "Peaks of the summed atoms, one after the other: faster, and a baseline",
        }
    }

    /// Returns the method with this name, or `None` if there is none.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|finder| finder.name() == name)
    }
}

/// Recovers the events of windows, whether they were sent as events or as coefficients.
#[derive(Debug)]
pub struct EventDecoder {
    finder: Finder,
    limit: WorkLimit,
    /// Work that the last window cost.
    units: u64,
    /// Tables for the shape of the last window of coefficients.
    times: Option<TimeDecoder>,
    by_time: ByTime,
}

impl EventDecoder {
    /// Creates a decoder of events; `finder` applies to windows of coefficients, each of which may cost the default
    /// [`WorkLimit`].
    #[must_use]
    pub fn new(finder: Finder) -> Self {
        Self {
            finder,
            limit: WorkLimit::default(),
            units: 0,
            times: None,
            by_time: ByTime::default(),
        }
    }

    /// Sets the most work that a window may cost; pixels beyond it get rough times and are counted in
    /// [`Confidences::pixels_over_work_limit`].
    #[must_use]
    pub const fn with_work_limit(mut self, limit: WorkLimit) -> Self {
        self.limit = limit;
        self
    }

    /// Returns the work that the last window cost, in units.
    #[must_use]
    pub const fn units(&self) -> u64 {
        self.units
    }

    /// Returns the most work that a window can cost without a limit, in units; 0 for a window sent as events.
    #[must_use]
    pub fn most(&mut self, window: &DecodedWindow) -> u64 {
        if let Mode::Hybrid(_) = window.header.mode {
            return 0;
        }
        let times = self.times(&window.header);
        let most = window.pixels.iter().map(|pixel| times.most(pixel));
        most.fold(0, u64::saturating_add)
    }

    /// Stores the window's events in it, sorted by time; returns the confidence counts of the times that were
    /// solved for.
    pub fn fill(&mut self, window: &mut DecodedWindow) -> Confidences {
        if let Mode::Hybrid(_) = window.header.mode {
            self.units = 0;
            self.by_time.sort(&window.header, &mut window.events);
            return Confidences::default();
        }
        let limit = self.limit;
        let solved = self.times(&window.header).window(window, limit);
        self.units = solved.units;
        window.events = solved.events;
        solved.confidences
    }

    /// Returns the tables for windows of the header's shape.
    fn times(&mut self, header: &Header) -> &TimeDecoder {
        let times = self.times.take().filter(|times| times.fits(header));
        let times = times.unwrap_or_else(|| TimeDecoder::new(header, self.finder));
        self.times.insert(times)
    }
}

/// Decodes pixels sent as coefficients of one transform, grid size K and M to events.
#[derive(Debug)]
struct TimeDecoder {
    transform: Transform,
    grid: usize,
    /// r = min(M, K).
    kept: usize,
    finder: Finder,
    way: Way,
}

/// Tables for the step from coefficients to times.
#[derive(Debug)]
enum Way {
    /// For the DCT and the DTFT.
    Peaks(Peaks),
    /// Haar synthesis on K bins.
    Bins(Inverse),
}

impl TimeDecoder {
    /// Creates the tables for windows of the header's transform, grid size K and M.
    fn new(header: &Header, finder: Finder) -> Self {
        let grid = usize::from(header.grid);
        let kept = usize::from(header.m).min(grid);
        let way = if header.transform == Transform::Dwt {
            Way::Bins(Inverse::new(header.transform, header.grid, grid))
        } else {
            Way::Peaks(Peaks::new(header.transform, grid, kept))
        };
        Self {
            transform: header.transform,
            grid,
            kept,
            finder,
            way,
        }
    }

    /// Returns whether the tables fit a window's transform, grid size and M.
    fn fits(&self, header: &Header) -> bool {
        self.transform == header.transform
            && self.grid == usize::from(header.grid)
            && self.kept == usize::from(header.m).min(self.grid)
    }

    /// Returns a window's events, sorted by time, row and column, and the confidence counts of its pixels.
    ///
    /// Pixels are solved in the order of the most that they can cost, as many at once as the rest of the limit allows
    /// even then; what they did not use goes to the next ones. So the work stays below the limit, and neither the
    /// number of threads nor their speed decides which pixels are beyond it.
    fn window(&self, window: &DecodedWindow, limit: WorkLimit) -> Solved {
        let pixels = &window.pixels;
        let most: Vec<u64> = pixels
            .par_iter()
            .with_min_len(64)
            .map(|pixel| self.most(pixel))
            .collect();
        let mut order: Vec<u32> = (0..pixels.len() as u32).collect();
        if most
            .iter()
            .fold(0, |sum: u64, most| sum.saturating_add(*most))
            > limit.get()
        {
            order.par_sort_unstable_by_key(|at| (most[*at as usize], *at));
        }
        let mut left = limit.get();
        let mut rest = order.as_slice();
        let mut solved = Solved::default();
        loop {
            let mut sum = 0_u64;
            let fitting = rest.iter().take_while(|at| {
                sum = sum.saturating_add(most[**at as usize]);
                sum <= left
            });
            let (now, later) = rest.split_at(fitting.count());
            if now.is_empty() {
                break;
            }
            let more = solve(window, now, |pixel, work, each| {
                self.pixel(&window.header, pixel, work, each)
            });
            left = left.saturating_sub(more.units);
            solved = solved.with(more);
            rest = later;
        }
        if !rest.is_empty() {
            let spread = Spread::new(&window.header);
            let mut rough = solve(window, rest, |pixel, _, each| {
                place(&window.header, &spread.pixel(pixel), each);
                Confidence::Approximate
            });
            rough.confidences.pixels_over_work_limit = rest.len() as u64;
            solved = solved.with(rough);
        }
        solved
            .events
            .par_sort_unstable_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
        solved
    }

    /// Returns the most work that a pixel can cost: none where the frame sends its times.
    fn most(&self, pixel: &Pixel) -> u64 {
        if !pixel.times.is_empty() {
            return 0;
        }
        let events = u64::from(pixel.on) + u64::from(pixel.off);
        match &self.way {
            Way::Peaks(peaks) if self.finder == Finder::Exact => {
                let size = Size::of(self.transform, pixel);
                let grid = OnGrid {
                    grid: self.grid as u64,
                    rows: size.rows,
                };
                size.exact(peaks.search(pixel), grid)
            }
            Way::Peaks(peaks) => peaks.search(pixel).peaks(events),
            Way::Bins(_) => {
                let coefficients = pixel.coefficients.len() as u64;
                cost::bins(self.grid as u64, coefficients, events)
            }
        }
    }

    /// Calls `each` for each of a pixel's `on` ON events and `off` OFF events, in no particular order, with the
    /// offset in microseconds (0 to T - 1) and whether the event is ON. Returns the confidence of the times.
    fn pixel(
        &self,
        header: &Header,
        pixel: &Pixel,
        work: &mut Work,
        each: &mut dyn FnMut(u32, bool),
    ) -> Confidence {
        let exact = match &self.way {
            _ if pixel.times.len() > 1 => Some(recover::few(header, pixel)),
            Way::Peaks(peaks) if self.finder == Finder::Exact => {
                Some(recover::pixel(header, peaks, pixel, work))
            }
            _ => None,
        };
        if let Some(found) = exact {
            let polarities = (0..).map(|i| i < pixel.on as usize);
            for (offset_us, is_on) in found.offsets_us.into_iter().zip(polarities) {
                each(offset_us, is_on);
            }
            return found.confidence;
        }
        let placed = match &self.way {
            _ if !pixel.times.is_empty() => sent(pixel),
            Way::Peaks(peaks) => peaks.pixel(pixel, work),
            Way::Bins(table) => dealt(table, pixel, work),
        };
        place(header, &placed, each);
        Confidence::Approximate
    }
}

/// Calls `each` with the offset in microseconds of each event, and whether it is ON.
fn place(header: &Header, placed: &[Placed], each: &mut dyn FnMut(u32, bool)) {
    let duration_us = f64::from(header.duration_us);
    for (u, sign) in placed {
        let offset_us = (u * duration_us).round().clamp(0.0, duration_us - 1.0);
        each(offset_us as u32, *sign > 0.0);
    }
}

/// Events of some pixels of a window.
#[derive(Debug, Default)]
struct Solved {
    events: Vec<Event>,
    confidences: Confidences,
    /// Work that they cost.
    units: u64,
}

impl Solved {
    fn with(mut self, more: Self) -> Self {
        self.events.extend(more.events);
        self.confidences.add(more.confidences);
        self.units += more.units;
        self
    }
}

/// Collects the events of the pixels at these indices; `pixel` calls its last argument with each event of a pixel.
fn solve(
    window: &DecodedWindow,
    at: &[u32],
    pixel: impl Fn(&Pixel, &mut Work, &mut dyn FnMut(u32, bool)) -> Confidence + Sync,
) -> Solved {
    let t0_us = window.header.t0_us;
    at.par_iter()
        .with_min_len(16)
        .fold(
            || (Solved::default(), Work::default()),
            |(mut solved, mut work), at| {
                let of = &window.pixels[*at as usize];
                let confidence = pixel(of, &mut work, &mut |offset_us, is_on| {
                    solved.events.push(Event {
                        t_us: t0_us.saturating_add(u64::from(offset_us)),
                        x: of.x,
                        y: of.y,
                        polarity: Polarity::from_bool(is_on),
                    });
                });
                solved.confidences.count(confidence);
                solved.units += work.take_units();
                (solved, work)
            },
        )
        .map(|(solved, _)| solved)
        .reduce(Solved::default, Solved::with)
}

/// Returns the events of a pixel whose times are sent in the frame.
fn sent(pixel: &Pixel) -> Vec<Placed> {
    let times = pixel.times.iter();
    times
        .map(|(u, polarity)| (*u, f64::from(polarity.sign())))
        .collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::reconstruct::test_header::header;

    /// Returns the coefficients of one OFF event.
    fn coefficients(u: f64) -> Vec<(u16, f64, f64)> {
        let of = |k: u16| {
            let (sin, cos) = (TAU * f64::from(k) * u).sin_cos();
            (k, -cos, sin)
        };
        (0..16).map(of).collect()
    }

    #[test]
    fn times_are_rounded_to_the_nearest_microsecond() {
        let (mut decoder, duration_us) = (EventDecoder::new(Finder::Peaks), 1000);
        for offset_us in (0..duration_us).step_by(37).chain([duration_us - 1]) {
            let u = f64::from(offset_us) / f64::from(duration_us);
            let mut window = DecodedWindow {
                header: header(duration_us),
                pixels: vec![Pixel {
                    x: 3,
                    y: 1,
                    on: 0,
                    off: 1,
                    coefficients: coefficients(u),
                    times: vec![],
                }],
                events: vec![],
            };
            let event = Event {
                t_us: 5000 + u64::from(offset_us),
                x: 3,
                y: 1,
                polarity: Polarity::Off,
            };
            // Twice is as good as once.
            for _ in 0..2 {
                decoder.fill(&mut window);
                assert_eq!(window.events, [event]);
            }
        }
    }

    #[test]
    fn counts_are_kept_whatever_the_coefficients_say() {
        let header = header(1000);
        for (transform, finder) in Transform::ALL
            .into_iter()
            .flat_map(|transform| [(transform, Finder::Exact), (transform, Finder::Peaks)])
        {
            let header = Header {
                transform,
                m: 8,
                ..header
            };
            let decoder = TimeDecoder::new(&header, finder);
            for (on, off) in [(3, 0), (0, 5), (40, 2), (70, 30)] {
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off,
                    coefficients: vec![(3, 1.0, 2.0)],
                    times: vec![],
                };
                let (mut found_on, mut found_off) = (0, 0);
                decoder.pixel(
                    &header,
                    &pixel,
                    &mut Work::default(),
                    &mut |offset_us, is_on| {
                        assert!(offset_us < 1000);
                        if is_on {
                            found_on += 1;
                        } else {
                            found_off += 1;
                        }
                    },
                );
                assert_eq!((found_on, found_off), (on, off));
            }
        }
    }
}
