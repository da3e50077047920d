//! Which of a sensor's frames have arrived here, run by run.

use std::collections::VecDeque;

use crate::order::Numbers;

/// Maximum number of runs that are tracked.
const RUNS_MAX: usize = 8;

/// Maximum number of earlier runs that are remembered.
const PAST_MAX: usize = 64;

/// A run of a sensor.
#[derive(Debug, Clone)]
struct Run {
    run: u64,
    /// `None` until a number of the run is known.
    numbers: Option<Numbers>,
    /// The highest number that has arrived.
    newest: Option<u64>,
    /// Number of the next frame, according to the sensor's last status.
    next: Option<u64>,
}

/// A frame's place among the frames of its sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In the present run, after all that have arrived.
    New,
    /// In an earlier run, or missing until now.
    Late,
    /// It arrived before.
    Again,
    /// In a run that is no longer tracked.
    Old,
}

/// The latest runs, and the losses of the earlier ones. Runs are in the order in which they were first heard; their
/// numbers, which come from the clock of the sensor's computer, say nothing of it.
#[derive(Debug, Clone, Default)]
pub struct Runs {
    /// The tracked runs, the present one last.
    runs: VecDeque<Run>,
    /// Runs that are no longer tracked.
    past: VecDeque<u64>,
    lost_before: u64,
}

impl Run {
    /// Returns the number of frames that exist and have not arrived.
    fn missing(&self) -> u64 {
        let numbers = self.numbers.as_ref();
        numbers.map_or(0, |numbers| {
            numbers.missing().saturating_add(numbers.lost())
        })
    }

    fn take(&mut self, number: u64) -> Place {
        let numbers = self.numbers.get_or_insert_with(|| Numbers::from(number));
        if !numbers.take(number) {
            return Place::Again;
        }
        // Compare with frames only, since statuses may overtake them.
        if self.newest.is_some_and(|newest| number < newest) {
            return Place::Late;
        }
        self.newest = Some(number);
        Place::New
    }
}

impl Runs {
    /// Returns the place of a tracked run; a run that is not known becomes the present one. `None` if it is no longer
    /// tracked.
    fn at(&mut self, run: u64) -> Option<usize> {
        if let Some(at) = self.runs.iter().position(|known| known.run == run) {
            return Some(at);
        }
        if self.past.contains(&run) {
            return None;
        }
        // If the sensor was known before, a new run is tracked from its first frame on.
        let numbers = (!self.runs.is_empty()).then(|| Numbers::from(0));
        self.runs.push_back(Run {
            run,
            numbers,
            newest: None,
            next: None,
        });
        if self.runs.len() > RUNS_MAX
            && let Some(oldest) = self.runs.pop_front()
        {
            self.lost_before = self.lost_before.saturating_add(oldest.missing());
            self.past.push_back(oldest.run);
        }
        if self.past.len() > PAST_MAX {
            self.past.pop_front();
        }
        Some(self.runs.len() - 1)
    }

    /// Records a frame, and returns its place.
    pub fn take(&mut self, run: u64, number: u64) -> Place {
        let Some(at) = self.at(run) else {
            return Place::Old;
        };
        let is_present = at + 1 == self.runs.len();
        match self.runs[at].take(number) {
            Place::New if !is_present => Place::Late,
            place => place,
        }
    }

    /// Records the sensor's report: its run, and that all frames below a number exist.
    pub fn told(&mut self, run: u64, next: u64) {
        let Some(at) = self.at(run) else { return };
        let run = &mut self.runs[at];
        // Frames and statuses travel separately: use the previous status, whose frames have had time to arrive.
        if let Some(earlier) = run.next.replace(next) {
            let numbers = run.numbers.get_or_insert_with(|| Numbers::from(earlier));
            numbers.until(earlier);
        }
    }

    /// Returns the present run; 0 if there is none.
    #[must_use]
    pub fn run(&self) -> u64 {
        self.runs.back().map_or(0, |run| run.run)
    }

    /// Returns the number of frames that have not arrived, in the present run and the one before.
    #[must_use]
    pub fn missing(&self) -> u64 {
        let both = self.runs.iter().rev().take(2);
        both.fold(0, |sum, run| sum.saturating_add(run.missing()))
    }

    /// Returns the number of frames that never arrived, in all earlier runs.
    #[must_use]
    pub fn missing_before(&self) -> u64 {
        let earlier = self.runs.iter().rev().skip(2);
        earlier.fold(self.lost_before, |sum, run| {
            sum.saturating_add(run.missing())
        })
    }
}
