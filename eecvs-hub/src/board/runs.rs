//! Which of a sensor's frames have arrived here, run by run.

use crate::order::Numbers;

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
    /// In the present run or the one before it, and missing until now.
    Late,
    /// It arrived before.
    Again,
    /// In a run before these two, which is not tracked.
    Old,
}

/// The present run, the one before it, and the losses of the earlier ones.
#[derive(Debug, Clone, Default)]
pub struct Runs {
    now: Option<Run>,
    before: Option<Run>,
    /// Whether a status has named the present run.
    is_told: bool,
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
    /// Makes a run the present one.
    fn begin(&mut self, run: u64) {
        let known = self.before.take_if(|before| before.run == run);
        // If the sensor was known before, a new run is tracked from its first frame on.
        let numbers = self.now.is_some().then(|| Numbers::from(0));
        let began = known.unwrap_or(Run {
            run,
            numbers,
            newest: None,
            next: None,
        });
        let was = self.now.replace(began);
        if let Some(older) = std::mem::replace(&mut self.before, was) {
            self.lost_before = self.lost_before.saturating_add(older.missing());
        }
        self.is_told = false;
    }

    /// Records a frame, and returns its place.
    pub fn take(&mut self, run: u64, number: u64) -> Place {
        let is_now = self.now.as_ref().is_some_and(|now| now.run == run);
        if !is_now {
            if let Some(before) = self.before.as_mut().filter(|before| before.run == run) {
                return match before.take(number) {
                    Place::New => Place::Late,
                    place => place,
                };
            }
            // If a status has named the present run, an earlier run is old. Otherwise the sensor's clock may have
            // been set back.
            if self.is_told && self.now.as_ref().is_some_and(|now| run < now.run) {
                return Place::Old;
            }
            self.begin(run);
        }
        let now = self.now.as_mut();
        now.map_or(Place::Old, |now| now.take(number))
    }

    /// Records the sensor's report: its run, and that all frames below a number exist.
    pub fn told(&mut self, run: u64, next: u64) {
        if self.now.as_ref().is_none_or(|now| now.run != run) {
            self.begin(run);
        }
        self.is_told = true;
        let Some(now) = &mut self.now else { return };
        // Frames and statuses travel separately: use the previous status, whose frames have had time to arrive.
        if let Some(earlier) = now.next.replace(next) {
            let numbers = now.numbers.get_or_insert_with(|| Numbers::from(earlier));
            numbers.until(earlier);
        }
    }

    /// Returns the present run; 0 if there is none.
    #[must_use]
    pub fn run(&self) -> u64 {
        self.now.as_ref().map_or(0, |now| now.run)
    }

    /// Returns the number of frames that have not arrived, in the present run and the one before.
    #[must_use]
    pub fn missing(&self) -> u64 {
        let both = self.now.iter().chain(&self.before);
        both.fold(0, |sum, run| sum.saturating_add(run.missing()))
    }

    /// Returns the number of frames that never arrived, in all earlier runs.
    #[must_use]
    pub const fn missing_before(&self) -> u64 {
        self.lost_before
    }
}
