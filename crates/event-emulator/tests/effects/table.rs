//! The tables of docs/emulator.md that are made by the tests: the parameters, and measured against stated.

use std::fmt::Write;
use std::path::PathBuf;

use event_emulator::{
    CAMERAS, Effect, PARAMETERS, Parameter, PixelParameters, READOUT_PARAMETERS, ReadoutParameters,
};

use crate::measure::Row;

const COMMAND: &str = "EECVS_BLESS=1 cargo test -p event-emulator --test effects";

/// Compares the document with its tables, or writes them if `EECVS_BLESS` is set.
pub fn check(rows: &[Row]) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/emulator.md");
    let text = std::fs::read_to_string(&path).expect("docs/emulator.md");
    let text = text.replace("\r\n", "\n");
    for effect in Effect::ALL {
        let flag = format!("`--no-{}`", effect.name());
        assert!(text.contains(&flag), "docs/emulator.md lacks {flag}");
    }
    let mut expected = text.clone();
    let pixel = parameters(PARAMETERS, &PixelParameters::default());
    let readout = parameters(READOUT_PARAMETERS, &ReadoutParameters::default());
    for (name, table) in [
        ("parameters", pixel),
        ("effects", effects(rows)),
        ("readout", readout),
        ("cameras", cameras()),
    ] {
        expected = replace(&expected, name, &table);
    }
    if std::env::var_os("EECVS_BLESS").is_some() {
        std::fs::write(&path, expected).expect("docs/emulator.md is written");
    } else {
        assert_eq!(
            text, expected,
            "{COMMAND} writes the tables of docs/emulator.md"
        );
    }
}

/// Replaces the lines between the two marks of a table.
fn replace(text: &str, name: &str, table: &str) -> String {
    let begin = format!("<!-- {name}: {COMMAND} writes what is below -->\n");
    let end = format!("<!-- {name} end -->");
    let (before, rest) = text.split_once(&begin).expect("the first mark");
    let (_, after) = rest.split_once(&end).expect("the second mark");
    [before, &begin, table, &end, after].concat()
}

fn parameters<P>(parameters: &[Parameter<P>], defaults: &P) -> String {
    let mut table = "| parameter | unit | range | default | what it is | source |\n\
                     |---|---|---|---|---|---|\n"
        .to_owned();
    for parameter in parameters {
        let (least, most) = (parameter.least, parameter.most);
        let line = writeln!(
            table,
            "| `{}` | {} | {least} to {most} | {} | {} | {} |",
            parameter.name,
            parameter.unit,
            parameter.of(defaults),
            parameter.about,
            parameter.source
        );
        line.expect("a string");
    }
    table
}

fn cameras() -> String {
    let mut table = "| `--camera` | size |".to_owned();
    for parameter in READOUT_PARAMETERS {
        write!(table, " `{}` |", parameter.name).expect("a string");
    }
    table.push_str(" source |\n|---|---|");
    table.push_str(&"---|".repeat(READOUT_PARAMETERS.len() + 1));
    table.push('\n');
    for camera in CAMERAS {
        let (width, height) = (camera.sensor.width, camera.sensor.height);
        write!(table, "| `{}` | {width} x {height} |", camera.name).expect("a string");
        for parameter in READOUT_PARAMETERS {
            write!(table, " {} |", parameter.of(&camera.readout)).expect("a string");
        }
        writeln!(table, " {} |", camera.source).expect("a string");
    }
    table
}

fn effects(rows: &[Row]) -> String {
    let mut table =
        "| effect | at | stated | measured | difference |\n|---|---|---|---|---|\n".to_owned();
    for row in rows {
        let unit = match row.unit {
            "1" => "",
            "ln" => " ln",
            "us" => " us",
            "Hz" => " Hz",
            unit => unreachable!("{unit}"),
        };
        let line = writeln!(
            table,
            "| {} | {} | {}{unit} | {}{unit} | {:+.1} % |",
            row.effect,
            row.at,
            digits(row.stated),
            digits(row.measured),
            100.0 * (row.measured / row.stated - 1.0)
        );
        line.expect("a string");
    }
    table
}

/// Writes three digits, and more before the point where there are.
fn digits(value: f64) -> String {
    let before = value.abs().log10().floor() as i32;
    let after = usize::try_from(2 - before).unwrap_or(0);
    format!("{value:.after$}")
}
