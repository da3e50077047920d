//! Events that both recordings hold with identical t (to the microsecond), x, y and polarity.

use event_types::Event;

use super::frame::pixel_order;

/// Returns the number of events of `a` that occur in `b` with the same t, x, y and p.
///
/// Events are matched as a multiset: an event that occurs twice in A and once in B counts once. Both windows must be
/// in [`pixel_order`]. `exact_fraction` is this value summed over the windows, divided by the events of A.
#[must_use]
pub fn matched(a: &[Event], b: &[Event]) -> u64 {
    let (mut a, mut b) = (a.iter().peekable(), b.iter().peekable());
    let mut found = 0;
    while let (Some(in_a), Some(in_b)) = (a.peek(), b.peek()) {
        let (key_a, key_b) = (pixel_order(in_a), pixel_order(in_b));
        if key_a <= key_b {
            a.next();
        }
        if key_b <= key_a {
            b.next();
        }
        found += u64::from(key_a == key_b);
    }
    found
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    #[test]
    fn duplicates_count_as_often_as_both_hold_them() {
        let e = event(5, 1, 1, true);
        let other = event(5, 1, 1, false);
        assert_eq!(matched(&[other, e, e, e], &[e, e]), 2);
        assert_eq!(matched(&[e, e], &[other, e, e, e]), 2);
        assert_eq!(matched(&[e], &[other]), 0);
        assert_eq!(matched(&[e], &[event(6, 1, 1, true)]), 0);
        assert_eq!(matched(&[], &[e]), 0);
    }
}
