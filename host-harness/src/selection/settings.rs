//! The fixed settings of mode `transform`, and the search for the coarsest times in mode `hybrid`.

use anyhow::{Context, Result};
use eecvs_nostd::{Config, Quantiser, Transform};

use super::Effort;
use super::errors::{Errors, SIGMA_US};

/// Largest tolerance, and largest mean error, in us: its cells are longer than a window, so larger ones change
/// nothing.
const MAX_US: u32 = 16_384;

/// Transform, M and step, the same in all windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setting {
    /// The transform, or `None` for the density's (eq. 3).
    pub transform: Option<Transform>,
    /// Number of coefficients M.
    pub m: u8,
    /// log2 of the quantiser's step.
    pub step_log2: i8,
}

impl Setting {
    /// Returns the name without the coder, as `DCT, M = 3, step 2^-2`.
    #[must_use]
    pub fn name(&self) -> String {
        let transform = match self.transform {
            None => "eq. 3",
            Some(Transform::Dct) => "DCT",
            Some(Transform::Dtft) => "DTFT",
            Some(Transform::Dwt) => "Haar",
        };
        format!("{transform}, M = {}, step 2^{}", self.m, self.step_log2)
    }

    /// Returns the configuration with the setting's step, and for the Haar transform with a grid of K = M.
    ///
    /// # Errors
    /// Fails if the step is out of range.
    pub fn config(&self, config: Config) -> Result<Config> {
        let is_haar = self.transform == Some(Transform::Dwt);
        Ok(Config {
            grid: is_haar.then(|| self.m.into()),
            quantiser: Quantiser::new(self.step_log2).context("a step out of range")?,
            ..config
        })
    }
}

/// Search for the largest tolerance or mean error whose error is no larger than asked for.
#[derive(Debug, Clone, Copy)]
pub struct Search {
    start_us: u32,
    error: fn(&Errors) -> f64,
    most: f64,
    /// Whether the error grows with the square, nearly, and not in proportion.
    is_squared: bool,
}

impl Search {
    /// Returns the search for the largest tolerance with a mean error of at most `most_us`: from 2 E - 1 on, with whose
    /// cells of 4 E - 1 times are off by nearly E on average.
    #[must_use]
    pub fn of_times(most_us: u32) -> Self {
        Self {
            start_us: (2 * most_us).saturating_sub(1),
            error: |errors| errors.emd_pixel_us,
            most: most_us.into(),
            is_squared: false,
        }
    }

    /// Returns the search for the largest mean error E with an error of the volume of at most `most`.
    ///
    /// Single events that are off by up to 2 E have an error of (2 E)^2 / 3 / 2 sigma^2, with which the search begins.
    #[must_use]
    pub fn of_volume(most: f64) -> Self {
        Self {
            start_us: (SIGMA_US * (1.5 * most).sqrt()) as u32,
            error: |errors| errors.volume,
            most,
            is_squared: true,
        }
    }

    /// Returns the search for the largest tolerance instead, twice the mean error.
    #[must_use]
    pub const fn tolerance(self) -> Self {
        Self {
            start_us: 2 * self.start_us,
            ..self
        }
    }

    /// Calls `measure` with up to `tries` different values, each nearer to the one that is searched.
    ///
    /// # Errors
    /// Those of `measure`.
    pub fn run(self, tries: usize, measure: &mut dyn FnMut(u32) -> Result<Errors>) -> Result<()> {
        let (mut low, mut high) = (0, MAX_US + 1);
        let mut at = self.start_us.clamp(1, MAX_US);
        let mut beyond = 0;
        for _ in 0..tries {
            let error = (self.error)(&measure(at)?);
            if error <= self.most {
                low = at;
                beyond = 0;
            } else {
                high = at;
                beyond += 1;
            }
            if high - low <= 1 {
                break;
            }
            // Steps that are all a little too long would never end within the error.
            let aim = if beyond < 2 {
                self.most
            } else {
                0.98 * self.most
            };
            let change = aim / error.max(self.most / 1000.0);
            let change = if self.is_squared {
                change.sqrt()
            } else {
                change
            };
            at = ((f64::from(at) * change) as u32).clamp(low + 1, high - 1);
        }
        Ok(())
    }
}

/// Returns the settings of one transform.
#[must_use]
pub fn fixed(effort: &Effort) -> Vec<Setting> {
    let each = effort.m.iter();
    each.flat_map(|(transform, m)| of(Some(*transform), m, effort))
        .collect()
}

/// Returns the settings in which the density chooses the transform (eq. 3).
#[must_use]
pub fn by_density(effort: &Effort) -> Vec<Setting> {
    of(None, effort.eq3_m, effort)
}

fn of(transform: Option<Transform>, m: &[u8], effort: &Effort) -> Vec<Setting> {
    let each = m.iter().flat_map(|m| {
        effort.steps_log2.iter().map(move |step_log2| Setting {
            transform,
            m: *m,
            step_log2: *step_log2,
        })
    });
    each.collect()
}
