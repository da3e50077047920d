//! Recovers events from coefficients: the exact number per pixel and polarity, at the times found.
//!
//! The frames carry the counts, so n times are sought. For the DCT and the DTFT, [`super::recover`] finds the times
//! that the coefficients determine, or, for comparison, [`super::pursuit`] finds the peaks of the summed atoms.
//! Haar coefficients are inverted to signed counts per bin, and events are assigned one by one to the bin with the
//! largest remaining count.

use eecvs_nostd::{Event, Header, Mode, Polarity, Transform};
use rayon::prelude::*;

use super::order::ByTime;
use super::pursuit::{Peaks, Placed};
use super::recover::{self, Confidence, Confidences};
use super::refine::Work;
use super::volume::inverse::Inverse;
use super::{DecodedWindow, Pixel};

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
    /// Tables for the shape of the last window of coefficients.
    times: Option<TimeDecoder>,
    by_time: ByTime,
}

impl EventDecoder {
    /// Creates a decoder of events; `finder` applies to windows of coefficients.
    #[must_use]
    pub fn new(finder: Finder) -> Self {
        Self {
            finder,
            times: None,
            by_time: ByTime::default(),
        }
    }

    /// Stores the window's events in it, sorted by time; returns the confidence counts of the times that were
    /// solved for.
    pub fn fill(&mut self, window: &mut DecodedWindow) -> Confidences {
        if let Mode::Hybrid(_) = window.header.mode {
            self.by_time.sort(&window.header, &mut window.events);
            return Confidences::default();
        }
        let times = match &mut self.times {
            Some(times) if times.fits(&window.header) => times,
            times => times.insert(TimeDecoder::new(&window.header, self.finder)),
        };
        let confidences;
        (window.events, confidences) = times.window(window);
        confidences
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
    fn window(&self, window: &DecodedWindow) -> (Vec<Event>, Confidences) {
        let header = &window.header;
        let (mut events, confidences) = window
            .pixels
            .par_iter()
            .with_min_len(16)
            .fold(
                || (Vec::new(), Confidences::default(), Work::default()),
                |(mut events, mut confidences, mut work), pixel| {
                    let confidence = self.pixel(header, pixel, &mut work, |offset_us, is_on| {
                        events.push(Event {
                            t_us: header.t0_us.saturating_add(u64::from(offset_us)),
                            x: pixel.x,
                            y: pixel.y,
                            polarity: Polarity::from_bool(is_on),
                        });
                    });
                    confidences.count(confidence);
                    (events, confidences, work)
                },
            )
            .map(|(events, confidences, _)| (events, confidences))
            .reduce(
                Default::default,
                |(mut events, mut confidences), (more, others)| {
                    events.extend(more);
                    confidences.add(others);
                    (events, confidences)
                },
            );
        events.par_sort_unstable_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
        (events, confidences)
    }

    /// Calls `each` for each of a pixel's `on` ON events and `off` OFF events, in no particular order, with the
    /// offset in microseconds (0 to T - 1) and whether the event is ON. Returns the confidence of the times.
    fn pixel(
        &self,
        header: &Header,
        pixel: &Pixel,
        work: &mut Work,
        mut each: impl FnMut(u32, bool),
    ) -> Confidence {
        let placed = match &self.way {
            Way::Peaks(peaks) if self.finder == Finder::Exact => {
                let found = recover::pixel(header, peaks, pixel, work);
                let polarities = (0..).map(|i| i < pixel.on as usize);
                for (offset_us, is_on) in found.offsets_us.into_iter().zip(polarities) {
                    each(offset_us, is_on);
                }
                return found.confidence;
            }
            Way::Peaks(peaks) => placed_single(pixel).unwrap_or_else(|| peaks.pixel(pixel)),
            Way::Bins(bins) => {
                placed_single(pixel).unwrap_or_else(|| self.deal_to_bins(bins, pixel))
            }
        };
        let duration_us = f64::from(header.duration_us);
        for (u, sign) in placed {
            let offset_us = (u * duration_us).round().clamp(0.0, duration_us - 1.0);
            each(offset_us as u32, sign > 0.0);
        }
        Confidence::Approximate
    }

    /// Assigns a pixel's events to the bins whose signed counts they fit best.
    fn deal_to_bins(&self, bins: &Inverse, pixel: &Pixel) -> Vec<Placed> {
        let mut missing: Vec<f64> = (0..self.grid).map(|bin| bins.value(pixel, bin)).collect();
        let mut dealt = Vec::with_capacity((pixel.on + pixel.off) as usize);
        let mut held = vec![0_u32; self.grid];
        let (mut on, mut off) = (pixel.on, pixel.off);
        while on + off > 0 {
            let (most_on, most_off) = (plateau(&missing, 1.0), plateau(&missing, -1.0));
            let is_on = off == 0 || (on > 0 && missing[most_on] >= -missing[most_off]);
            let (bin, sign) = if is_on {
                (most_on, 1.0)
            } else {
                (most_off, -1.0)
            };
            if is_on {
                on -= 1;
            } else {
                off -= 1;
            }
            missing[bin] -= sign;
            held[bin] += 1;
            dealt.push((bin, sign));
        }
        // Spread the events of one bin evenly over it.
        let mut placed_in = vec![0_u32; self.grid];
        dealt
            .into_iter()
            .map(|(bin, sign)| {
                let within = (f64::from(placed_in[bin]) + 0.5) / f64::from(held[bin]);
                placed_in[bin] += 1;
                ((bin as f64 + within) / self.grid as f64, sign)
            })
            .collect()
    }
}

/// Returns the event of a pixel whose only event time is sent in the frame.
fn placed_single(pixel: &Pixel) -> Option<Vec<Placed>> {
    let sign = if pixel.on > 0 { 1.0 } else { -1.0 };
    pixel.single_u.map(|u| vec![(u, sign)])
}

/// Returns the middle of the first run of bins where `sign` * value is largest. Pruning leaves runs of equal
/// values, and their middle is the best guess.
fn plateau(values: &[f64], sign: f64) -> usize {
    let most = values
        .iter()
        .fold(f64::NEG_INFINITY, |most, value| most.max(sign * value));
    let is_most = |value: &f64| sign * value >= most - 1e-9;
    let start = values.iter().position(is_most).unwrap_or(0);
    let len = values[start..]
        .iter()
        .take_while(|value| is_most(value))
        .count();
    start + len.saturating_sub(1) / 2
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
                    single_u: None,
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
                    single_u: None,
                };
                let (mut found_on, mut found_off) = (0, 0);
                decoder.pixel(&header, &pixel, &mut Work::default(), |offset_us, is_on| {
                    assert!(offset_us < 1000);
                    if is_on {
                        found_on += 1;
                    } else {
                        found_off += 1;
                    }
                });
                assert_eq!((found_on, found_off), (on, off));
            }
        }
    }
}
