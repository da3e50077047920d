//! The comparators: the first time at which a pixel's output is an ON or an OFF threshold away from its reference.

use event_types::Polarity;

use crate::photoreceptor::Response;

/// Times are found to within this, in seconds.
const EXACT_S: f64 = 1e-7;

/// What a pixel compares its output with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Levels {
    /// Output at and above which an ON event is due.
    pub(crate) on: f64,
    /// Output at and below which an OFF event is due.
    pub(crate) off: f64,
}

impl Levels {
    fn crossed(&self, output: f64) -> Option<Polarity> {
        if output >= self.on {
            Some(Polarity::On)
        } else if output <= self.off {
            Some(Polarity::Off)
        } else {
            None
        }
    }
}

/// Returns the first time in `from..=to` at which the response reaches a level, and which one, to within 0.1 us.
///
/// The response is taken to have one turning point at most, which holds for all but a crossing and its return within a
/// fraction of a sample.
pub(crate) fn first_crossing(
    response: &Response,
    levels: Levels,
    from: f64,
    to: f64,
) -> Option<(f64, Polarity)> {
    let begin = Point::of(response, from);
    if let Some(polarity) = levels.crossed(begin.value) {
        return Some((from, polarity));
    }
    let end = Point::of(response, to);
    if begin.slope * end.slope >= 0.0 {
        return crossing(response, levels, begin, end);
    }
    let turn = Point::of(response, turning_point(response, begin.slope, from, to));
    crossing(response, levels, begin, turn).or_else(|| crossing(response, levels, turn, end))
}

/// A response at one time.
#[derive(Debug, Clone, Copy)]
struct Point {
    s: f64,
    value: f64,
    slope: f64,
}

impl Point {
    fn of(response: &Response, s: f64) -> Self {
        let (value, slope) = response.at(s);
        Self { s, value, slope }
    }
}

/// Returns where a response, which has no turning point between two points and is within the levels at the first,
/// reaches a level, if it does.
fn crossing(
    response: &Response,
    levels: Levels,
    begin: Point,
    end: Point,
) -> Option<(f64, Polarity)> {
    let polarity = levels.crossed(end.value)?;
    Some((root(response, levels, polarity, (begin, end)), polarity))
}

/// Returns where a response with slopes of different signs at both ends turns.
fn turning_point(response: &Response, slope_begin: f64, from: f64, to: f64) -> f64 {
    let (mut low, mut high) = (from, to);
    let mut s = 0.5 * (low + high);
    for _ in 0..40 {
        let slope = response.at(s).1;
        if slope * slope_begin > 0.0 {
            low = s;
        } else {
            high = s;
        }
        let next = s - slope / response.bend(s);
        let next = if next > low && next < high {
            next
        } else {
            0.5 * (low + high)
        };
        if (next - s).abs() < EXACT_S {
            return next;
        }
        s = next;
    }
    s
}

/// Returns where a response reaches a level between two points; it is inside at the first and beyond at the second.
/// Newton's steps from the root of a parabola, or halves where they lead outside of what is known.
fn root(
    response: &Response,
    levels: Levels,
    polarity: Polarity,
    (begin, end): (Point, Point),
) -> f64 {
    let level = match polarity {
        Polarity::On => levels.on,
        Polarity::Off => levels.off,
    };
    let (mut low, mut high) = (begin.s, end.s);
    // The parabola with the value and the slope at the first point, and the value at the second.
    let span = high - low;
    let (missing, rise) = (begin.value - level, begin.slope);
    let bend = (end.value - begin.value - rise * span) / (span * span);
    let square = (rise * rise - 4.0 * bend * missing).max(0.0).sqrt();
    let step = -2.0 * missing / (rise + square.copysign(-missing));
    let mut s = if step > 0.0 && step < span {
        low + step
    } else {
        0.5 * (low + high)
    };
    for _ in 0..60 {
        let (value, slope) = response.at(s);
        if levels.crossed(value) == Some(polarity) {
            high = s;
        } else {
            low = s;
        }
        let next = s - (value - level) / slope;
        if next < low || next > high || !next.is_finite() {
            s = 0.5 * (low + high);
            continue;
        }
        // What a step of Newton's leaves is its square times half of bend over slope.
        let step = next - s;
        s = next;
        if step.abs() < EXACT_S || step * step * response.fastest() < EXACT_S {
            break;
        }
    }
    s
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photoreceptor::State;

    fn response(v1: f32, x: f32, x_slope: f64) -> Response {
        let state = State { x, v1, v2: 0.0 };
        Response::new(state, x_slope, (900.0, 2_000.0), 0.0)
    }

    #[test]
    fn crossings_are_those_of_a_fine_search() {
        for (v1, x, x_slope) in [
            (0.0, 1.0, 0.0),
            (0.0, 0.0, 200.0),
            (0.0, 0.0, -90.0),
            // Rises on at first and falls then.
            (0.8, -0.6, 0.0),
            (0.5, 0.0, -150.0),
            (0.3, 0.0, 0.0),
        ] {
            let response = response(v1, x, x_slope);
            let levels = Levels {
                on: 0.2,
                off: -0.25,
            };
            let to = 5e-3;
            let found = first_crossing(&response, levels, 0.0, to);
            let searched = (0..=500_000).map(|i| f64::from(i) * 1e-8).find_map(|s| {
                let polarity = levels.crossed(response.at(s).0)?;
                Some((s, polarity))
            });
            match (found, searched) {
                (Some((s, polarity)), Some((expected, other))) => {
                    assert_eq!(polarity, other, "{v1} {x} {x_slope}");
                    assert!((s - expected).abs() < 3e-7, "{s} {expected}");
                }
                (None, None) => {}
                both => panic!("{v1} {x} {x_slope}: {both:?}"),
            }
        }
    }

    #[test]
    fn a_level_that_is_passed_already_is_crossed_at_once() {
        let levels = Levels {
            on: -0.1,
            off: -1.0,
        };
        let found = first_crossing(&response(0.0, 0.0, 0.0), levels, 1e-3, 2e-3);
        assert_eq!(found, Some((1e-3, Polarity::On)));
    }
}
