//! Tables of what a largest mean error costs against fixed settings: for a terminal, and for METHODOLOGY.md.

use std::fmt::Write as _;

use eecvs_bench::marks::Marks;

use super::rate_table::figure;
use crate::selection::{Cheapest, Row, TIMES};
use crate::study::claims::median;

/// Markers of the lines in the document between which its table goes.
pub const MARKS: Marks = Marks {
    name: "selection",
    command: "eecvs bench --selection --save METHODOLOGY.md",
};

/// The cheapest setting of a family.
type Of = fn(&Row) -> Option<&Cheapest>;

/// Columns of the document's table: heading, what is compared, and with what.
const COMPARED: [(&str, Of, Of); 8] = [
    (
        "fast, against transforms",
        |row| row.best_keys.as_ref(),
        |row| row.fast.as_ref(),
    ),
    (
        "dense, against transforms",
        |row| row.best_dense.as_ref(),
        |row| row.dense.as_ref(),
    ),
    (
        "effort 3, against transforms",
        |row| row.best_tree.as_ref(),
        |row| row.dense.as_ref(),
    ),
    (
        "fast, against a tolerance",
        |row| row.best_keys.as_ref(),
        |row| row.tolerance_keys.as_ref(),
    ),
    (
        "dense, against a tolerance",
        |row| row.best_dense.as_ref(),
        |row| row.tolerance_dense.as_ref(),
    ),
    (
        "effort 3, against a tolerance",
        |row| row.best_tree.as_ref(),
        |row| row.tolerance_tree.as_ref(),
    ),
    (
        "eq. 3 against transforms, fast or plain",
        |row| row.eq3_fast.as_ref(),
        |row| row.fast.as_ref(),
    ),
    (
        "eq. 3 against transforms, dense",
        |row| row.eq3_dense.as_ref(),
        |row| row.dense.as_ref(),
    ),
];

/// Columns of the terminal's tables.
const FAMILIES: [(&str, Of); 11] = [
    ("transforms, plain", |row| row.plain.as_ref()),
    ("transforms, fast or plain", |row| row.fast.as_ref()),
    ("transforms, dense", |row| row.dense.as_ref()),
    ("eq. 3, fast or plain", |row| row.eq3_fast.as_ref()),
    ("eq. 3, dense", |row| row.eq3_dense.as_ref()),
    ("tolerance, fast", |row| row.tolerance_keys.as_ref()),
    ("tolerance, dense", |row| row.tolerance_dense.as_ref()),
    ("tolerance, effort 3", |row| row.tolerance_tree.as_ref()),
    ("mean error, fast", |row| row.best_keys.as_ref()),
    ("mean error, dense", |row| row.best_dense.as_ref()),
    ("mean error, effort 3", |row| row.best_tree.as_ref()),
];

/// Formats the document's table, one line per error asked for; `None` if nothing was measured.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let asked = asked(rows);
    let mut text = format!(
        "Bits saved on {} inputs at no more error, per cent: median, least, and on how many of the inputs that have \
         such settings more bits are taken:\n\n",
        asked.first()?.len()
    );
    let _ = writeln!(
        text,
        "| error of | at most | {} |\n|{}",
        COMPARED.map(|(heading, ..)| heading).join(" | "),
        "---|".repeat(COMPARED.len() + 2)
    );
    for rows in asked {
        let _ = write!(text, "| {} |", of(rows.first()?));
        for (_, ours, theirs) in COMPARED {
            let _ = write!(text, " {} |", saved(&rows, ours, theirs));
        }
        text.push('\n');
    }
    Some(text)
}

/// Formats the tables for a terminal: the cheapest settings of every input, per error asked for.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut text = String::new();
    for rows in asked(rows) {
        let Some(first) = rows.first() else {
            continue;
        };
        let _ = writeln!(
            text,
            "error of | at most\n{}\nbits per event, setting (error)\n\n| input | events | {} |\n|{}",
            of(first),
            FAMILIES.map(|(heading, _)| heading).join(" | "),
            "---|".repeat(FAMILIES.len() + 2)
        );
        for row in rows {
            let _ = write!(text, "| {} | {} |", row.input, row.events);
            for (_, family) in FAMILIES {
                let cell = family(row).map_or("none".to_owned(), |found| {
                    format!(
                        "{}, {} ({})",
                        figure(found.bits_per_event),
                        found.setting,
                        error(row.error, found.error)
                    )
                });
                let _ = write!(text, " {cell} |");
            }
            text.push('\n');
        }
        text.push('\n');
    }
    text + &document(rows).unwrap_or_default()
}

/// Groups the rows by the error that was asked for, in their order.
fn asked(rows: &[Row]) -> Vec<Vec<&Row>> {
    let mut groups: Vec<Vec<&Row>> = Vec::new();
    for row in rows {
        let is_same = |group: &&mut Vec<&Row>| {
            group
                .first()
                .is_some_and(|first| (first.error, first.most) == (row.error, row.most))
        };
        match groups.iter_mut().find(is_same) {
            Some(group) => group.push(row),
            None => groups.push(vec![row]),
        }
    }
    groups
}

/// Formats the kind of error and its limit, as two cells.
fn of(row: &Row) -> String {
    let kind = if row.error == TIMES {
        "times"
    } else {
        "the volume V4"
    };
    format!("{kind} | {}", error(row.error, row.most))
}

fn error(kind: &str, error: f64) -> String {
    if kind == TIMES {
        format!("{error:.0} us")
    } else {
        // At most three digits.
        format!("{}", (error * 1000.0).round() / 1000.0)
    }
}

/// Formats 100 (1 - ours / theirs) over the inputs that have both.
fn saved(rows: &[&Row], ours: Of, theirs: Of) -> String {
    let ratio = |row: &&Row| {
        let (ours, theirs) = (ours(row)?, theirs(row)?);
        Some(100.0 * (1.0 - ours.bits_per_event / theirs.bits_per_event))
    };
    summary(&rows.iter().filter_map(ratio).collect::<Vec<f64>>())
}

/// Formats the median and the least of what is saved on some inputs, per cent, and on how many of them more is taken.
pub(super) fn summary(saved: &[f64]) -> String {
    let least = saved.iter().copied().min_by(f64::total_cmp);
    let (Some(least), Some(median)) = (least, median(saved.to_vec())) else {
        return "none".to_owned();
    };
    let more = saved.iter().filter(|saved| **saved < 0.0).count();
    format!(
        "{}, {}, {more} of {}",
        percent(median),
        percent(least),
        saved.len()
    )
}

/// Formats a percentage with one digit; adding 0 turns -0 into 0.
fn percent(value: f64) -> String {
    format!("{:.1}", (value * 10.0).round() / 10.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selection::VOLUME;

    fn cheapest(bits: f64) -> Option<Cheapest> {
        Some(Cheapest {
            setting: "DCT, M = 3, step 2^-2".to_owned(),
            bits_per_event: bits,
            error: 0.25,
        })
    }

    fn row(input: &str, error: &'static str, most: f64, best: f64) -> Row {
        Row {
            input: input.to_owned(),
            events: 12_345,
            error,
            most,
            plain: None,
            fast: cheapest(10.0),
            dense: cheapest(8.0),
            eq3_fast: cheapest(20.0),
            eq3_dense: None,
            tolerance_keys: cheapest(4.0),
            tolerance_dense: cheapest(4.0),
            tolerance_tree: cheapest(3.0),
            best_keys: cheapest(best),
            best_dense: cheapest(best),
            best_tree: cheapest(best / 2.0),
        }
    }

    #[test]
    fn the_table_is_of_every_error_asked_for() {
        let rows = [
            row("a", TIMES, 32.0, 5.0),
            row("a", VOLUME, 0.5, 4.0),
            row("b", TIMES, 32.0, 3.0),
            row("b", VOLUME, 0.5, 2.0),
        ];
        let text = document(&rows).unwrap();
        for line in [
            "| times | 32 us | 60.0, 50.0, 0 of 2 | 50.0, 37.5, 0 of 2 | 75.0, 68.8, 0 of 2 | \
             0.0, -25.0, 1 of 2 | 0.0, -25.0, 1 of 2 | 33.3, 16.7, 0 of 2 | \
             -100.0, -100.0, 2 of 2 | none |",
            "| the volume V4 | 0.5 | 70.0, 60.0, 0 of 2 | 62.5, 50.0, 0 of 2 | 81.3, 75.0, 0 of 2 | \
             25.0, 0.0, 0 of 2 | 25.0, 0.0, 0 of 2 | 50.0, 33.3, 0 of 2 | \
             -100.0, -100.0, 2 of 2 | none |",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}\n{text}");
        }
        assert!(text.starts_with("Bits saved on 2 inputs"), "{text}");
        let whole = table(&rows);
        assert!(whole.ends_with(&text), "{whole}");
        let cell = "| b | 12345 | none | 10.0, DCT, M = 3, step 2^-2 (0.25) |";
        assert!(whole.contains(cell), "{whole}");
        assert_eq!(document(&[]), None);
    }
}
