//! Each effect of the pixel, measured on a small window and compared with what docs/emulator.md states.
//!
//! If the variable `EECVS_BLESS` is set, the table of docs/emulator.md is written instead of compared:
//! `EECVS_BLESS=1 cargo test -p event-emulator --test effects`.

mod light;
mod measure;
mod table;

use measure::Row;

/// How far a measured value may be from the stated one.
const WITHIN: f64 = 0.05;

#[test]
fn every_effect_is_within_5_percent_of_what_is_stated() {
    let rows = measure::all();
    for row in &rows {
        println!("{row:?}");
    }
    for Row {
        effect,
        at,
        stated,
        measured,
        ..
    } in &rows
    {
        let error = (measured / stated - 1.0).abs();
        assert!(
            error < WITHIN,
            "{effect}, {at}: {measured}, stated {stated}"
        );
    }
    table::check(&rows);
}
