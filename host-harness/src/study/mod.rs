//! Reproduces the paper's evaluation on emulated scenes and on recordings.
//!
//! ```text
//! set (scenes, recordings) -> source -> method -> events -> quality      Tables I and II, rate-distortion
//!                                                        -> times        errors of event times
//!                                                        -> perception   Tables IV and V, optical flow
//!                             windows -> speed                           Table III
//!                             density                                    histogram, regime over time
//! ```
//!
//! Every measurement is a row of one of the tables of [`Results`]. It is written to a [`store`] as soon as it is
//! made, so that an interrupted study resumes. [`claims`] compares the rows with the paper.

pub mod claims;
pub mod density;
pub mod effort;
pub mod equal_errors;
pub mod kernels;
pub mod method;
pub mod paper;
pub mod perception;
pub mod quality;
pub mod record;
pub mod set;
pub mod speed;
pub mod store;
pub mod times;

use std::cmp::Reverse;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::Result;
use eecvs_bench::source::Source;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::downstream::segment::Segmenter;
use density::Densities;
use effort::Effort;
use kernels::KernelRow;
use method::Method;
use perception::{Perception, Reference};
use quality::Quality;
use record::Record;
use set::Set;
use speed::Speed;
use store::{Row, Store};
use times::Times;

/// All results of a study: the contents of the page and of `results.json`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Results {
    /// What was measured, by which program, and when.
    pub record: Record,
    /// Rows of Tables I and II, and of the rate-distortion curves.
    pub quality: Vec<Quality>,
    /// Rows of Table III.
    pub speed: Vec<Speed>,
    /// Rows of Tables IV and V, and of optical flow.
    pub perception: Vec<Perception>,
    /// Errors of event times.
    pub times: Vec<Times>,
    /// Densities of the sets' windows.
    pub density: Vec<Densities>,
    /// Run time against error of kernels; empty in results from versions that did not store them.
    #[serde(default)]
    pub kernels: Vec<KernelRow>,
}

/// One method on one source, which is decoded once for all measurements.
struct Task<'s> {
    set: &'s Set,
    source: &'s Source,
    /// Perception of the original, which all methods are compared with.
    reference: &'s OnceLock<Reference>,
    method: Method,
}

/// Measures on all cores what the store does not have yet; calls `progress` with the number of finished tasks and
/// their total.
///
/// Rows that hold measured times ([`speed`]) come first, while nothing else runs.
///
/// # Errors
/// Fails if a codec breaks its promise or the store cannot be written.
pub fn run(
    sets: &[Set],
    effort: &Effort,
    segmenter: &dyn Segmenter,
    store: &Store,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<()> {
    if !store.has("speed") {
        store.add("speed", speed::measure(effort)?.into_iter().map(Row::Speed))?;
    }
    let sources = || {
        sets.iter()
            .flat_map(|set| set.sources.iter().map(move |source| (set, source)))
    };
    let references: Vec<OnceLock<Reference>> = sources().map(|_| OnceLock::new()).collect();
    for set in sets {
        let key = format!("density {}", set.name);
        if !store.has(&key) {
            store.add(&key, [Row::Density(density::measure(set))])?;
        }
    }
    let mut tasks = Vec::new();
    for ((set, source), reference) in sources().zip(&references) {
        tasks.extend(effort.methods().into_iter().map(|method| Task {
            set,
            source,
            reference,
            method,
        }));
    }
    tasks.sort_by_cached_key(|task| Reverse(task.cost()));
    let total = tasks.len();
    let left: Vec<&Task<'_>> = tasks
        .iter()
        .filter(|task| !store.has(&task.key()))
        .collect();
    let done = AtomicUsize::new(total - left.len());
    progress(total - left.len(), total);
    left.par_iter().try_for_each(|task| {
        let rows = task.measure(segmenter)?;
        store.add(&task.key(), rows)?;
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        progress(done, total);
        Ok(())
    })
}

impl Task<'_> {
    fn key(&self) -> String {
        format!(
            "{} {} {}",
            self.set.name,
            self.source.name,
            self.method.key()
        )
    }

    /// Estimates the duration. Long tasks come first, so that no core ends alone with one of them.
    fn cost(&self) -> u64 {
        self.source.events.len() as u64 * self.method.cost()
    }

    fn measure(&self, segmenter: &dyn Segmenter) -> Result<Vec<Row>> {
        let Self {
            set,
            source,
            reference,
            method,
        } = *self;
        let trip = method.round_trip(source, set.thresholds)?;
        let mut rows = vec![Row::Quality(quality::measure(set, source, method, &trip)?)];
        if method.has_time_errors() {
            rows.push(Row::Times(times::measure(set, source, method, &trip)));
        }
        if method.has_perception() {
            let of = perception::measure(set, source, method, &trip, segmenter, reference)?;
            rows.push(Row::Perception(of));
        }
        Ok(rows)
    }
}

#[cfg(test)]
mod tests;
