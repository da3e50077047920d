//! Compares segments of the original and of the decoded events, slice by slice.

use std::cmp::Ordering;

use anyhow::{Context, Result, ensure};
use eecvs_bench::source::Source;
use eecvs_nostd::Event;
use serde::Serialize;

use super::segment::iou::{foreground_iou, mean_iou};
use super::segment::{Frame, Masks, Segmenter};
use super::slices::Slices;

/// Number of frames in memory at a time.
const BATCH: usize = 16;

/// Agreement of the segments; the fields are JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Segmentation {
    /// Number of frames that have a [`mean_iou`]; 0 if the segments are the same in every frame, whatever its events.
    pub frames: usize,
    /// Mean of [`foreground_iou`] over the frames that have one; `None` if there are none.
    pub foreground_iou: Option<f64>,
    /// Mean of [`mean_iou`] over the frames that have one; `None` if there are none.
    pub mean_iou: Option<f64>,
}

/// Compares the segments of a recording with those of its decoded events; use [`SegmentationReference`] to compare
/// one recording with several decoded versions.
///
/// # Errors
/// Fails as [`SegmentationReference::new`] and [`SegmentationReference::against`] do.
pub fn segmentation(
    original: &Source,
    decoded: &[Event],
    slice_us: u32,
    segmenter: &dyn Segmenter,
) -> Result<Segmentation> {
    SegmentationReference::new(original, slice_us, segmenter)?.against(decoded, segmenter)
}

/// Segments of a recording, to compare decoded events with.
#[derive(Debug, Clone)]
pub struct SegmentationReference {
    slices: Slices,
    /// In order of the slices' numbers.
    masks: Vec<(u64, Masks)>,
}

impl SegmentationReference {
    /// Segments frames of `slice_us` from the recording's first event on.
    ///
    /// If a slice is one whole window of the codec, [`WINDOW_US`](eecvs_bench::source::WINDOW_US), a frame depends
    /// only on the decoded counts; in shorter slices it also depends on the decoded times.
    ///
    /// # Errors
    /// Fails if `slice_us` is 0, or with the error of the segmenter.
    pub fn new(original: &Source, slice_us: u32, segmenter: &dyn Segmenter) -> Result<Self> {
        ensure!(slice_us > 0, "a slice must be 1 us or longer");
        let slices = Slices::new(original.sensor, &original.events, slice_us);
        let masks = segment(slices, &original.events, segmenter)
            .with_context(|| format!("{}: segments of its events", original.name))?;
        Ok(Self { slices, masks })
    }

    /// Compares the segments with those of `decoded` in the same slices. Events may be in any order; those outside
    /// of the sensor or of the recording's slices are ignored.
    ///
    /// # Errors
    /// Fails with the error of the segmenter, which must be the same as in [`Self::new`].
    pub fn against(&self, decoded: &[Event], segmenter: &dyn Segmenter) -> Result<Segmentation> {
        let decoded =
            segment(self.slices, decoded, segmenter).context("segments of the decoded events")?;
        // Stands for the masks of a slice without events.
        let sensor = self.slices.sensor;
        let none = Masks::new(sensor, &vec![0; sensor.pixels() as usize])?;
        let (mut foreground, mut mean) = (Mean::default(), Mean::default());
        let (mut rest_a, mut rest_b) = (self.masks.iter().peekable(), decoded.iter().peekable());
        loop {
            let order = match (rest_a.peek(), rest_b.peek()) {
                (Some((a, _)), Some((b, _))) => a.cmp(b),
                (Some(_), None) => Ordering::Less,
                (None, Some(_)) => Ordering::Greater,
                (None, None) => break,
            };
            let a = rest_a.next_if(|_| order.is_le()).map_or(&none, |(_, a)| a);
            let b = rest_b.next_if(|_| order.is_ge()).map_or(&none, |(_, b)| b);
            foreground.add(foreground_iou(a, b)?);
            mean.add(mean_iou(a, b)?);
        }
        if is_constant(self.masks.iter().chain(&decoded)) {
            (foreground, mean) = (Mean::default(), Mean::default());
        }
        Ok(Segmentation {
            frames: mean.frames,
            foreground_iou: foreground.get(),
            mean_iou: mean.get(),
        })
    }
}

/// Returns whether the masks of slices at several times are all the same: they do not depend on the events, so that
/// their agreement says nothing.
fn is_constant<'m>(mut all: impl Iterator<Item = &'m (u64, Masks)>) -> bool {
    let Some((first, masks)) = all.next() else {
        return false;
    };
    let mut last = *first;
    let is_same = all.all(|(number, other)| {
        last = last.max(*number);
        other == masks
    });
    is_same && last > *first
}

/// A mean over the frames that have a value.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    frames: usize,
    sum: f64,
}

impl Mean {
    fn add(&mut self, value: Option<f64>) {
        self.frames += usize::from(value.is_some());
        self.sum += value.unwrap_or(0.0);
    }

    fn get(self) -> Option<f64> {
        (self.frames > 0).then(|| self.sum / self.frames as f64)
    }
}

/// Segments every slice that has events.
fn segment(
    slices: Slices,
    events: &[Event],
    segmenter: &dyn Segmenter,
) -> Result<Vec<(u64, Masks)>> {
    let sorted = slices.sorted(events);
    let mut all = Vec::new();
    for batch in slices.cut(&sorted).chunks(BATCH) {
        let frames: Vec<Frame> = batch
            .iter()
            .map(|(_, events)| Frame::new(slices.sensor, events))
            .collect();
        let masks = segmenter.segment_all(&frames)?;
        ensure!(
            masks.len() == frames.len(),
            "the segmenter {} gave {} masks for {} frames",
            segmenter.name(),
            masks.len(),
            frames.len()
        );
        all.extend(batch.iter().map(|(number, _)| *number).zip(masks));
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use eecvs_bench::source::WINDOW_US;
    use event_emulator::Preset;

    use super::*;
    use crate::downstream::segment::classical::Classical;
    use crate::downstream::test_events::{jittered, shuffled};

    fn source() -> Source {
        Source::scene(Preset::Motorcycle, 1, 200_000).unwrap()
    }

    #[test]
    fn the_same_events_in_any_order_give_1() {
        let source = source();
        for slice_us in [WINDOW_US, WINDOW_US / 8] {
            let shuffled = shuffled(&source.events);
            let found = segmentation(&source, &shuffled, slice_us, &Classical).unwrap();
            assert_eq!(
                (found.foreground_iou, found.mean_iou),
                (Some(1.0), Some(1.0))
            );
            // Every window of the scene contains motion.
            assert!(found.frames >= (200_000 / slice_us) as usize, "{found:?}");
        }
    }

    #[test]
    fn the_more_times_move_the_less_segments_agree() {
        let source = source();
        let slice_us = WINDOW_US / 8;
        let reference = SegmentationReference::new(&source, slice_us, &Classical).unwrap();
        let [near, far] = [500, 5_000].map(|jitter_us| {
            let decoded = jittered(&source.events, jitter_us);
            reference.against(&decoded, &Classical).unwrap()
        });
        assert!(
            near.mean_iou < Some(1.0) && near.foreground_iou < Some(1.0),
            "{near:?}"
        );
        assert!(far.mean_iou < near.mean_iou, "{near:?} {far:?}");
        assert!(far.foreground_iou < near.foreground_iou, "{near:?} {far:?}");
    }

    #[test]
    fn nothing_and_strange_events_are_compared() {
        let source = source();
        let none = segmentation(&source, &[], WINDOW_US, &Classical).unwrap();
        assert_eq!((none.foreground_iou, none.mean_iou), (Some(0.0), Some(0.0)));
        let strange: Vec<Event> = source
            .events
            .iter()
            .zip([0, 1, u64::MAX, u64::MAX / 2].into_iter().cycle())
            .flat_map(|(event, t_us)| {
                let x = u16::MAX - event.x;
                [
                    *event,
                    Event { x, ..*event },
                    Event {
                        t_us: t_us | 1 << 40,
                        ..*event
                    },
                ]
            })
            .collect();
        let found = segmentation(&source, &strange, WINDOW_US, &Classical).unwrap();
        assert_eq!(
            (found.foreground_iou, found.mean_iou),
            (Some(1.0), Some(1.0))
        );
    }

    /// Finds the same segments whatever the events.
    struct Constant(fn(usize) -> u32);

    impl Segmenter for Constant {
        fn name(&self) -> &str {
            "constant"
        }

        fn segment(&self, frame: &Frame) -> Result<Masks> {
            let pixels = frame.sensor().pixels() as usize;
            let labels: Vec<u32> = (0..pixels).map(self.0).collect();
            Masks::new(frame.sensor(), &labels)
        }
    }

    #[test]
    fn segments_that_say_nothing_have_no_agreement() {
        let source = source();
        let decoded = jittered(&source.events, 500);
        let nothing = Segmentation {
            frames: 0,
            foreground_iou: None,
            mean_iou: None,
        };
        for of in [|_| 0, |_| 1, |pixel| (pixel / 100 % 3) as u32] {
            let found = segmentation(&source, &decoded, WINDOW_US, &Constant(of)).unwrap();
            assert_eq!(found, nothing);
        }
        // Missing slices are seen all the same, where segments depend on events.
        let found = segmentation(&source, &[], WINDOW_US, &Classical).unwrap();
        assert!(found.frames > 1, "{found:?}");
    }

    /// Returns masks of another size.
    struct Broken;

    impl Segmenter for Broken {
        fn name(&self) -> &str {
            "broken"
        }

        fn segment(&self, _: &Frame) -> Result<Masks> {
            let sensor = eecvs_nostd::Sensor {
                width: 1,
                height: 1,
            };
            Masks::new(sensor, &[1])
        }
    }

    #[test]
    fn errors_are_told() {
        let source = source();
        let error = segmentation(&source, &[], 0, &Classical).unwrap_err();
        assert_eq!(error.to_string(), "a slice must be 1 us or longer");
        assert!(segmentation(&source, &[], WINDOW_US, &Broken).is_err());
    }
}
