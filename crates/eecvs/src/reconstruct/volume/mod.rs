//! The dense volume of a window: C x H x W of f32, a plane at a time.
//!
//! | form | channels | value |
//! |---|---|---|
//! | coefficients | K, or 2 K of complex ones (re and im in turn) | c_k of eq. 6; pruned ones are 0, c_0 is ON minus OFF |
//! | sums | B, or 2 B with polarities apart | sum of the polarities of the bin's events |
//! | bilinear | the same | sum over the pixel's events of p max(0, 1 - \|b - (B - 1) u\|) |
//!
//! Sums and bilinear values are made of events. So they are exact wherever events are, whatever M is. Where
//! a window travelled as coefficients alone, its sums are the inverse transform ([`inverse`]), and its bilinear
//! values are those of the event times that are solved for.

pub mod coefficients;
pub mod inverse;
mod normalise;
mod voxel;

use event_types::ensure;
use event_types::stream::Result;

use self::coefficients::Coefficients;
use self::inverse::Inverse;
use self::normalise::Scale;
pub use self::voxel::Weights;
use self::voxel::{Form as VoxelForm, Voxels};
use super::DecodedWindow;
use super::events::Finder;
use crate::decode::WindowEvents;

/// What the channels of a volume are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// The kept coefficients, in basis order.
    Coefficients,
    /// Bins in time.
    Bins {
        /// B, at least 1.
        count: u16,
        /// What an event adds to which bins.
        weights: Weights,
        /// Whether ON events have B channels, and OFF events, counted as positive, the B after them.
        split: bool,
    },
}

/// Which volume is made of a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Form {
    /// Its channels.
    pub channels: Channels,
    /// Whether the values that are not 0 are scaled to a mean of 0 and a standard deviation of 1 over the volume; where
    /// all are the same, only the mean is taken off. The deviation is that of the population.
    pub normalised: bool,
}

/// Makes volumes of one form.
#[derive(Debug)]
pub struct Maker {
    form: Form,
    /// Finds the events of windows that came as coefficients.
    events: WindowEvents,
    /// The table that fitted the last window.
    inverse: Option<Inverse>,
}

/// The volume of one window.
#[derive(Debug)]
pub struct Volume<'m> {
    shape: [usize; 3],
    values: Values<'m>,
    scale: Option<Scale>,
}

/// How the planes of a volume are filled.
#[derive(Debug)]
enum Values<'m> {
    Coefficients(Coefficients),
    Inverse(&'m Inverse, &'m DecodedWindow),
    Voxels(Voxels),
}

impl Maker {
    /// Volumes of `form`; `finder` is for the event times of windows of coefficients.
    #[must_use]
    pub fn new(form: Form, finder: Finder) -> Self {
        Self {
            form,
            events: WindowEvents::new(finder),
            inverse: None,
        }
    }

    /// The volume of `window`.
    ///
    /// # Errors
    /// Polarities apart of a window whose coefficients hold their difference alone.
    pub fn volume<'m>(&'m mut self, window: &'m DecodedWindow) -> Result<Volume<'m>> {
        let sensor = window.header.sensor;
        let sides = [usize::from(sensor.height), usize::from(sensor.width)];
        let of_coefficients = window.header.mode.is_transform();
        let (channels, values) = match self.form.channels {
            Channels::Coefficients => {
                let coefficients = Coefficients::new(window)?;
                (window.channels(), Values::Coefficients(coefficients))
            }
            Channels::Bins {
                count,
                weights: Weights::Nearest,
                split,
            } if of_coefficients => {
                ensure!(
                    !split,
                    Refused,
                    "the window at {} us is of coefficients, which hold ON minus OFF: polarities cannot be told apart",
                    window.header.t0_us
                );
                let (transform, grid) = (window.header.transform, window.header.grid);
                let count = usize::from(count);
                let table = self.inverse.take();
                let table = table.filter(|table| table.fits(transform, grid, count));
                let table = table.unwrap_or_else(|| Inverse::new(transform, grid, count));
                let table = self.inverse.insert(table);
                (count, Values::Inverse(table, window))
            }
            Channels::Bins {
                count,
                weights,
                split,
            } => {
                let form = VoxelForm {
                    bins: count,
                    weights,
                    split,
                };
                let voxels = if of_coefficients {
                    let mut window = window.clone();
                    self.events.fill(&mut window);
                    Voxels::new(&window, form)
                } else {
                    Voxels::new(window, form)
                };
                (form.channels(), Values::Voxels(voxels))
            }
        };
        let mut volume = Volume {
            shape: [channels, sides[0], sides[1]],
            values,
            scale: None,
        };
        if self.form.normalised {
            volume.scale = Some(Scale::of(&volume));
        }
        Ok(volume)
    }
}

impl Volume<'_> {
    /// C, H and W.
    #[must_use]
    pub const fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Fills channel `channel`, an H x W plane, rows from the top.
    pub fn plane(&self, channel: usize, plane: &mut [f32]) {
        plane.fill(0.0);
        match &self.values {
            Values::Coefficients(coefficients) => coefficients.plane(channel, plane),
            Values::Inverse(table, window) => table.plane(window, channel, plane),
            Values::Voxels(voxels) => voxels.plane(channel, plane),
        }
        if let Some(scale) = self.scale {
            scale.apply(plane);
        }
    }
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Event, Polarity};

    use super::super::{Pixel, test_header};
    use super::*;

    fn window(events: Vec<Event>) -> DecodedWindow {
        let mut header = test_header::header(100);
        header.mode = eecvs_nostd::Mode::Hybrid(eecvs_nostd::Hybrid {
            coder: eecvs_nostd::Coder::Fast,
            fidelity: eecvs_nostd::Fidelity::Lossless,
        });
        DecodedWindow {
            header,
            pixels: vec![],
            events,
        }
    }

    fn event(since_us: u64, x: u16, y: u16, on: bool) -> Event {
        Event {
            t_us: 5000 + since_us,
            x,
            y,
            polarity: Polarity::from_bool(on),
        }
    }

    fn values(form: Form, window: &DecodedWindow) -> Vec<f32> {
        let mut maker = Maker::new(form, Finder::Exact);
        let volume = maker.volume(window).unwrap();
        let [channels, height, width] = volume.shape();
        let mut values = vec![7.0; channels * height * width];
        for (channel, plane) in values.chunks_mut(height * width).enumerate() {
            volume.plane(channel, plane);
        }
        values
    }

    fn bins(count: u16, weights: Weights, split: bool, normalised: bool) -> Form {
        Form {
            channels: Channels::Bins {
                count,
                weights,
                split,
            },
            normalised,
        }
    }

    #[test]
    fn polarities_apart_are_both_positive() {
        let window = window(vec![
            event(0, 1, 0, true),
            event(99, 1, 0, false),
            event(99, 1, 0, false),
        ]);
        let signed = values(bins(2, Weights::Nearest, false, false), &window);
        assert_eq!((signed.len(), signed[1], signed[32 + 1]), (64, 1.0, -2.0));
        let split = values(bins(2, Weights::Nearest, true, false), &window);
        assert_eq!(split.len(), 128);
        let found: Vec<f32> = (0..4).map(|channel| split[32 * channel + 1]).collect();
        assert_eq!(found, [1.0, 0.0, 0.0, 2.0]);
    }

    #[test]
    fn normalised_values_have_a_mean_of_0_and_a_deviation_of_1() {
        let window = window(vec![
            event(0, 1, 0, true),
            event(1, 2, 0, true),
            event(2, 2, 0, true),
            event(60, 3, 1, false),
        ]);
        let plain = values(bins(3, Weights::Nearest, false, false), &window);
        let scaled = values(bins(3, Weights::Nearest, false, true), &window);
        let found: Vec<f64> = plain
            .iter()
            .zip(&scaled)
            .filter(|(plain, _)| **plain != 0.0)
            .map(|(_, scaled)| f64::from(*scaled))
            .collect();
        assert_eq!(found.len(), 3);
        let mean = found.iter().sum::<f64>() / 3.0;
        let variance = found.iter().map(|value| value * value).sum::<f64>() / 3.0;
        assert!(mean.abs() < 1e-6 && (variance - 1.0).abs() < 1e-6);
        let zeros = plain
            .iter()
            .zip(&scaled)
            .filter(|(plain, _)| **plain == 0.0);
        assert!(zeros.into_iter().all(|(_, scaled)| *scaled == 0.0));
    }

    #[test]
    fn values_that_are_all_the_same_become_0() {
        let window = window(vec![event(0, 1, 0, true), event(1, 2, 0, true)]);
        let scaled = values(bins(1, Weights::Bilinear, false, true), &window);
        assert!(scaled.iter().all(|value| *value == 0.0));
    }

    #[test]
    fn coefficients_cannot_be_split() {
        let window = DecodedWindow {
            header: test_header::header(100),
            pixels: vec![Pixel {
                x: 0,
                y: 0,
                on: 2,
                off: 1,
                coefficients: vec![],
                single_u: None,
            }],
            events: vec![],
        };
        let form = bins(4, Weights::Nearest, true, false);
        let mut maker = Maker::new(form, Finder::Exact);
        assert!(maker.volume(&window).is_err());
        // c_0 is the counts', kept or not.
        let sums = values(bins(4, Weights::Nearest, false, false), &window);
        let of_pixel: Vec<f32> = (0..4).map(|bin| sums[32 * bin]).collect();
        assert_eq!(of_pixel, [0.25; 4]);
    }
}
