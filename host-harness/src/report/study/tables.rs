//! Tables I to V of the paper, from a study's rows, with the paper's own figures if this project has them.

use eecvs_nostd::Transform;

use super::colours::{REPRESENTATIONS, label};
use super::table::{NONE, Table};
use crate::recordings;
use crate::study::claims::{family, figure, median};
use crate::study::effort::{M, MEAN_ERROR_US};
use crate::study::equal_errors::{ASKED, COMPARED};
use crate::study::perception::Perception;
use crate::study::quality::Quality;
use crate::study::set::{RECORDINGS, SCENES};
use crate::study::speed::{EQUAL_US, HOST, HOST_EQUAL};
use crate::study::{Results, paper};

/// Methods in the columns of Table I.
const TABLE_ONE: [&str; 10] = [
    "dct",
    "dtft",
    "dwt",
    "auto",
    "hybrid-fast",
    "hybrid-dense",
    "best",
    "ces",
    "tore",
    "voxel",
];

/// Returns the heading of a method's column.
fn heading(method: &str) -> String {
    match method {
        "hybrid-fast" => "hybrid (default)".to_owned(),
        "hybrid-dense" => "hybrid, dense".to_owned(),
        "best" => format!("best, {MEAN_ERROR_US} us"),
        other => label(other).to_owned(),
    }
}

/// A metric: title, description, which values are better, and how to read it from a row.
type Metric = (&'static str, &'static str, Better, fn(&Quality) -> f64);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Better {
    Less,
    More,
    /// Bits mean nothing without the errors at the same setting.
    Neither,
}

const METRICS: [Metric; 6] = [
    (
        "emd_pixel, us",
        "Mean distance of an event from its own time",
        Better::Less,
        |row| row.emd_pixel_us,
    ),
    (
        "emd_time, ms",
        "Distance of the times of a window's events, positions ignored",
        Better::Less,
        |row| row.emd_time_ms,
    ),
    (
        "mse",
        "Of signed frames of whole windows",
        Better::Less,
        |row| row.mse,
    ),
    (
        "ssim",
        "Of signed frames of whole windows",
        Better::More,
        |row| row.ssim,
    ),
    (
        "bits per event",
        "As sent: frames, or dense arrays of f32",
        Better::Neither,
        |row| row.bits_per_event,
    ),
    (
        "bits per event, packed",
        "With the best packing of each: the dense coder, or xz of the active pixels' numbers",
        Better::Neither,
        |row| row.packed_bits_per_event,
    ),
];

/// Makes Table I, one table per set and metric.
#[must_use]
pub fn table_one(results: &Results) -> Vec<Table> {
    let mut tables = Vec::new();
    for set in results.sets() {
        for (name, what, better, metric) in METRICS {
            let mut head = vec![set.trim_end_matches('s').to_owned()];
            head.extend(TABLE_ONE.map(heading));
            let mut table = Table {
                title: format!("Table I, {set}: {name}"),
                caption: format!(
                    "{what}; M = {M}; best: the coarsest times within a mean error of {MEAN_ERROR_US} us, by \
                     the dense coder. {}",
                    match better {
                        Better::Less => "Bold: the least of the three transforms, CES and TORE.",
                        Better::More => "Bold: the most of the three transforms, CES and TORE.",
                        Better::Neither => "",
                    }
                ),
                head,
                rows: Vec::new(),
            };
            let mut columns: Vec<Vec<f64>> = vec![Vec::new(); TABLE_ONE.len()];
            for source in results.sources(set) {
                let of = |method: &str| results.row(set, source, method, M).map(metric);
                let compared = ["dct", "dtft", "dwt", "ces", "tore"]
                    .into_iter()
                    .filter_map(of);
                let best = match better {
                    Better::Less => compared.min_by(f64::total_cmp),
                    Better::More => compared.max_by(f64::total_cmp),
                    Better::Neither => None,
                };
                let mut row = vec![source.to_owned()];
                for (method, column) in TABLE_ONE.iter().zip(&mut columns) {
                    let value = of(method);
                    column.extend(value);
                    let is_compared =
                        !["auto", "hybrid-fast", "hybrid-dense", "best", "voxel"].contains(method);
                    row.push(cell(
                        value,
                        name,
                        is_compared && value.is_some() && value == best,
                    ));
                }
                table.rows.push(row);
            }
            let mut row = vec!["median".to_owned()];
            row.extend(
                columns
                    .into_iter()
                    .map(|column| cell(median(column), name, false)),
            );
            table.rows.push(row);
            tables.push(table);
        }
    }
    tables
}

fn cell(value: Option<f64>, metric: &str, is_best: bool) -> String {
    let Some(value) = value else {
        return "n/a".to_owned();
    };
    let text = match metric {
        "ssim" => format!("{value:.4}"),
        _ => figure(value),
    };
    if is_best { format!("**{text}**") } else { text }
}

/// Makes Table I at equal errors: one table per set.
#[must_use]
pub fn equal_errors(results: &Results) -> Vec<Table> {
    let table = |set: &'static str| {
        let of = results.sources(set).len();
        let mut head = vec!["error of at most"];
        head.extend(COMPARED.map(label));
        let mut table = Table::new(
            &format!("Table I, {set}: bits per event, packed, at equal errors"),
            &format!(
                "The fewest bits of all settings of a representation that are within the error: every M \
                 and step measured, tolerances and bins of events, mean errors of best. Medians over \
                 the sources that have such a setting, in brackets their number if it is not {of}. The \
                 error of the volume is that of signed impulses smoothed in time by a Gaussian of 4 ms. Bold: \
                 the fewest of those that have a setting for every source."
            ),
            &head,
        );
        for asked in ASKED {
            let found = COMPARED.map(|name| results.fewest_bits_median(set, name, asked));
            let of_all = found.iter().filter(|(_, count)| *count == of);
            let fewest = of_all.filter_map(|(bits, _)| *bits).min_by(f64::total_cmp);
            let mut row = vec![asked.name()];
            row.extend(found.map(|(bits, count)| match bits {
                None => NONE.to_owned(),
                Some(bits) if count < of => format!("{} ({count})", figure(bits)),
                bits => cell(bits, "", bits == fewest),
            }));
            table.rows.push(row);
        }
        table
    };
    results.sets().into_iter().map(table).collect()
}

/// Makes the table of event frames and time surfaces, which is not in the paper.
#[must_use]
pub fn other_arrays(results: &Results) -> Table {
    let mut table = Table::new(
        "Event frames and time surfaces",
        "Medians over each set; two channels of f32. An event frame holds no times: its events are \
         spread evenly over the window.",
        &[
            "set",
            "array",
            "emd_pixel, us",
            "emd_time, ms",
            "mse",
            "ssim",
            "bits per event",
            "packed",
        ],
    );
    for set in results.sets() {
        for method in ["event-frame", "time-surface"] {
            let of = |metric: fn(&Quality) -> f64| {
                let sources = results.sources(set).into_iter();
                let rows = sources.filter_map(|source| results.row(set, source, method, M));
                median(rows.map(metric).collect())
            };
            table.rows.push(vec![
                set.to_owned(),
                label(method).to_owned(),
                cell(of(|row| row.emd_pixel_us), "", false),
                cell(of(|row| row.emd_time_ms), "", false),
                cell(of(|row| row.mse), "", false),
                cell(of(|row| row.ssim), "ssim", false),
                cell(of(|row| row.bits_per_event), "", false),
                cell(of(|row| row.packed_bits_per_event), "", false),
            ]);
        }
    }
    table
}

/// Makes Table II: medians over each set at every M.
#[must_use]
pub fn table_two(results: &Results) -> Table {
    let mut table = Table::new(
        "Table II: over M",
        "Medians over each set. Solved: event times by the codec's decoder; peaks: by the peaks of \
         the summed atoms, which is closer to the paper's decoder.",
        &[
            "set, M",
            "representation",
            "emd_pixel, us",
            "by peaks",
            "emd_time, ms",
            "by peaks",
            "bits per event",
            "packed",
        ],
    );
    let mut m_all: Vec<u8> = results.quality.iter().map(|row| row.m).collect();
    m_all.sort_unstable();
    m_all.dedup();
    for set in results.sets() {
        for m in m_all.iter().filter(|m| **m >= 8) {
            for method in ["dct", "dtft", "dwt", "auto", "ces", "tore", "voxel"] {
                let of = |setting: &[&str], metric: fn(&Quality) -> f64| {
                    let rows = results.quality.iter().filter(|row| {
                        row.set == set
                            && row.method == method
                            && row.m == *m
                            && setting.contains(&row.setting.as_str())
                    });
                    cell(median(rows.map(metric).collect()), "", false)
                };
                let solved = ["exact", "f32"];
                table.rows.push(vec![
                    format!("{set}, {m}"),
                    label(method).to_owned(),
                    of(&solved, |row| row.emd_pixel_us),
                    of(&["peaks"], |row| row.emd_pixel_us),
                    of(&solved, |row| row.emd_time_ms),
                    of(&["peaks"], |row| row.emd_time_ms),
                    of(&solved, |row| row.bits_per_event),
                    of(&solved, |row| row.packed_bits_per_event),
                ]);
            }
        }
    }
    table
}

/// Makes Table III, with the paper's figures.
#[must_use]
pub fn table_three(results: &Results) -> Table {
    let mut table = Table::new(
        "Table III: speed",
        &format!(
            "Windows of 3,200 events, M = 8, from events to frames. At equal errors each transform has the \
             setting of fewest bits within them, whatever its M, and best is a mean error of {EQUAL_US} us. \
             Relative: to the slowest of the three transforms. The host is one thread of the machine named at \
             the foot, median of the runs; the microcontroller's figures are counted instructions, at 168 \
             million of them per second. The paper's figures are from a desktop computer; its relative \
             efficiency is computed from its events per second."
        ),
        &[
            "target",
            "method",
            "us per window",
            "kev/s",
            "relative",
            "instructions per event",
            "bits per event",
            "emd_pixel, us",
            "paper, kev/s",
            "paper, relative",
        ],
    );
    for row in &results.speed {
        let paper = Transform::ALL
            .into_iter()
            .find(|transform| transform.name() == row.method)
            .map(paper::kev_per_s);
        let slowest = Transform::ALL
            .map(paper::kev_per_s)
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        let paper_time = if row.target == HOST { paper } else { None };
        let or_none = |value: Option<f64>| value.map_or("n/a".to_owned(), figure);
        table.rows.push(vec![
            row.target.clone(),
            match row.method.strip_suffix("-few") {
                Some(transform) => format!("{}, few events as times", label(transform)),
                None if row.method == "best-fast" => "best, fast".to_owned(),
                None if row.method == "best" => "best, dense".to_owned(),
                None if row.target == HOST_EQUAL => {
                    format!("{}, M = {}", label(&row.method), row.m)
                }
                None => heading(&row.method),
            },
            figure(row.us_per_window),
            figure(row.kev_per_s),
            figure(row.relative),
            or_none(row.instructions_per_event),
            or_none(row.bits_per_event),
            or_none(row.emd_pixel_us),
            or_none(paper_time),
            or_none(
                paper
                    .filter(|_| row.target == HOST)
                    .map(|kev| kev / slowest),
            ),
        ]);
    }
    table
}

/// Makes Tables IV (M = 16) and V (M = 24) for each set.
#[must_use]
pub fn tables_four_and_five(results: &Results) -> Vec<Table> {
    let mut tables = Vec::new();
    for (number, m) in [("IV", 16), ("V", 24)] {
        let mut table = Table::new(
            &format!("Table {number}: segmentation and optical flow, M = {m}"),
            &format!(
                "Means over each set's sources: IoU of the segments of original and decoded events (mean \
                 IoU of matched segments, and of the foreground) on frames of whole windows and of a \
                 tenth of a window, whose contents depend on times; and difference of optical flow. \
                 Segmenter: {}. A dash: its masks are all empty, all full or all the same. {}",
                results.record.segmenter,
                if m == 24 {
                    "The paper: mean IoU 0.87 by its codec and 0.44 by voxel grids, on MVSEC with EventSAM."
                } else {
                    "The paper's own figures are for EHPT-XC and MVSEC, segmented with EventSAM."
                }
            ),
            &[
                "set",
                "representation",
                "windows: IoU",
                "foreground",
                "tenths: IoU",
                "foreground",
                "flow, px per window",
                "tiles lost, %",
            ],
        );
        for set in results.sets() {
            let mut shown: Vec<(&str, &str)> = Vec::new();
            for row in results
                .perception
                .iter()
                .filter(|row| row.set == set && (row.m == m || row.m == 0 || row.m == 2))
            {
                if !shown.contains(&(row.method.as_str(), row.setting.as_str())) {
                    shown.push((&row.method, &row.setting));
                }
            }
            shown.sort_by_key(|(method, setting)| order(method, setting));
            for (method, setting) in shown {
                let rows = || {
                    results.perception.iter().filter(|row| {
                        row.set == set
                            && row.method == method
                            && row.setting == setting
                            && (row.m == m || row.m == 0 || row.m == 2)
                    })
                };
                table.rows.push(vec![
                    set.to_owned(),
                    if method.starts_with("hybrid") {
                        format!("events, {setting}")
                    } else {
                        label(method).to_owned()
                    },
                    iou(rows().map(|row| row.mean_iou()[0])),
                    iou(rows().map(|row| row.foreground_iou()[0])),
                    iou(rows().map(|row| row.mean_iou()[1])),
                    iou(rows().map(|row| row.foreground_iou()[1])),
                    mean(rows().filter_map(|row| row.flow_mean_px))
                        .map_or("n/a".to_owned(), figure),
                    lost(rows()),
                ]);
            }
        }
        tables.push(table);
    }
    tables
}

/// Returns the sort key of a row: representations as in the charts, tolerances before bins, each by its number.
fn order(method: &str, setting: &str) -> (usize, bool, u32) {
    let representation = family(method);
    let place = REPRESENTATIONS
        .iter()
        .position(|(name, ..)| *name == representation);
    let number = setting.split(' ').next().and_then(|word| word.parse().ok());
    (
        place.unwrap_or(REPRESENTATIONS.len()),
        setting.ends_with("bins"),
        number.unwrap_or(0),
    )
}

/// Formats the mean over the sources that have an IoU, with their number if it is not that of all; a dash if no source
/// has one.
fn iou(sources: impl Iterator<Item = Option<f64>>) -> String {
    let all: Vec<Option<f64>> = sources.collect();
    let known: Vec<f64> = all.iter().copied().flatten().collect();
    let (count, of) = (known.len(), all.len());
    match mean(known.into_iter()) {
        None => NONE.to_owned(),
        Some(mean) if count == of => format!("{mean:.3}"),
        Some(mean) => format!("{mean:.3} ({count} of {of})"),
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    let count = values.len() as f64;
    (!values.is_empty()).then(|| values.into_iter().sum::<f64>() / count)
}

fn lost<'r>(rows: impl Iterator<Item = &'r Perception>) -> String {
    let (lost, tiles) = rows.fold((0, 0), |(lost, tiles), row| {
        (lost + row.flow_lost, tiles + row.flow_tiles)
    });
    if tiles == 0 {
        return "n/a".to_owned();
    }
    format!("{:.1}", 100.0 * lost as f64 / tiles as f64)
}

/// Makes the table of the regimes of the sets' windows.
#[must_use]
pub fn regimes(results: &Results) -> Table {
    let mut table = Table::new(
        "Regimes",
        "Windows of each source in each regime, by the thresholds of its set: the 25th and 75th \
         percentile of the densities of all its windows.",
        &[
            "source",
            "windows",
            "sparse: DWT",
            "moderate: DTFT",
            "dense: DCT",
        ],
    );
    for set in results.densities() {
        let name = match set.set.as_str() {
            SCENES => "all scenes",
            RECORDINGS => "all recordings",
            other => other,
        };
        let all = set.sources.iter().fold([0; 3], |sum: [u64; 3], source| {
            std::array::from_fn(|i| sum[i] + source.regimes[i])
        });
        let line = |name: &str, regimes: [u64; 3]| {
            let mut row = vec![name.to_owned(), regimes.iter().sum::<u64>().to_string()];
            row.extend(regimes.map(|n| n.to_string()));
            row
        };
        table.rows.extend(
            set.sources
                .iter()
                .map(|source| line(&source.source, source.regimes)),
        );
        table.rows.push(line(
            &format!(
                "{name}: {} and {} events/px/s",
                figure(set.tau_low),
                figure(set.tau_high)
            ),
            all,
        ));
    }
    table
}

/// Makes the table of the sources.
#[must_use]
pub fn sources(results: &Results) -> Table {
    let left_out = recordings::notice(&results.record.left_out);
    let mut table = Table::new(
        "Sources",
        &format!(
            "What is measured: scenes are emulated; recordings are cut after the last whole window \
             that keeps them within a limit of events. {}",
            left_out.unwrap_or_default()
        ),
        &[
            "source",
            "set",
            "pixels",
            "events",
            "seconds",
            "SHA-256 of the events",
        ],
    );
    table
        .rows
        .extend(results.record.sources.iter().map(|source| {
            vec![
                source.source.clone(),
                source.set.clone(),
                format!("{} x {}", source.sensor[0], source.sensor[1]),
                source.events.to_string(),
                format!("{:.3}", source.duration_s),
                source.sha256.get(..16).unwrap_or_default().to_owned(),
            ]
        }));
    table
}

/// Formats the part of docs/paper.md: the answer, and medians of Table I.
#[must_use]
pub fn document(results: &Results) -> String {
    let mut text = String::new();
    for answer in results.answer() {
        text += &super::page::text(&answer);
        text += "\n\n";
    }
    let mut table = Table::new(
        "",
        "",
        &[
            "medians, M = 16",
            "bits/event",
            "packed",
            "emd_pixel, us",
            "emd_time, ms",
            "mse",
            "ssim",
        ],
    );
    for set in results.sets() {
        for method in TABLE_ONE.into_iter().chain(["event-frame", "time-surface"]) {
            let of = |metric: fn(&Quality) -> f64| {
                let sources = results.sources(set).into_iter();
                let rows = sources.filter_map(|source| results.row(set, source, method, M));
                median(rows.map(metric).collect())
            };
            table.rows.push(vec![
                format!("{set}: {}", heading(method)),
                cell(of(|row| row.bits_per_event), "", false),
                cell(of(|row| row.packed_bits_per_event), "", false),
                cell(of(|row| row.emd_pixel_us), "", false),
                cell(of(|row| row.emd_time_ms), "", false),
                cell(of(|row| row.mse), "", false),
                cell(of(|row| row.ssim), "ssim", false),
            ]);
        }
    }
    text += &table.markdown();
    for table in equal_errors(results) {
        text += &format!("\n{}:\n\n{}", table.title, table.markdown());
    }
    text
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use eecvs_bench::marks::of_project;

    use super::*;
    use crate::cmd::report::MARKS;
    use crate::study::claims::Claim;

    #[test]
    fn settings_stand_in_the_order_of_their_numbers() {
        let mut rows = [
            ("voxel", "f32"),
            ("dct", "exact"),
            ("hybrid-dense", "8 bins"),
            ("hybrid-dense", "16 bins"),
            ("hybrid-dense", "1000 us"),
            ("hybrid-dense", "200 us"),
            ("hybrid-fast", "lossless"),
        ];
        rows.sort_by_key(|(method, setting)| order(method, setting));
        let settings = rows.map(|(_, setting)| setting);
        assert_eq!(
            settings,
            [
                "lossless", "200 us", "1000 us", "8 bins", "16 bins", "exact", "f32"
            ]
        );
    }

    #[test]
    fn sources_without_an_iou_are_not_counted_as_agreement() {
        for (sources, cell) in [
            (&[Some(1.0), Some(0.5)][..], "0.750"),
            (&[Some(0.5), None, None], "0.500 (1 of 3)"),
            (&[None, None], "-"),
        ] {
            assert_eq!(iou(sources.iter().copied()), cell);
        }
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("record/results.json");
        let text = std::fs::read_to_string(path).unwrap();
        let mut results: Results = serde_json::from_str(&text).unwrap();
        // In the record, every IoU is one of frames that can be compared.
        let has_both = |row: &Perception| !row.mean_iou().contains(&None);
        assert!(results.perception.iter().all(has_both));
        for row in &mut results.perception {
            (
                row.window_frames,
                row.window_mean_iou,
                row.window_foreground_iou,
            ) = (0, None, None);
            // As earlier versions stored it.
            (
                row.slice_frames,
                row.slice_mean_iou,
                row.slice_foreground_iou,
            ) = (0, Some(1.0), Some(1.0));
        }
        for table in tables_four_and_five(&results) {
            for row in &table.rows {
                assert_eq!(row[2..6], ["-"; 4], "{row:?}");
            }
        }
        let json = serde_json::to_value(&results.perception[0]).unwrap();
        assert!(json["window_mean_iou"].is_null());
        let claims = results.claims();
        let unknown = |claim: &Claim| claim.here.contains("not measured at 24 channels");
        assert_eq!(claims.iter().filter(|claim| unknown(claim)).count(), 1);
    }

    #[test]
    fn the_document_is_of_the_committed_record() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("record/results.json");
        let text = std::fs::read_to_string(path).unwrap();
        let results: Results = serde_json::from_str(&text).unwrap();
        let paper = of_project("docs/paper.md");
        let lines = |text: &str| text.trim().lines().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(
            lines(MARKS.content(&paper).unwrap()),
            lines(&document(&results))
        );
        assert_eq!(results.record.effort, "full");
        assert_eq!(results.sets().len(), 2);
        assert_eq!(table_one(&results).len(), 2 * METRICS.len());
    }
}
