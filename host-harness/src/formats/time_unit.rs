//! In which unit a file without a word about it holds its times.

/// Fewest distinct whole values that speak against seconds.
const WHOLE_VALUES: usize = 16;

/// Largest time in seconds that is believed of whole numbers: beyond the year 2286.
const SECONDS_MAX: f64 = 1e10;

/// Collects the first times of a file whose times are decimals or floats.
///
/// They are seconds, as in the RPG and MVSEC data sets, unless all of the sample are whole
/// numbers and there are at least 16 different ones, or one of 1e10 and more: whole microseconds
/// in a float column.
#[derive(Debug, Default)]
pub struct TimeSample {
    fraction: bool,
    large: bool,
    whole: std::collections::BTreeSet<u64>,
}

impl TimeSample {
    /// Takes one time.
    pub fn add(&mut self, whole: bool, value: f64) {
        self.fraction |= !whole;
        self.large |= value >= SECONDS_MAX;
        if self.whole.len() < WHOLE_VALUES {
            self.whole.insert(value.to_bits());
        }
    }

    /// Whether the times are seconds.
    pub fn seconds(&self) -> bool {
        self.fraction || !(self.large || self.whole.len() >= WHOLE_VALUES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(times: &[f64]) -> bool {
        let mut sample = TimeSample::default();
        for time in times {
            sample.add(time.fract() == 0.0, *time);
        }
        sample.seconds()
    }

    #[test]
    fn seconds_unless_whole_and_many_or_large() {
        let counted: Vec<f64> = (0..16).map(f64::from).collect();
        assert!(!seconds(&counted));
        assert!(seconds(&counted[..15]));
        assert!(seconds(&[counted, vec![0.5]].concat()));
        assert!(seconds(&[0.0; 100]));
        assert!(!seconds(&[1.6e15]));
        assert!(seconds(&[1.6e9]));
    }
}
