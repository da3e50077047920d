//! Tables of rate against distortion: for a terminal, for README.md, and for METHODOLOGY.md.

use std::fmt::Write as _;
use std::path::Path;

use eecvs_bench::marks::Marks;

use crate::rate::{OWN_WINDOWS_SETTING, Row};

/// Markers of the lines in METHODOLOGY.md between which its tables go.
pub const MARKS: Marks = Marks {
    name: "rate and distortion",
    command: "eecvs bench --rate --save METHODOLOGY.md",
};
/// Markers of the lines in the document between which its table goes.
pub const README_MARKS: Marks = Marks {
    name: "rates",
    command: "eecvs bench --rate --save README.md",
};
/// Columns of the document's table: codec, setting, heading.
const README: [(&str, &str, &str); 11] = [
    ("hybrid-quick", "lossless", "quick"),
    ("hybrid-keys", "lossless", "fast"),
    ("hybrid-dense", "lossless", "dense"),
    ("hybrid-tree-3", "lossless", "dense, effort 3"),
    ("hybrid-dense", "40 us", "dense, 40 us"),
    ("hybrid-dense", "8 bins", "dense, 8 bins"),
    ("zstd-19", "lossless", "zstd -19"),
    ("xz-9", "lossless", "xz -9"),
    ("evt3", "lossless", "EVT 3.0"),
    ("evt2", "lossless", "EVT 2.0"),
    ("aedat4-lz4", "lossless", "AEDAT 4, LZ4"),
];
/// Lossless codecs of the table, with their headings.
pub(super) const LOSSLESS: [(&str, &str); 15] = [
    ("hybrid-tree-3", "dense, effort 3"),
    ("hybrid-tree-2", "dense, effort 2"),
    ("hybrid-tree-1", "dense, effort 1"),
    ("hybrid-dense", "dense"),
    ("hybrid-keys", "fast"),
    ("hybrid-fast", "fast, microcontrollers"),
    ("hybrid-quick", "quick"),
    ("zpaq-5", "zpaq -m5"),
    ("zstd-19", "zstd -19"),
    ("xz-9", "xz -9"),
    ("hdf5-blosc", "HDF5, Blosc-zstd"),
    ("evt3", "EVT 3.0"),
    ("evt2", "EVT 2.0"),
    ("aedat4-zstd", "AEDAT 4, zstd"),
    ("aedat4-lz4", "AEDAT 4, LZ4"),
];
/// Codecs of the table of windows of the recording's own duration, with their headings.
const OWN_WINDOWS: [(&str, &str); 2] = [
    ("hybrid-tree-3", "dense, effort 3"),
    ("hybrid-tree-1", "dense, effort 1"),
];
/// Arrays of the table: codec, setting, name.
const ARRAYS: [(&str, &str, &str); 5] = [
    ("tore", "f32", "TORE, f32"),
    ("tore", "u8", "TORE, u8"),
    ("voxel", "8 bins, f32", "voxels, 8 bins, f32"),
    ("voxel", "8 bins, i16", "the same, i16"),
    ("voxel", "8 bins, i8", "the same, i8"),
];
const TRANSFORMS: [(&str, &str); 3] = [
    ("transform-dct", "DCT"),
    ("transform-dtft", "DTFT"),
    ("transform-dwt", "Haar"),
];

/// Columns of the table of coefficients by coder: transform, M, heading.
const CODERS: [(&str, u8, &str); 6] = [
    ("transform-dct", 8, "DCT, M = 8"),
    ("transform-dct", 16, "DCT, M = 16"),
    ("transform-dtft", 8, "DTFT, M = 8"),
    ("transform-dtft", 16, "DTFT, M = 16"),
    ("transform-dwt", 8, "Haar, M = 8"),
    ("transform-dwt", 16, "Haar, M = 16"),
];

/// A distortion on which both modes are compared.
type Distortion = fn(&Row) -> Option<f64>;

/// Returns the error of times, `emd_pixel_us`.
#[must_use]
pub fn of_times(row: &Row) -> Option<f64> {
    row.emd_pixel_us
}

/// Returns the error of the volume; for coefficients, the better of the two volumes that a decoder can make.
#[must_use]
pub fn of_volume(row: &Row) -> Option<f64> {
    let both = row.volume_nmse.into_iter().chain(row.coefficients_nmse);
    both.reduce(f64::min)
}

/// A setting of mode `transform`, and the cheapest setting of mode `hybrid` with no more distortion.
#[derive(Debug, Clone, Copy)]
struct Duel<'r> {
    coefficients: &'r Row,
    events: &'r Row,
}

impl Duel<'_> {
    /// Returns the ratio of bits; below 1 the coefficients take fewer.
    fn ratio(&self) -> f64 {
        self.coefficients.bits_per_event / self.events.bits_per_event
    }
}

/// Pairs every setting of one transform and coder on a recording with its opponent.
fn duels<'r>(
    rows: &'r [Row],
    recording: &str,
    codec: &str,
    distortion: Distortion,
) -> Vec<Duel<'r>> {
    let here = || rows.iter().filter(|row| row.recording == recording);
    let coefficients = here().filter(|row| row.codec == codec);
    coefficients
        .filter_map(|coefficients| {
            let most = distortion(coefficients)?;
            let events = here()
                .filter(|row| row.codec.starts_with("hybrid") && row.setting != OWN_WINDOWS_SETTING)
                .filter(|row| distortion(row).is_some_and(|found| found <= most))
                .min_by(|a, b| a.bits_per_event.total_cmp(&b.bits_per_event))?;
            Some(Duel {
                coefficients,
                events,
            })
        })
        .collect()
}

/// Returns the bits of coefficients over those of events, for mode `transform` with the coder of that suffix and
/// for both distortions: of every setting, and of the best setting per recording, transform and distortion.
#[must_use]
pub fn ratios(rows: &[Row], suffix: &str) -> (Vec<f64>, Vec<f64>) {
    let (mut all, mut best) = (Vec::new(), Vec::new());
    for recording in recordings(rows) {
        for (codec, _) in TRANSFORMS {
            for distortion in [of_times as Distortion, of_volume] {
                let codec = format!("{codec}{suffix}");
                let duels = duels(rows, recording, &codec, distortion);
                let ratios: Vec<f64> = duels.iter().map(Duel::ratio).collect();
                best.extend(ratios.iter().copied().reduce(f64::min));
                all.extend(ratios);
            }
        }
    }
    (all, best)
}

/// Returns the names of the recordings, in their order.
#[must_use]
pub fn recordings(rows: &[Row]) -> Vec<&str> {
    let mut names: Vec<&str> = rows.iter().map(|row| row.recording.as_str()).collect();
    names.dedup();
    names
}

/// Finds the row of a recording, codec and setting.
fn find<'r>(rows: &'r [Row], recording: &str, codec: &str, setting: &str) -> Option<&'r Row> {
    let is_it = |row: &&Row| {
        (row.recording.as_str(), row.codec, row.setting.as_str()) == (recording, codec, setting)
    };
    rows.iter().find(is_it)
}

/// Formats the text of a document from the rows; `None` if a row is missing.
pub type Table = fn(&[Row]) -> Option<String>;

/// Returns the document's markers, and the table that belongs between them, by the document's name.
#[must_use]
pub fn of(document: &Path) -> (Marks, Table) {
    if document.file_name().is_some_and(|name| name == "README.md") {
        (README_MARKS, readme)
    } else {
        (MARKS, self::document)
    }
}

/// Formats the document's table; `None` if a row is missing.
#[must_use]
pub fn readme(rows: &[Row]) -> Option<String> {
    let recordings = recordings(rows);
    let mut text = String::new();
    heading(&mut text, "recording", README.map(|(.., name)| name));
    for recording in recordings {
        let _ = write!(text, "| {recording} |");
        for (codec, setting, _) in README {
            let row = find(rows, recording, codec, setting)?;
            let _ = write!(text, " {:.1} |", row.bits_per_event);
        }
        text.push('\n');
    }
    Some(text)
}

/// Formats the tables of METHODOLOGY.md; `None` if a row is missing.
#[must_use]
pub fn document(rows: &[Row]) -> Option<String> {
    let recordings = recordings(rows);
    if recordings.is_empty() {
        return None;
    }
    let mut text = String::from("Lossless, bits per event:\n\n");
    heading(&mut text, "recording", LOSSLESS.map(|(_, name)| name));
    for recording in &recordings {
        let _ = write!(text, "| {recording} |");
        for (codec, _) in LOSSLESS {
            let row = find(rows, recording, codec, "lossless")?;
            let _ = write!(text, " {} |", figure(row.bits_per_event));
        }
        text.push('\n');
    }
    text += "\nThe same in windows of the duration that suits the recording, bits per event:\n\n";
    heading(&mut text, "recording", OWN_WINDOWS.map(|(_, name)| name));
    for recording in &recordings {
        let _ = write!(text, "| {recording} |");
        for (codec, _) in OWN_WINDOWS {
            let row = find(rows, recording, codec, OWN_WINDOWS_SETTING)?;
            let _ = write!(text, " {:.2} |", row.bits_per_event);
        }
        text.push('\n');
    }
    text += "\nMillions of events a second on one thread, encoding / decoding:\n\n";
    heading(&mut text, "recording", LOSSLESS.map(|(_, name)| name));
    for recording in &recordings {
        let _ = write!(text, "| {recording} |");
        for (codec, _) in LOSSLESS {
            let row = find(rows, recording, codec, "lossless")?;
            let speed = |seconds: f64| figure(row.events as f64 / seconds / 1e6);
            let _ = write!(
                text,
                " {} / {} |",
                speed(row.seconds),
                speed(row.decode_seconds?)
            );
        }
        text.push('\n');
    }
    text += "\nCoefficients by the dense coder, at their best M, against events that are no worse, bits per \
             event:\n\n";
    let columns = ["transform", "by times", "events", "by volume", "events"];
    heading(&mut text, "recording", columns);
    for recording in &recordings {
        for (codec, name) in TRANSFORMS {
            let codec = format!("{codec}-dense");
            let _ = write!(text, "| {recording} | {name} |");
            for distortion in [of_times as Distortion, of_volume] {
                let duels = duels(rows, recording, &codec, distortion);
                let best = duels
                    .into_iter()
                    .min_by(|a, b| a.ratio().total_cmp(&b.ratio()))?;
                let _ = write!(
                    text,
                    " {}, {} | {}, {} |",
                    figure(best.coefficients.bits_per_event),
                    best.coefficients.setting,
                    figure(best.events.bits_per_event),
                    of_events(best.events)
                );
            }
            text.push('\n');
        }
    }
    for (coder, suffix) in [("the dense coder", "-dense"), ("plain codes", "")] {
        let won = |distortion| {
            let all = recordings.iter().flat_map(|recording| {
                TRANSFORMS.into_iter().flat_map(move |(codec, _)| {
                    let codec = format!("{codec}{suffix}");
                    duels(rows, recording, &codec, distortion)
                })
            });
            all.fold((0, 0), |(won, all), duel| {
                (won + usize::from(duel.ratio() < 1.0), all + 1)
            })
        };
        let ((times, all), (volume, all_volume)) = (won(of_times), won(of_volume));
        let _ = write!(
            text,
            "\nBy {coder}, with a step of 2^-6 and the decoder by peaks, coefficients take fewer bits in {times} of \
             {all} settings by times, and in {volume} of {all_volume} by volume.\n"
        );
    }
    let _ = writeln!(
        text,
        "\nCoefficients by plain codes, by the fast coder and by the dense one, bits \
         per event:\n"
    );
    heading(&mut text, "recording", CODERS.map(|(.., name)| name));
    for recording in &recordings {
        let _ = write!(text, "| {recording} |");
        for (transform, m, _) in CODERS {
            let setting = format!("M = {m}");
            let bits = |coder: &str| -> Option<String> {
                let row = find(rows, recording, &format!("{transform}{coder}"), &setting)?;
                Some(figure(row.bits_per_event))
            };
            let (plain, fast, dense) = (bits("")?, bits("-fast")?, bits("-dense")?);
            let _ = write!(text, " {plain}, {fast}, {dense} |");
        }
        text.push('\n');
    }
    let _ = writeln!(
        text,
        "\nArrays of whole sensors, bits per event and `volume_nmse`:\n"
    );
    heading(&mut text, "recording", ARRAYS.map(|(.., name)| name));
    for recording in &recordings {
        let _ = write!(text, "| {recording} |");
        for (codec, setting, _) in ARRAYS {
            let row = find(rows, recording, codec, setting)?;
            let error = row.volume_nmse.map_or("n/a".to_owned(), small);
            let _ = write!(text, " {}, {error} |", figure(row.bits_per_event));
        }
        text.push('\n');
    }
    Some(text)
}

fn heading<const N: usize>(text: &mut String, first: &str, columns: [&str; N]) {
    let _ = writeln!(text, "| {first} | {} |", columns.join(" | "));
    let _ = writeln!(text, "|{}", "---|".repeat(N + 1));
}

/// Formats coder and fidelity.
fn of_events(row: &Row) -> String {
    let coder = row.codec.trim_start_matches("hybrid-");
    format!("{coder}, {}", row.setting)
}

/// Formats a table for a terminal: the rows of each recording.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let mut text = String::new();
    for recording in recordings(rows) {
        let _ = writeln!(
            text,
            "{recording}\n  {:<16}{:<14}{:>12}{:>14}{:>11}{:>9}{:>12}{:>14}{:>9}",
            "codec",
            "setting",
            "bits/event",
            "emd_pixel, us",
            "mse",
            "ssim",
            "volume nmse",
            "coefficients",
            "s"
        );
        for row in rows.iter().filter(|row| row.recording == recording) {
            let metric = |value: Option<f64>| value.map_or("n/a".to_owned(), small);
            let coefficients = row.coefficients_nmse.map_or(String::new(), small);
            let _ = writeln!(
                text,
                "  {:<16}{:<14}{:>12}{:>14}{:>11}{:>9}{:>12}{coefficients:>14}{:>9.3}",
                row.codec,
                row.setting,
                figure(row.bits_per_event),
                metric(row.emd_pixel_us),
                metric(row.mse),
                row.ssim
                    .map_or("n/a".to_owned(), |ssim| format!("{ssim:.4}")),
                metric(row.volume_nmse),
                row.seconds
            );
        }
        text.push('\n');
    }
    text
}

/// Formats bits, with commas from a thousand on.
pub(super) fn figure(value: f64) -> String {
    match value {
        1000.0.. => {
            let whole = format!("{value:.0}");
            let (head, tail) = whole.split_at(whole.len() - 3);
            match head.len() {
                4.. => format!(
                    "{},{},{tail}",
                    &head[..head.len() - 3],
                    &head[head.len() - 3..]
                ),
                _ => format!("{head},{tail}"),
            }
        }
        100.0.. => format!("{value:.0}"),
        10.0.. => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

/// Formats at most three digits; small values as powers of ten.
fn small(value: f64) -> String {
    match value {
        0.0 => "0".to_owned(),
        100.0.. => format!("{value:.0}"),
        1.0.. => format!("{value:.1}"),
        0.001.. => format!("{value:.3}"),
        _ => format!("{value:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use eecvs_bench::marks::of_project;

    use super::*;

    fn row(recording: &str, codec: &'static str, setting: &str, bits: f64, error: f64) -> Row {
        Row {
            recording: recording.to_owned(),
            codec,
            setting: setting.to_owned(),
            events: 2_000_000,
            bits_per_event: bits,
            emd_pixel_us: Some(error),
            mse: Some(0.0),
            ssim: Some(1.0),
            volume_nmse: Some(error / 1000.0),
            coefficients_nmse: None,
            seconds: 0.1,
            decode_seconds: Some(0.2),
        }
    }

    fn rows() -> Vec<Row> {
        let mut rows = Vec::new();
        for recording in ["a", "b"] {
            for (index, (codec, _)) in LOSSLESS.into_iter().enumerate() {
                rows.push(row(recording, codec, "lossless", 10.0 + index as f64, 0.0));
            }
            for (codec, _) in OWN_WINDOWS {
                rows.push(row(recording, codec, OWN_WINDOWS_SETTING, 9.5, 0.0));
            }
            rows.push(row(recording, "hybrid-dense", "40 us", 7.0, 20.0));
            rows.push(row(recording, "hybrid-dense", "8 bins", 8.0, 900.0));
            rows.push(row(recording, "hybrid-fast", "80 us", 6.0, 40.0));
            for (codec, _) in TRANSFORMS {
                rows.push(row(recording, codec, "M = 2", 14.0, 30.0));
                rows.push(Row {
                    coefficients_nmse: Some(0.045),
                    ..row(recording, codec, "M = 4", 5.0, 400.0)
                });
                let dense = format!("{codec}-dense").leak();
                rows.push(row(recording, dense, "M = 2", 13.0, 30.0));
                rows.push(row(recording, dense, "M = 4", 4.5, 400.0));
            }
            for (transform, m, _) in CODERS {
                for (coder, bits) in [
                    ("transform-dct", 9.0),
                    ("transform-dct-fast", 8.0),
                    ("transform-dct-dense", 7.0),
                ] {
                    let coder = coder.replace("transform-dct", transform);
                    let setting = format!("M = {m}");
                    rows.push(row(recording, coder.leak(), &setting, bits, 1e6));
                }
            }
            for (codec, setting, _) in ARRAYS {
                rows.push(row(recording, codec, setting, 12_345.6, 500.0));
            }
        }
        rows
    }

    #[test]
    fn coefficients_meet_the_cheapest_events_that_are_no_worse() {
        let rows = rows();
        let found = duels(&rows, "a", "transform-dct", of_times);
        let settings = |duel: &Duel<'_>| {
            (
                duel.coefficients.setting.clone(),
                duel.events.setting.clone(),
            )
        };
        let of = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        let found: Vec<_> = found.iter().map(settings).collect();
        let cheapest = |m: &str| of(m, "80 us");
        assert_eq!(
            found,
            [
                of("M = 2", "40 us"),
                cheapest("M = 4"),
                cheapest("M = 8"),
                cheapest("M = 16")
            ]
        );
        assert_eq!(of_volume(&row("a", "x", "y", 1.0, 3.0)), Some(0.003));
        let better = rows.iter().find(|row| row.setting == "M = 4").unwrap();
        assert_eq!(of_volume(better), Some(0.045));
    }

    #[test]
    fn the_document_has_every_table() {
        let text = document(&rows()).unwrap();
        for line in [
            "| a | 10.0 | 11.0 | 12.0 | 13.0 | 14.0 | 15.0 | 16.0 | 17.0 | 18.0 | 19.0 | 20.0 | 21.0 | 22.0 | 23.0 | 24.0 |",
            "| b | 9.50 | 9.50 |",
            &format!("| a |{}", " 20.0 / 10.0 |".repeat(LOSSLESS.len())),
            "| a | DCT | 4.50, M = 4 | 6.00, fast, 80 us | 4.50, M = 4 | 6.00, fast, 80 us |",
            "By plain codes, with a step of 2^-6 and the decoder by peaks, coefficients take fewer bits in 6 of 24 settings by times, and in 6 of 24 by volume.",
            "| b | 9.00, 8.00, 7.00 | 9.00, 8.00, 7.00 | 9.00, 8.00, 7.00 | 9.00, 8.00, 7.00 | 9.00, 8.00, 7.00 | 9.00, 8.00, 7.00 |",
            "| b | 12,346, 0.500 | 12,346, 0.500 | 12,346, 0.500 | 12,346, 0.500 | 12,346, 0.500 |",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}\n{text}");
        }
        let without = |codec: &str| {
            let rows = rows().into_iter();
            rows.filter(|row| row.codec != codec).collect::<Vec<_>>()
        };
        assert_eq!(document(&without("zstd-19")), None);
        assert_eq!(document(&without("transform-dtft")), None);
        assert_eq!(document(&[]), None);
    }

    #[test]
    fn the_documents_have_the_marks_and_these_columns() {
        for document in ["README.md", "METHODOLOGY.md"] {
            let text = of_project(document);
            let (marks, table) = of(Path::new(document));
            let headings = |text: &str| -> Vec<String> {
                let lines = text
                    .lines()
                    .filter(|line| line.starts_with("| recording |"));
                lines.map(str::to_owned).collect()
            };
            let content = marks.content(&text).unwrap();
            assert_eq!(headings(content), headings(&table(&rows()).unwrap()));
        }
        let text = readme(&rows()).unwrap();
        let line =
            "| b | 16.0 | 14.0 | 13.0 | 10.0 | 7.0 | 8.0 | 18.0 | 19.0 | 21.0 | 22.0 | 24.0 |";
        assert!(text.lines().any(|found| found == line), "{text}");
        assert_eq!(readme(&rows()[1..]), None);
    }

    #[test]
    fn figures_have_three_digits() {
        let figures = [9.996, 12.34, 123.4, 999.9, 1234.5, 12_345.0, 1_234_567.0].map(figure);
        let expected = [
            "10.00",
            "12.3",
            "123",
            "1000",
            "1,234",
            "12,345",
            "1,234,567",
        ];
        assert_eq!(figures, expected);
        let smalls = [0.0, 2e-7, 0.0123, 1.26, 1234.5].map(small);
        assert_eq!(smalls, ["0", "2e-7", "0.012", "1.3", "1234"]);
        let text = table(&rows());
        assert!(text.contains("hybrid-dense"), "{text}");
        assert_eq!(
            text.lines()
                .filter(|line| line.contains("emd_pixel"))
                .count(),
            2
        );
    }
}
