//! Finds the Pareto front: the rows that no other row beats in cost and error.

use super::Row;

/// Sets [`Row::pareto`] of every row. A row without an error is never on the front and beats no other.
pub fn mark(rows: &mut [Row]) {
    let is_on: Vec<bool> = rows
        .iter()
        .map(|row| row.max_error.is_some() && !rows.iter().any(|other| is_beaten(row, other)))
        .collect();
    for (row, is_on) in rows.iter_mut().zip(is_on) {
        row.pareto = is_on;
    }
}

/// Returns whether `other` has the same transform, M, target and window, is at least as good in cost and maximum
/// error, and is better in one of them.
fn is_beaten(row: &Row, other: &Row) -> bool {
    let is_same = |a: &Row, b: &Row| {
        (a.transform, a.m, a.target, &a.window) == (b.transform, b.m, b.target, &b.window)
    };
    let (Some(error), Some(others)) = (row.max_error, other.max_error) else {
        return false;
    };
    is_same(row, other)
        && other.cost <= row.cost
        && others <= error
        && (other.cost < row.cost || others < error)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(m: u8, cost: f64, max_error: Option<f64>) -> Row {
        Row {
            kernel: "x",
            transform: "dct",
            m,
            target: "host",
            window: "a".into(),
            cost,
            unit: "ns/event",
            cost_low: cost,
            cost_high: cost,
            max_error,
            rms_error: max_error,
            pareto: false,
            is_crowded: false,
            events: 1,
            coefficients: 1,
        }
    }

    #[test]
    fn what_is_beaten_is_off_the_front() {
        let mut rows = [
            row(8, 1.0, Some(1.0)),
            row(8, 2.0, Some(0.5)),
            row(8, 2.0, Some(0.6)),
            row(8, 3.0, Some(0.5)),
            row(8, 9.0, Some(0.0)),
            row(8, 0.5, None),
            // Two equal rows of another M.
            row(16, 5.0, Some(5.0)),
            row(16, 5.0, Some(5.0)),
        ];
        mark(&mut rows);
        let on: Vec<_> = rows.iter().map(|row| row.pareto).collect();
        assert_eq!(on, [true, true, false, false, true, false, true, true]);
    }
}
