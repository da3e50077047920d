//! Densities of the windows of a set, and the resulting regimes.

use eecvs_bench::source::WINDOW_US;
use eecvs_nostd::{Density, Regime};
use serde::{Deserialize, Serialize};

use super::set::Set;

/// Densities of a source's windows, including empty ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SourceDensities {
    /// Name of the source.
    pub source: String,
    /// Events per pixel per second, window by window.
    pub density_per_px_s: Vec<f64>,
    /// Numbers of sparse, moderate and dense windows.
    pub regimes: [u64; 3],
}

/// Densities of a set's windows; the percentiles of the set are its thresholds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Densities {
    /// `scenes` or `recordings`.
    pub set: String,
    /// 25th percentile, in events per pixel per second.
    pub tau_low: f64,
    /// 75th percentile, in events per pixel per second.
    pub tau_high: f64,
    /// One entry per source.
    pub sources: Vec<SourceDensities>,
}

/// Measures the densities of windows of T = [`WINDOW_US`], aligned to each source's first event.
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
