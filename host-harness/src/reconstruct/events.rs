//! Events from coefficients: the right number per pixel and polarity, at the best times found.
//!
//! The counts are on the link, so what is sought are n times. For the DCT and the DTFT they are
//! found one by one by matching pursuit with known amplitudes: an event p at u explains the
//! residual c best where
//!
//! ```text
//! J(u) = p sum_k Re(c_k conj(phi_k(u))) - sum_k |phi_k(u)|^2 / 2
//! ```
//!
//! is largest; the peak on a grid of four points per half-period of the highest frequency is
//! polished by Newton steps, and small pixels go through further rounds in which each event is
//! taken out and placed anew. The Haar coefficients are inverted to signed counts per bin, and
//! events are dealt to the bins that miss them most.

use eecvs_nostd::{Event, Polarity, Transform};
use rayon::prelude::*;

use super::bins::Bins;
use super::{DecodedWindow, Pixel, order};

/// Grid points per atom: four in each half-period of the highest one.
const POINTS_PER_ATOM: usize = 4;
/// Newton steps of a polish.
const NEWTON_STEPS: usize = 12;
/// Rounds in which every event is placed anew.
const ROUNDS: usize = 3;
/// Pixels with more events are not placed anew: the rounds would cost more than they mend.
const ROUNDS_EVENTS_MAX: usize = 16;

/// Decodes pixels of one transform, grid and M.
#[derive(Debug)]
pub struct EventDecoder {
    transform: Transform,
    grid: usize,
    /// r = min(M, K).
    kept: usize,
    /// Points of the search grid.
    points: usize,
    /// phi_k(point), as re and im: [point * grid + k].
    atoms_re: Vec<f32>,
    atoms_im: Vec<f32>,
    /// sum_k |phi_k|^2 / 2 of the DCT at each point.
    half_energy: Vec<f32>,
    /// Haar synthesis on K bins.
    bins: Option<Bins>,
}

/// A decoded event of a pixel: u and p.
type Placed = (f64, f64);

impl EventDecoder {
    /// Tables for windows like `window`.
    #[must_use]
    pub fn new(transform: Transform, grid: u16, m: u8) -> Self {
        let kept = usize::from(m).min(usize::from(grid));
        let bins =
            (transform == Transform::Dwt).then(|| Bins::new(transform, grid, usize::from(grid)));
        let grid = usize::from(grid);
        let points = if bins.is_some() {
            0
        } else {
            (POINTS_PER_ATOM * grid).max(64)
        };
        let mut decoder = Self {
            transform,
            grid,
            kept,
            points,
            atoms_re: Vec::with_capacity(points * grid),
            atoms_im: Vec::with_capacity(points * grid),
            half_energy: Vec::with_capacity(points),
            bins,
        };
        for point in 0..points {
            let u = (point as f64 + 0.5) / points as f64;
            let mut energy = 0.0;
            for k in 0..grid {
                let angle = decoder.omega(k) * u;
                decoder.atoms_re.push(angle.cos() as f32);
                decoder.atoms_im.push(-angle.sin() as f32);
                if k > 0 && k < kept {
                    energy += angle.cos().powi(2);
                }
            }
            decoder.half_energy.push((energy / 2.0) as f32);
        }
        decoder
    }

    /// Whether the tables fit a window.
    #[must_use]
    pub fn fits(&self, window: &DecodedWindow) -> bool {
        let header = &window.header;
        self.transform == header.transform
            && self.grid == usize::from(header.grid)
            && self.kept == usize::from(header.m).min(self.grid)
    }

    /// Angle per u of atom k.
    fn omega(&self, k: usize) -> f64 {
        let half_turns = match self.transform {
            Transform::Dct => k,
            Transform::Dtft | Transform::Dwt => 2 * k,
        };
        std::f64::consts::PI * half_turns as f64
    }

    /// A window's events, ordered by time, row and column.
    #[must_use]
    pub fn window(&self, window: &DecodedWindow) -> Vec<Event> {
        if !window.events.is_empty() {
            return order::by_time(&window.header, &window.events);
        }
        let header = &window.header;
        let duration_us = f64::from(header.duration_us);
        let mut events: Vec<Event> = window
            .pixels
            .par_iter()
            .with_min_len(64)
            .flat_map_iter(|pixel| {
                self.pixel(pixel).into_iter().map(|(u, sign)| {
                    let offset_us = (u * duration_us).round().clamp(0.0, duration_us - 1.0);
                    Event {
                        t_us: header.t0_us.saturating_add(offset_us as u64),
                        x: pixel.x,
                        y: pixel.y,
                        polarity: Polarity::from_bool(sign > 0.0),
                    }
                })
            })
            .collect();
        events.par_sort_unstable_by_key(|event| (event.t_us, event.y, event.x, event.polarity));
        events
    }

    /// u and p of a pixel's events: `on` of +1 and `off` of -1, in no order.
    #[must_use]
    pub fn pixel(&self, pixel: &Pixel) -> Vec<Placed> {
        if let Some(u) = pixel.single_u {
            return vec![(u, if pixel.on > 0 { 1.0 } else { -1.0 })];
        }
        match &self.bins {
            Some(bins) => self.deal_to_bins(bins, pixel),
            None => Pursuit::new(self, pixel).run(pixel.on, pixel.off),
        }
    }

    /// Deals a pixel's events to the bins whose signed count they fit best.
    fn deal_to_bins(&self, bins: &Bins, pixel: &Pixel) -> Vec<Placed> {
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
        // Events of one bin are spread over it.
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

/// Middle of the first run of bins where `sign` * value is largest: pruning leaves runs of equal
/// values, whose middle is the best guess.
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

/// Matching pursuit of one pixel.
struct Pursuit<'d> {
    decoder: &'d EventDecoder,
    /// Indices of the known coefficients, ascending; k = 0 tells nothing of times.
    known: Vec<usize>,
    /// What the events placed so far leave of the coefficients.
    re: Vec<f32>,
    im: Vec<f32>,
}

impl<'d> Pursuit<'d> {
    fn new(decoder: &'d EventDecoder, pixel: &Pixel) -> Self {
        let mut re = vec![0.0; decoder.grid];
        let mut im = vec![0.0; decoder.grid];
        for (k, of_re, of_im) in &pixel.coefficients {
            (re[usize::from(*k)], im[usize::from(*k)]) = (*of_re as f32, *of_im as f32);
        }
        let known = if decoder.transform == Transform::Dct {
            // The DCT keeps every k < r: a coefficient that was not sent is known to be 0.
            (1..decoder.kept).collect()
        } else {
            let sent = pixel.coefficients.iter().map(|(k, ..)| usize::from(*k));
            sent.filter(|k| *k > 0).collect()
        };
        (re[0], im[0]) = (0.0, 0.0);
        Self {
            decoder,
            known,
            re,
            im,
        }
    }

    /// One more than the highest known k.
    fn limit(&self) -> usize {
        self.known.last().map_or(0, |k| k + 1)
    }

    /// sum_k a_k b_k over the known coefficients, of which the others of `a` are 0.
    fn dot_known(&self, a: &[f32], b: &[f32]) -> f32 {
        let limit = self.limit();
        // A few of a large grid are picked out; else all are faster in vector registers.
        if limit > 8 * self.known.len() {
            self.known.iter().map(|k| a[*k] * b[*k]).sum()
        } else {
            dot(&a[..limit], &b[..limit])
        }
    }

    fn run(mut self, mut on: u32, mut off: u32) -> Vec<Placed> {
        let mut placed = Vec::with_capacity((on + off) as usize);
        while on + off > 0 {
            let event = self.best(on > 0, off > 0);
            if event.1 > 0.0 {
                on -= 1;
            } else {
                off -= 1;
            }
            self.add(event, -1.0);
            placed.push(event);
        }
        if placed.len() > 1 && placed.len() <= ROUNDS_EVENTS_MAX {
            for _ in 0..ROUNDS {
                for event in &mut placed {
                    self.add(*event, 1.0);
                    *event = self.best(event.1 > 0.0, event.1 < 0.0);
                    self.add(*event, -1.0);
                }
            }
        }
        placed
    }

    /// Adds `factor` times an event's atoms to the residual.
    fn add(&mut self, (u, sign): Placed, factor: f64) {
        let step = self.decoder.omega(1) * u;
        let (sin, cos) = step.sin_cos();
        let (mut atom_re, mut atom_im) = (1.0, 0.0);
        let complex = self.decoder.transform.is_complex();
        let mut known = self.known.iter().peekable();
        for k in 0..self.limit() {
            if known.next_if_eq(&&k).is_some() {
                self.re[k] += (factor * sign * atom_re) as f32;
                if complex {
                    self.im[k] -= (factor * sign * atom_im) as f32;
                }
            }
            (atom_re, atom_im) = (atom_re * cos - atom_im * sin, atom_re * sin + atom_im * cos);
        }
    }

    /// The event that explains the residual best.
    fn best(&self, may_be_on: bool, may_be_off: bool) -> Placed {
        let decoder = self.decoder;
        let mut best = (f32::NEG_INFINITY, 0, 1.0);
        for point in 0..decoder.points {
            let atoms = point * decoder.grid..(point + 1) * decoder.grid;
            let mut correlation: f32 = self.dot_known(&self.re, &decoder.atoms_re[atoms.clone()]);
            let mut half_energy = 0.0;
            if decoder.transform.is_complex() {
                correlation += self.dot_known(&self.im, &decoder.atoms_im[atoms]);
            } else {
                half_energy = decoder.half_energy[point];
            }
            if may_be_on && correlation - half_energy > best.0 {
                best = (correlation - half_energy, point, 1.0);
            }
            if may_be_off && -correlation - half_energy > best.0 {
                best = (-correlation - half_energy, point, -1.0);
            }
        }
        let (_, point, sign) = best;
        let u = (point as f64 + 0.5) / decoder.points as f64;
        (self.polish(u, sign), sign)
    }

    /// Newton steps on J from a grid point, staying within its cell and the two beside it.
    fn polish(&self, start: f64, sign: f64) -> f64 {
        let reach = 1.0 / self.decoder.points as f64;
        let mut u = start;
        for _ in 0..NEWTON_STEPS {
            let (slope, curvature) = self.derivatives(u, sign);
            if curvature >= 0.0 {
                break;
            }
            let next = (u - slope / curvature)
                .clamp(start - reach, start + reach)
                .clamp(0.0, 1.0);
            let moved = (next - u).abs();
            u = next;
            if moved < 1e-9 {
                break;
            }
        }
        u
    }

    /// J' and J''.
    fn derivatives(&self, u: f64, sign: f64) -> (f64, f64) {
        let base = self.decoder.omega(1);
        let complex = self.decoder.transform.is_complex();
        let (sin_1, cos_1) = (base * u).sin_cos();
        let (mut cos, mut sin) = (1.0, 0.0);
        let (mut slope, mut curvature) = (0.0, 0.0);
        // What is not known adds nothing: k = 0 has omega = 0, the DCT knows all others, and
        // re = im = 0 for those that the DTFT does not know.
        for k in 0..self.limit() {
            let omega = base * k as f64;
            let (re, im) = (f64::from(self.re[k]), f64::from(self.im[k]));
            if complex {
                // Re(c conj(phi)) = re cos - im sin
                slope -= sign * omega * (re * sin + im * cos);
                curvature -= sign * omega * omega * (re * cos - im * sin);
            } else {
                // p c cos - cos^2 / 2
                slope += omega * sin * (cos - sign * re);
                curvature += omega * omega * (cos * cos - sin * sin - sign * re * cos);
            }
            (cos, sin) = (cos * cos_1 - sin * sin_1, sin * cos_1 + cos * sin_1);
        }
        (slope, curvature)
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    // Eight lanes, so that the compiler may use vector registers.
    let mut lanes = [0.0_f32; 8];
    let (a_blocks, b_blocks) = (a.chunks_exact(8), b.chunks_exact(8));
    let tail: f32 = a_blocks
        .remainder()
        .iter()
        .zip(b_blocks.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in a_blocks.zip(b_blocks) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    lanes.iter().sum::<f32>() + tail
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::test_header::header;
    use std::f64::consts::{PI, TAU};

    fn coefficients(transform: Transform, grid: u16, events: &[Placed]) -> Vec<(u16, f64, f64)> {
        (0..grid)
            .map(|k| {
                let (mut re, mut im) = (0.0, 0.0);
                for (u, sign) in events {
                    let k = f64::from(k);
                    match transform {
                        Transform::Dct => re += sign * (PI * k * u).cos(),
                        _ => {
                            re += sign * (TAU * k * u).cos();
                            im -= sign * (TAU * k * u).sin();
                        }
                    }
                }
                (k, re, im)
            })
            .collect()
    }

    fn decode(transform: Transform, events: &[Placed]) -> Vec<Placed> {
        let on = events.iter().filter(|event| event.1 > 0.0).count() as u32;
        let off = events.len() as u32 - on;
        let grid = transform.grid_size(16, None).min(16);
        let decoder = EventDecoder::new(transform, grid, 16);
        let coefficients = coefficients(transform, grid, events);
        let mut placed = decoder.pixel(&Pixel {
            x: 0,
            y: 0,
            on,
            off,
            coefficients,
            single_u: None,
        });
        placed.sort_by(|a, b| a.0.total_cmp(&b.0));
        placed
    }

    #[test]
    fn separate_events_come_back_to_a_millionth_of_the_window() {
        for transform in [Transform::Dct, Transform::Dtft] {
            for events in [
                vec![(0.3, 1.0)],
                vec![(0.001, -1.0)],
                vec![(0.2, 1.0), (0.7, -1.0)],
                vec![(0.15, 1.0), (0.45, 1.0), (0.8, -1.0)],
            ] {
                let placed = decode(transform, &events);
                for (found, true_event) in placed.iter().zip(&events) {
                    assert_eq!(found.1, true_event.1);
                    let error = (found.0 - true_event.0).abs();
                    assert!(error < 1e-5, "{transform:?} {events:?} {placed:?}");
                }
            }
        }
    }

    #[test]
    fn times_are_rounded_to_the_nearest_microsecond() {
        let (decoder, duration_us) = (EventDecoder::new(Transform::Dtft, 16, 16), 1000);
        for offset_us in (0..duration_us).step_by(37).chain([duration_us - 1]) {
            let u = f64::from(offset_us) / f64::from(duration_us);
            let window = DecodedWindow {
                header: header(duration_us),
                pixels: vec![Pixel {
                    x: 3,
                    y: 1,
                    on: 0,
                    off: 1,
                    coefficients: coefficients(Transform::Dtft, 16, &[(u, -1.0)]),
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
            assert_eq!(decoder.window(&window), [event]);
        }
    }

    #[test]
    fn counts_are_kept_whatever_the_coefficients_say() {
        for transform in Transform::ALL {
            let decoder = EventDecoder::new(transform, 16, 8);
            for (on, off) in [(3, 0), (0, 5), (40, 2)] {
                let pixel = Pixel {
                    x: 0,
                    y: 0,
                    on,
                    off,
                    coefficients: vec![(3, 1.0, 2.0)],
                    single_u: None,
                };
                let placed = decoder.pixel(&pixel);
                assert_eq!(
                    placed.iter().filter(|event| event.1 > 0.0).count(),
                    on as usize
                );
                assert_eq!(placed.len(), (on + off) as usize);
                assert!(placed.iter().all(|event| (0.0..=1.0).contains(&event.0)));
            }
        }
    }
}
