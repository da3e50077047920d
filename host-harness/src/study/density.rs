//! Densities of the windows of a set, and the regimes that they make.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Density, Regime};
use serde::{Deserialize, Serialize};

use super::set::Set;

/// The windows of a source, empty ones included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceDensities {
    /// Its name.
    pub source: String,
    /// Events per pixel and second of one window after the other.
    pub density_per_px_s: Vec<f64>,
    /// Windows that are sparse, moderate, dense.
    pub regimes: [u64; 3],
}

/// The windows of a set, and the thresholds that its percentiles are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Densities {
    /// `scenes` or `recordings`.
    pub set: String,
    /// 25th percentile, events per pixel and second.
    pub tau_low: f64,
    /// 75th percentile, events per pixel and second.
    pub tau_high: f64,
    /// One for each source.
    pub sources: Vec<SourceDensities>,
}

/// The densities of windows of T, aligned to the first event.
#[must_use]
pub fn measure(set: &Set) -> Densities {
    let [tau_low, tau_high] = set.tau;
    let sources = set.sources.iter().map(|source| {
        let start_us = source.start_us();
        let window = |t_us: u64| ((t_us - start_us) / u64::from(WINDOW_US)) as usize;
        let count = source.events.last().map_or(0, |last| window(last.t_us) + 1);
        let mut events = vec![0_u32; count];
        for event in source.events.iter() {
            if let Some(n) = events.get_mut(window(event.t_us)) {
                *n += 1;
            }
        }
        let mut regimes = [0; 3];
        let density_per_px_s = events.into_iter().map(|events| {
            let density = Density {
                events,
                pixels: source.sensor.pixels(),
                duration_us: WINDOW_US,
            };
            match set.thresholds.regime(density) {
                Regime::Sparse => regimes[0] += 1,
                Regime::Moderate => regimes[1] += 1,
                Regime::Dense => regimes[2] += 1,
            }
            density.per_pixel_s()
        });
        SourceDensities {
            source: source.name.clone(),
            density_per_px_s: density_per_px_s.collect(),
            regimes,
        }
    });
    Densities {
        set: set.name.to_owned(),
        tau_low,
        tau_high,
        sources: sources.collect(),
    }
}
