//! Dense volume of a window: C x H x W of f32, computed a plane at a time.
//!
//! | form | channels | value |
//! |---|---|---|
//! | coefficients | K, or 2 K (re, im in turn) if complex | c_k of eq. 6; pruned ones are 0, c_0 is ON minus OFF |
//! | sums | B, or 2 B with separate polarities | sum of the polarities of the bin's events |
//! | bilinear | as for sums | sum over the pixel's events of p max(0, 1 - \|b - (B - 1) u\|) |
//!
//! Sums and bilinear values are computed from events, so they are as exact as the events, whatever M is. If a
//! window was sent as coefficients, its sums come from the inverse transform ([`inverse`]), and its bilinear values
//! from the event times that are solved for.

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
use super::events::EventDecoder;
use super::recover::Confidences;

/// Meaning of a volume's channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channels {
    /// The kept coefficients, in basis order.
    Coefficients,
    /// Time bins.
    Bins {
        /// Number of bins B, at least 1.
        count: u16,
        /// How an event is distributed over the bins.
        weights: Weights,
        /// Whether polarities are separate: B channels of ON events, followed by B of OFF events, both counted as
        /// positive.
        split: bool,
    },
}

/// Form of the volume computed from a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Form {
    /// Meaning of the channels.
    pub channels: Channels,
    /// Whether nonzero values are scaled to a mean of 0 and a (population) standard deviation of 1 over the volume.
    /// If all are equal, only the mean is subtracted.
    pub normalised: bool,
}

/// Computes volumes of one form.
#[derive(Debug)]
pub struct Maker {
    form: Form,
    /// Recovers the events of windows sent as coefficients.
    events: EventDecoder,
    confidences: Confidences,
    /// Table for the shape of the last window.
    inverse: Option<Inverse>,
}

/// The volume of one window, whose planes are computed on request.
#[derive(Debug)]
pub struct Volume<'m> {
    shape: [usize; 3],
    values: Values<'m>,
    scale: Option<Scale>,
}

/// Source of the values of a volume's planes.
#[derive(Debug)]
enum Values<'m> {
    Coefficients(Coefficients),
    Inverse(&'m Inverse, &'m DecodedWindow),
    Voxels(Voxels),
}

impl Maker {
    /// Creates a maker of volumes of `form`; `events` finds the event times of windows of coefficients.
    #[must_use]
    pub fn new(form: Form, events: EventDecoder) -> Self {
        Self {
            form,
            events,
            confidences: Confidences::default(),
            inverse: None,
        }
    }

    /// Returns the confidence counts of the times that were found for the volumes so far.
    #[must_use]
    pub const fn confidences(&self) -> Confidences {
        self.confidences
    }

    /// Prepares the volume of `window`.
    ///
    /// # Errors
    /// Fails for sums with separate polarities if the window was sent as coefficients, which hold only ON minus
    /// OFF, and for coefficients if the encoder does not accept the window's events.
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
                    "the window at {} us holds coefficients, which encode ON minus OFF: the \
                     polarities cannot be separated",
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
                    self.confidences.add(self.events.fill(&mut window));
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
    /// Returns the shape: channels C, height H and width W.
    #[must_use]
    pub const fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Fills `plane` with channel `channel`: H x W values in raster order from the top row.
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

    use super::super::events::Finder;
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
        let mut maker = Maker::new(form, EventDecoder::new(Finder::Exact));
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
                times: vec![],
            }],
            events: vec![],
        };
        let form = bins(4, Weights::Nearest, true, false);
        let mut maker = Maker::new(form, EventDecoder::new(Finder::Exact));
        assert!(maker.volume(&window).is_err());
        // c_0 comes from the counts, whether it was kept or not.
        let sums = values(bins(4, Weights::Nearest, false, false), &window);
        let of_pixel: Vec<f32> = (0..4).map(|bin| sums[32 * bin]).collect();
        assert_eq!(of_pixel, [0.25; 4]);
    }
}
