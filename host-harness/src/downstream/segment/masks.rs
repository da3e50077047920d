//! Masks of the segments of a frame.

use anyhow::{Result, ensure};
use eecvs_nostd::Sensor;

/// Consecutive pixels of one label, in raster order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) pixels: u32,
    /// Label; 0 is the background.
    pub(super) label: u32,
}

/// A label image: 0 is the background, 1 to [`Masks::segments`] are the segments.
///
/// Stored as runs, since most of a frame is background and studies hold one of these per frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Masks {
    sensor: Sensor,
    runs: Vec<Run>,
    /// Area of each segment in pixels; none is 0.
    areas: Vec<u64>,
}

impl Masks {
    /// Makes masks from a label image in raster order. The labels that occur are renumbered from 1, in ascending
    /// order; 0 stays the background.
    ///
    /// # Errors
    /// Fails if there is not one label per pixel of `sensor`.
    pub fn new(sensor: Sensor, labels: &[u32]) -> Result<Self> {
        ensure!(
            labels.len() == sensor.pixels() as usize,
            "{} labels for {} x {} pixels",
            labels.len(),
            sensor.width,
            sensor.height
        );
        let mut runs: Vec<Run> = labels
            .chunk_by(|a, b| a == b)
            .map(|run| Run {
                // At most 2^22.
                pixels: run.len() as u32,
                label: run.first().copied().unwrap_or(0),
            })
            .collect();
        let mut known: Vec<u32> = runs.iter().map(|run| run.label).collect();
        known.push(0);
        known.sort_unstable();
        known.dedup();
        let mut areas = vec![0; known.len() - 1];
        for run in &mut runs {
            // Every label is in `known`, and there are no more labels than pixels.
            run.label = known.binary_search(&run.label).unwrap_or(0) as u32;
            if let Some(area) = segment(run.label).and_then(|number| areas.get_mut(number)) {
                *area += u64::from(run.pixels);
            }
        }
        Ok(Self {
            sensor,
            runs,
            areas,
        })
    }

    /// Returns the size of the frame.
    #[must_use]
    pub const fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// Returns the number of segments.
    #[must_use]
    pub fn segments(&self) -> usize {
        self.areas.len()
    }

    /// Returns the pixels of each segment, by label from 1; none is empty.
    #[must_use]
    pub fn areas(&self) -> &[u64] {
        &self.areas
    }

    /// Returns the label of every pixel, in raster order.
    #[must_use]
    pub fn labels(&self) -> Vec<u32> {
        let mut labels = Vec::with_capacity(self.sensor.pixels() as usize);
        for run in &self.runs {
            labels.extend(std::iter::repeat_n(run.label, run.pixels as usize));
        }
        labels
    }

    /// Calls `overlap(pixels, a, b)` for stretches of pixels with label `a` in `self` and `b` in `other`, in raster
    /// order.
    ///
    /// # Errors
    /// Fails if the masks differ in size.
    pub(super) fn overlaps(
        &self,
        other: &Self,
        mut overlap: impl FnMut(u32, u32, u32),
    ) -> Result<()> {
        ensure!(
            self.sensor == other.sensor,
            "masks of {} x {} and of {} x {} pixels cannot be compared",
            self.sensor.width,
            self.sensor.height,
            other.sensor.width,
            other.sensor.height
        );
        let (mut rest_a, mut rest_b) = (self.runs.iter().copied(), other.runs.iter().copied());
        let (mut run_a, mut run_b) = (rest_a.next(), rest_b.next());
        while let (Some(a), Some(b)) = (&mut run_a, &mut run_b) {
            let pixels = a.pixels.min(b.pixels);
            overlap(pixels, a.label, b.label);
            a.pixels -= pixels;
            b.pixels -= pixels;
            let (is_a_over, is_b_over) = (a.pixels == 0, b.pixels == 0);
            if is_a_over {
                run_a = rest_a.next();
            }
            if is_b_over {
                run_b = rest_b.next();
            }
        }
        Ok(())
    }
}

/// Returns the index from 0 of the segment with `label`; `None` for the background.
pub(super) fn segment(label: u32) -> Option<usize> {
    label.checked_sub(1).map(|number| number as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 4,
        height: 2,
    };

    #[test]
    fn labels_are_renumbered_in_their_order() {
        let masks = Masks::new(SENSOR, &[7, 7, 0, u32::MAX, 3, 0, 0, 7]).unwrap();
        assert_eq!(masks.segments(), 3);
        assert_eq!(masks.labels(), [2, 2, 0, 3, 1, 0, 0, 2]);
        assert_eq!(masks.areas(), [1, 3, 1]);
        let full = Masks::new(SENSOR, &[9; 8]).unwrap();
        assert_eq!((full.labels(), full.areas()), (vec![1; 8], &[8][..]));
        assert_eq!(Masks::new(SENSOR, &[0; 8]).unwrap().segments(), 0);
    }

    #[test]
    fn overlaps_cover_every_pixel() {
        let a = Masks::new(SENSOR, &[1, 1, 0, 0, 2, 2, 2, 0]).unwrap();
        let b = Masks::new(SENSOR, &[0, 1, 1, 0, 0, 0, 0, 3]).unwrap();
        let mut pairs = Vec::new();
        a.overlaps(&b, |pixels, a, b| {
            pairs.extend(std::iter::repeat_n((a, b), pixels as usize));
        })
        .unwrap();
        let expected: Vec<_> = a.labels().into_iter().zip(b.labels()).collect();
        assert_eq!(pairs, expected);
    }

    #[test]
    fn sizes_must_agree() {
        let error = Masks::new(SENSOR, &[0; 7]).unwrap_err();
        assert_eq!(error.to_string(), "7 labels for 4 x 2 pixels");
        let a = Masks::new(SENSOR, &[0; 8]).unwrap();
        let b = Masks::new(Sensor::new(2, 4).unwrap(), &[0; 8]).unwrap();
        assert!(a.overlaps(&b, |_, _, _| {}).is_err());
    }
}
