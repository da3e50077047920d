//! Makes every marked section of the documents from its committed record.

use std::path::Path;

use anyhow::{Context, Result};
use eecvs_bench::marks::Marks;
use eecvs_bench::record_file::{RecordFile, read};
use eecvs_bench::table::{exact_times, keep_order, rate_control};

use super::study::tables;
use super::{
    demo, few_table, hub_load_table, kernel_table, pipelines_table, rate_table, read_speed_table,
    ros_delay_table, seek_table, selection_table, skip_table, stream_table,
};
use crate::cmd::report;
use crate::study::Results;

/// The documents that have sections of records, from the root.
pub const DOCUMENTS: [&str; 7] = [
    "README.md",
    "METHODOLOGY.md",
    "docs/results.md",
    "docs/paper.md",
    "crates/event-files/README.md",
    "eecvs-ros/README.md",
    "docs/hub.md",
];

/// A section of a document.
#[derive(Debug)]
pub struct Section {
    /// Its name, one of [`DOCUMENTS`].
    pub document: &'static str,
    /// Markers of the lines between which the section goes.
    pub marks: Marks,
    /// Text of the section.
    pub text: String,
}

/// Makes the sections whose records are in `folder`.
///
/// # Errors
/// Fails if a record cannot be read, or lacks a row that its section shows.
pub fn of_records(folder: &Path) -> Result<Vec<Section>> {
    let whole = |text: Option<String>, name: &str| {
        text.with_context(|| format!("{}/{name}.json: a row is missing", folder.display()))
    };
    let section = |document, marks, text| Section {
        document,
        marks,
        text,
    };
    let results = folder.join("results.json");
    let results = std::fs::read_to_string(&results)
        .with_context(|| format!("{}: cannot be read", results.display()))?;
    // Some editors put a byte-order mark in front.
    let results = results.strip_prefix('\u{feff}').unwrap_or(&results);
    let results: Results = serde_json::from_str(results).context("results.json")?;
    let RecordFile { rows: rates, .. } = read(folder, "rates")?;
    let RecordFile { rows: kernels, .. } = read(folder, "kernels")?;
    let RecordFile { rows: skips, .. } = read(folder, "skips")?;
    let mut times = read(folder, "exact-times-scenes")?.rows;
    times.extend(read(folder, "exact-times-recordings")?.rows);
    let [readme, methodology, measured, paper, files, ros, hub] = DOCUMENTS;
    Ok(vec![
        section(
            readme,
            demo::MARKS,
            demo::document(&read(folder, "demo")?.rows),
        ),
        section(
            measured,
            kernel_table::MARKS,
            whole(kernel_table::document(&kernels), "kernels")?,
        ),
        section(
            readme,
            rate_table::README_MARKS,
            whole(rate_table::readme(&rates), "rates")?,
        ),
        section(
            methodology,
            rate_table::MARKS,
            whole(rate_table::document(&rates), "rates")?,
        ),
        section(
            methodology,
            selection_table::MARKS,
            whole(
                selection_table::document(&read(folder, "selection")?.rows),
                "selection",
            )?,
        ),
        section(
            methodology,
            few_table::MARKS,
            whole(
                few_table::document(&read(folder, "few-as-times")?.rows),
                "few-as-times",
            )?,
        ),
        section(
            methodology,
            skip_table::MARKS,
            whole(skip_table::document(&skips), "skips")?,
        ),
        section(
            measured,
            rate_control::MARKS,
            rate_control::document(&read(folder, "rate-control")?.rows),
        ),
        section(
            measured,
            keep_order::MARKS,
            keep_order::document(&read(folder, "keep-order")?.rows),
        ),
        section(
            measured,
            stream_table::MARKS,
            stream_table::document(&read(folder, "stream")?.rows),
        ),
        section(
            measured,
            seek_table::MARKS,
            seek_table::document(&read(folder, "seek")?.rows),
        ),
        section(
            paper,
            exact_times::MARKS,
            whole(exact_times::document(&times), "exact-times-*")?,
        ),
        section(
            files,
            read_speed_table::MARKS,
            read_speed_table::document(&read(folder, "read-speed")?.rows),
        ),
        section(
            files,
            pipelines_table::MARKS,
            pipelines_table::document(&read(folder, "pipelines")?.rows),
        ),
        section(
            ros,
            ros_delay_table::MARKS,
            ros_delay_table::document(&read(folder, "ros-delay")?.rows),
        ),
        section(
            hub,
            hub_load_table::MARKS,
            hub_load_table::document(&read(folder, "hub-load")?.rows),
        ),
        section(paper, report::MARKS, tables::document(&results)),
    ])
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use eecvs_bench::Row;
    use eecvs_bench::marks::{of_project, path_of_project};
    use eecvs_bench::mcu::{self, Count, Part};

    use super::*;
    use crate::rate;

    /// Sections that `tests/` compares with their records in `firmware/`.
    const ELSEWHERE: [&str; 2] = ["instructions", "kernels"];

    fn folder() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("record")
    }

    /// If the variable `EECVS_BLESS` is set, writes the sections instead of comparing them.
    #[test]
    fn every_section_of_the_documents_is_of_its_record() {
        let sections = of_records(&folder()).unwrap();
        if std::env::var_os("EECVS_BLESS").is_some() {
            for section in &sections {
                let document = path_of_project(section.document);
                section.marks.write(&document, &section.text).unwrap();
            }
        }
        for section in &sections {
            let text = of_project(section.document);
            let name = section.marks.name;
            assert_eq!(
                section.marks.content(&text).unwrap().trim(),
                section.text.trim(),
                "{}: {name} does not match its record: cargo xtask record writes both",
                section.document
            );
        }
        // The documents have no other sections.
        for document in DOCUMENTS {
            let text = of_project(document);
            let begins = text
                .lines()
                .filter_map(|line| line.strip_prefix("<!-- ")?.split_once(": "));
            for (name, _) in begins {
                let is_known = ELSEWHERE.contains(&name)
                    || sections
                        .iter()
                        .any(|section| (section.document, section.marks.name) == (document, name));
                assert!(is_known, "{document}: unknown section {name}");
            }
        }
    }

    /// Checks the sentences on rates in docs/results.md.
    #[test]
    fn the_sentences_about_rates_are_of_their_record() {
        let rows: Vec<rate::Row> = read(&folder(), "rates").unwrap().rows;
        let document = of_project("docs/results.md");
        let says = |words: &str| {
            let document: Vec<&str> = document.split_whitespace().collect();
            assert!(
                document.join(" ").contains(words),
                "docs/results.md no longer says: {words}"
            );
        };
        let find = |recording: &str, codec: &str| {
            rows.iter()
                .find(|row| {
                    (row.recording.as_str(), row.codec, row.setting.as_str())
                        == (recording, codec, "lossless")
                })
                .unwrap()
        };
        let recordings = rate_table::recordings(&rows);
        says("Dense takes fewer bits than every lossless peer of the table on all recordings.");
        for recording in &recordings {
            let dense = find(recording, "hybrid-dense").bits_per_event;
            for row in rows.iter().filter(|row| row.recording == *recording) {
                let is_other = row.codec != "hybrid-dense" && !row.codec.starts_with("hybrid-tree");
                if row.setting == "lossless" && is_other {
                    assert!(dense < row.bits_per_event, "{recording}: {}", row.codec);
                }
            }
        }
        says("takes fewer on three of the nine");
        says("effort 3 takes fewer than it on all nine");
        let methodology = of_project("METHODOLOGY.md");
        let (_, others) = methodology.split_once("| recording | G-PCC |").unwrap();
        let beats = |codec: &str| {
            let wins = |recording: &&&str| {
                let row = format!("| {recording} | ");
                let (_, cells) = others.split_once(&row).unwrap();
                let bits: f64 = cells.split(' ').next().unwrap().parse().unwrap();
                bits < find(recording, codec).bits_per_event
            };
            recordings.iter().filter(wins).count()
        };
        assert_eq!((beats("hybrid-dense"), beats("hybrid-tree-3")), (3, 0));
        says("Fast takes more than xz on one of them, in less than a fiftieth of its time.");
        let more = |recording: &&&str| {
            find(recording, "hybrid-keys").bits_per_event > find(recording, "xz-9").bits_per_event
        };
        assert_eq!(recordings.iter().filter(more).count(), 1);
        for recording in &recordings {
            let (fast, xz) = (find(recording, "hybrid-keys"), find(recording, "xz-9"));
            assert!(50.0 * fast.seconds < xz.seconds, "{recording}");
        }
        says("on every recording and at every M");
        says("the Haar transform above all, by 1 to 15 %");
        let (plain, _) = rate_table::ratios(&rows, "");
        assert!(plain.iter().all(|ratio| *ratio >= 1.0));
        let (_, best) = rate_table::ratios(&rows, "-dense");
        let won: Vec<f64> = best.into_iter().filter(|ratio| *ratio < 1.0).collect();
        let percent = |ratio: f64| (100.0 * (1.0 - ratio)).round();
        let least = won.iter().copied().fold(0.0, f64::max);
        let most = won.iter().copied().fold(1.0, f64::min);
        assert_eq!([percent(least), percent(most)], [1.0, 15.0]);
    }

    /// Checks the sentence on delays in eecvs-ros/README.md.
    #[test]
    fn the_sentence_about_delays_is_of_its_record() {
        let rows: Vec<ros_delay_table::Row> = read(&folder(), "ros-delay").unwrap().rows;
        let document = of_project("eecvs-ros/README.md");
        let document: Vec<&str> = document.split_whitespace().collect();
        assert!(document.join(" ").contains(
            "With these windows the median is below 2 ms and the 99th percentile below 5 ms; \
             those of 32,768 us take more than 2 and 5 ms"
        ));
        let measured: Vec<(&str, u32)> = rows
            .iter()
            .map(|row| (row.transport.as_str(), row.window_us))
            .collect();
        let all = ["dds", "zenoh"].map(|name| [4000, 8000, 32_768].map(|us| (name, us)));
        assert_eq!(measured, all.concat());
        for row in &rows {
            assert!(row.events_per_s > 5e6, "{row:?}");
            assert_eq!((row.packets_lost, row.frames_lost), (0, 0), "{row:?}");
            let (p50, p99) = (row.delay_p50_ms, row.delay_p99_ms);
            match row.window_us {
                4000 => assert!(p50 < 2.0 && p99 < 5.0, "{row:?}"),
                32_768 => assert!(p50 > 2.0 && p99 > 5.0, "{row:?}"),
                _ => {}
            }
        }
    }

    /// Checks that the runs at full load lost nothing.
    #[test]
    fn nothing_is_lost_under_load() {
        let rows: Vec<hub_load_table::Row> = read(&folder(), "hub-load").unwrap().rows;
        assert_eq!((rows.len(), hub_load_table::failures(&rows)), (3, 0));
    }

    /// Checks the sentence on reading in crates/event-files/README.md.
    #[test]
    fn the_sentence_about_reading_is_of_its_record() {
        let rows: Vec<read_speed_table::Row> = read(&folder(), "read-speed").unwrap().rows;
        let document = of_project("crates/event-files/README.md");
        assert!(document.contains("No other library reads one of these files more quickly"));
        assert!(rows.len() > 13);
        assert_eq!(read_speed_table::slower(&rows), []);
    }

    /// Checks the sentence on converting in crates/event-files/README.md.
    #[test]
    fn the_sentence_about_converting_is_of_its_record() {
        let rows: Vec<pipelines_table::Row> = read(&folder(), "pipelines").unwrap().rows;
        let document = of_project("crates/event-files/README.md");
        assert!(
            document
                .contains("No other library converts between two of these formats more quickly")
        );
        assert!(rows.len() > 36);
        assert_eq!(pipelines_table::slower(&rows), []);
    }

    /// Checks the sentences on kernels in docs/results.md.
    #[test]
    fn the_sentences_about_kernels_are_of_their_records() {
        let rows: Vec<Row> = read(&folder(), "kernels").unwrap().rows;
        let of = |kernel: &'static str| {
            let is_it = move |row: &&Row| (row.kernel, row.target) == (kernel, "host");
            rows.iter().filter(is_it)
        };
        assert!(of("haar").count() > 0);
        assert!(of("haar").all(|row| row.max_error == Some(0.0)));
        for table in of("table") {
            for kernel in ["recurrence", "precise", "libm", "micromath"] {
                let is_same = |row: &&Row| {
                    (row.transform, row.m, &row.window) == (table.transform, table.m, &table.window)
                };
                for row in of(kernel).filter(is_same) {
                    assert!(
                        table.cost < row.cost,
                        "{kernel}, {}, {}",
                        row.transform,
                        row.m
                    );
                }
            }
        }
        let document = of_project("docs/results.md");
        let words: Vec<&str> = document.split_whitespace().collect();
        let words = words.join(" ");
        assert!(words.contains("crowded pixels of the DCT with M = 24 on a microcontroller"));
        let counts = mcu::saved().unwrap();
        let mut faster = BTreeSet::new();
        let per_event = |count: &Count, part: fn(&Count) -> Part| {
            let is_same = |other: &&Count| {
                (
                    &other.target,
                    &other.kernel,
                    &other.transform,
                    other.m,
                    &other.origin,
                ) == (
                    &count.target,
                    &count.kernel,
                    &count.transform,
                    count.m,
                    &count.origin,
                )
            };
            let sum = counts.iter().filter(is_same).map(part);
            let (instructions, events) = sum.fold((0, 0), |(instructions, events), part| {
                (instructions + part.instructions, events + part.events)
            });
            instructions as f64 / events as f64
        };
        for count in counts.iter().filter(|count| count.origin == "recordings") {
            let table = Count {
                kernel: "table".to_owned(),
                ..count.clone()
            };
            for (name, part) in [
                ("all", (|count| count.all) as fn(&Count) -> Part),
                ("crowded", |count| count.crowded),
            ] {
                if per_event(count, part) < per_event(&table, part) {
                    let key = (count.kernel.as_str(), count.transform.as_str(), count.m);
                    faster.insert((key, name));
                }
            }
        }
        assert_eq!(
            faster.into_iter().collect::<Vec<_>>(),
            [(("recurrence", "dct", 24), "crowded")]
        );
    }
}
