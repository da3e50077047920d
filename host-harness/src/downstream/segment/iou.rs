//! Agreement of two segmentations: intersection over union.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use anyhow::Result;

use super::masks::{Masks, segment};

/// Returns the pixels in segments of both over the pixels in segments of either; `None` if both masks are empty or
/// both are full, which says nothing of either.
///
/// The labels of the segments do not matter.
///
/// # Errors
/// Fails if the masks differ in size.
pub fn foreground_iou(a: &Masks, b: &Masks) -> Result<Option<f64>> {
    let (mut both, mut either) = (0_u64, 0_u64);
    a.overlaps(b, |pixels, a, b| {
        both += u64::from(pixels) * u64::from(a != 0 && b != 0);
        either += u64::from(pixels) * u64::from(a != 0 || b != 0);
    })?;
    let says_nothing = either == 0 || both == u64::from(a.sensor().pixels());
    Ok((!says_nothing).then(|| both as f64 / either as f64))
}

/// Returns the mean IoU over matched pairs of segments and unmatched segments of either side.
///
/// The match is one to one and greedy: of all pairs of overlapping segments of `a` and `b`, the pair with the
/// greatest IoU is matched first (of equals, the one with the lowest labels), then the next among segments that are
/// still free. An unmatched segment counts as 0: sum of the pairs' IoU / (pairs + unmatched in `a` + unmatched in
/// `b`). The result is `None` if neither has a segment, or if both are one segment that fills the frame.
///
/// # Errors
/// Fails if the masks differ in size.
pub fn mean_iou(a: &Masks, b: &Masks) -> Result<Option<f64>> {
    let mut shared: BTreeMap<(usize, usize), u64> = BTreeMap::new();
    a.overlaps(b, |pixels, a, b| {
        if let Some(pair) = segment(a).zip(segment(b)) {
            *shared.entry(pair).or_default() += u64::from(pixels);
        }
    })?;
    let mut pairs: Vec<Pair> = shared
        .into_iter()
        .filter_map(|((in_a, in_b), both)| {
            let sum = a.areas().get(in_a)? + b.areas().get(in_b)?;
            let either = sum - both;
            Some(Pair {
                in_a,
                in_b,
                both,
                either,
            })
        })
        .collect();
    // The sort is stable: pairs of equal IoU stay in the order of their labels.
    pairs.sort_by(|p, q| Reverse(p.both * q.either).cmp(&Reverse(q.both * p.either)));
    let (mut free_a, mut free_b) = (vec![true; a.segments()], vec![true; b.segments()]);
    let (mut sum, mut matched) = (0.0, 0_usize);
    for pair in pairs {
        let (Some(is_free_a), Some(is_free_b)) =
            (free_a.get_mut(pair.in_a), free_b.get_mut(pair.in_b))
        else {
            continue;
        };
        if *is_free_a && *is_free_b {
            (*is_free_a, *is_free_b) = (false, false);
            sum += pair.both as f64 / pair.either as f64;
            matched += 1;
        }
    }
    let counted = a.segments() + b.segments() - matched;
    let is_full = |masks: &Masks| masks.areas() == [u64::from(masks.sensor().pixels())];
    let says_nothing = counted == 0 || is_full(a) && is_full(b);
    Ok((!says_nothing).then(|| sum / counted as f64))
}

/// Two overlapping segments: IoU = both / either, each at most 2^22 pixels.
struct Pair {
    in_a: usize,
    in_b: usize,
    both: u64,
    either: u64,
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Sensor;

    use super::*;

    fn masks(rows: &[&str]) -> Masks {
        let labels: Vec<u32> = rows
            .iter()
            .flat_map(|row| row.chars().map(|label| label.to_digit(10).unwrap()))
            .collect();
        let sensor = Sensor::new(rows[0].len() as u16, rows.len() as u16).unwrap();
        Masks::new(sensor, &labels).unwrap()
    }

    #[test]
    fn both_are_one_for_equal_masks_and_absent_for_two_that_say_nothing() {
        let (some, none) = (masks(&["1102", "0033"]), masks(&["0000", "0000"]));
        let full = masks(&["1111", "1111"]);
        for iou in [foreground_iou, mean_iou] {
            assert_eq!(iou(&some, &some).unwrap(), Some(1.0));
            assert_eq!(iou(&none, &none).unwrap(), None);
            assert_eq!(iou(&full, &full).unwrap(), None);
            for (a, b) in [
                (&some, &none),
                (&none, &some),
                (&full, &none),
                (&none, &full),
            ] {
                assert_eq!(iou(a, b).unwrap(), Some(0.0));
            }
            assert!(iou(&some, &full).unwrap() < Some(1.0));
        }
        // Two segments that fill the frame have edges between them, and the foreground has none.
        let halves = masks(&["1122", "1122"]);
        assert_eq!(mean_iou(&halves, &halves).unwrap(), Some(1.0));
        assert_eq!(mean_iou(&halves, &full).unwrap(), Some(0.25));
        assert_eq!(foreground_iou(&halves, &full).unwrap(), None);
    }

    #[test]
    fn labels_do_not_matter() {
        let (a, b) = (masks(&["1102", "0033"]), masks(&["3301", "0022"]));
        assert_eq!(foreground_iou(&a, &b).unwrap(), Some(1.0));
        assert_eq!(mean_iou(&a, &b).unwrap(), Some(1.0));
    }

    #[test]
    fn pixels_of_either_are_divided_by() {
        let (a, b) = (masks(&["11110000"]), masks(&["00111100"]));
        assert_eq!(foreground_iou(&a, &b).unwrap(), Some(2.0 / 6.0));
        assert_eq!(mean_iou(&a, &b).unwrap(), Some(2.0 / 6.0));
    }

    #[test]
    fn the_greatest_pair_is_matched_first() {
        // Segment 1 of A overlaps 1 of B (3 of 7 pixels) and 2 of B (2 of 5); 2 of A overlaps 1 of B (2 of 5).
        let a = masks(&["1111122"]);
        let b = masks(&["2211111"]);
        // The pair (1, 1) is matched; 2 of A and 2 of B are left over.
        assert_eq!(mean_iou(&a, &b).unwrap(), Some((3.0 / 7.0) / 3.0));
        // The foreground of both is the whole frame.
        assert_eq!(foreground_iou(&a, &b).unwrap(), None);
    }

    #[test]
    fn a_segment_in_two_halves_counts_once() {
        let (a, b) = (masks(&["111111"]), masks(&["111022"]));
        assert_eq!(mean_iou(&a, &b).unwrap(), Some((3.0 / 6.0) / 2.0));
        assert_eq!(mean_iou(&b, &a).unwrap(), Some((3.0 / 6.0) / 2.0));
    }
}
