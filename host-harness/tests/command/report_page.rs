//! The page of `eecvs report` in a browser, as wide as a desk's and as a telephone's: everything is there,
//! legible and within reach, and nothing comes from elsewhere. Skipped, with a notice, without Chromium;
//! which one is run says the variable `EECVS_BROWSER`. The page is kept in the file that `EECVS_PAGE` names.

use eecvs_bench::source::Source;
use eecvs_nostd::{Event, Sensor};
use host_harness::downstream::segment::classical::Classical;
use host_harness::report::strips::LETTER;
use host_harness::report::study::figures::{self, Figure};
use host_harness::report::study::{page, tables};
use host_harness::study::effort::Effort;
use host_harness::study::kernels;
use host_harness::study::record::Record;
use host_harness::study::set::{RECORDINGS, Set};
use host_harness::study::store::Store;
use host_harness::study::{self, Results};

use crate::browser;

/// Of a desk and of a telephone.
const WIDTHS: [u32; 2] = [1280, 390];

/// As `--quick`, of less.
const EFFORT: Effort = Effort {
    scene_us: 40_000,
    m: &[8, 16],
    m_curve: &[4],
    tolerances_us: &[50, 1000],
    bins: &[8],
    speed_s: 0.01,
    ..Effort::QUICK
};

/// A set of scenes and one of recordings, each a scene; the recording is of a wide sensor.
fn sets() -> [Set; 2] {
    let scenes = Set::scenes(&EFFORT).unwrap();
    let mut sources = scenes.sources.iter().cloned();
    let first = sources.next().unwrap();
    let last = sources.next_back().unwrap();
    let moved = |event: &Event| Event {
        x: event.x + 290,
        y: event.y + 210,
        ..*event
    };
    let wide = Source {
        name: "a_recording_of_a_wide_sensor".to_owned(),
        sensor: Sensor::new(640, 480).unwrap(),
        events: last.events.iter().map(moved).collect(),
    };
    let set = |name, source| Set {
        name,
        sources: vec![source],
        ..scenes.clone()
    };
    [set(scenes.name, first), set(RECORDINGS, wide)]
}

/// Rows and pictures of the small study, as the command makes them.
fn study() -> (Results, Vec<Figure>) {
    let folder = tempfile::tempdir().unwrap();
    let sets = sets();
    let record = Record::new(&sets, &[], &EFFORT, "built-in");
    let (store, _) = Store::open(&folder.path().join("rows.jsonl"), record, true).unwrap();
    kernels::add_to(&store, eecvs_bench::Effort::QUICK).unwrap();
    study::run(&sets, &EFFORT, &Classical, &store, &|_, _| ()).unwrap();
    let results = store.results();
    let figures = figures::all(&sets, &results).unwrap();
    (results, figures)
}

/// Headings and numbers of rows of every table, in the order of the page.
fn expected_tables(results: &Results) -> Vec<(String, usize)> {
    let mut all = tables::table_one(results);
    all.push(tables::other_arrays(results));
    all.push(tables::table_two(results));
    all.push(tables::table_three(results));
    all.extend(tables::tables_four_and_five(results));
    all.push(tables::regimes(results));
    all.push(tables::sources(results));
    all.into_iter()
        .map(|table| (table.title, table.rows.len()))
        .collect()
}

#[test]
fn the_page_is_whole_at_both_widths() {
    let Some(browser) = browser::find() else {
        eprintln!("skipped: there is no chromium");
        return;
    };
    let (results, figures) = study();
    let html = page::html(&results, &figures).unwrap();
    if let Ok(path) = std::env::var("EECVS_PAGE") {
        std::fs::write(path, &html).unwrap();
    }
    let view = browser::view(&browser, &WIDTHS.map(|width| (html.clone(), width)));
    assert_eq!(view.console, [""; 0]);
    for page in &view.pages {
        assert_eq!(page.faults(LETTER as f64), [""; 0], "at {}", page.width);
    }
    let tables = expected_tables(&results);
    assert!(tables.len() > 12 && tables.iter().all(|(_, rows)| *rows > 0));
    for page in &view.pages {
        let seen: Vec<_> = page
            .tables
            .iter()
            .map(|table| (table.title.clone(), table.rows))
            .collect();
        assert_eq!(seen, tables);
        // Every figure, however the sections order them.
        let mut seen: Vec<_> = page
            .pictures
            .iter()
            .map(|picture| {
                let kind = picture.kind.as_str();
                // A chart's PNG has twice its size.
                let scale = if kind == "svg" { 2.0 } else { 1.0 };
                let size = [picture.natural_width, picture.natural_height];
                (
                    kind,
                    picture.caption.as_str(),
                    size.map(|side| (side * scale) as usize),
                )
            })
            .collect();
        let mut made: Vec<_> = figures
            .iter()
            .map(
                |Figure {
                     svg, caption, png, ..
                 }| {
                    let kind = if svg.is_some() { "svg" } else { "img" };
                    (kind, caption.as_str(), [png.width(), png.height()])
                },
            )
            .collect();
        seen.sort_unstable();
        made.sort_unstable();
        assert_eq!(seen, made);
        println!(
            "at {}: {} tables, {} pictures, letters of {:.1} px or more, in charts {:.1} px",
            page.width,
            page.tables.len(),
            page.pictures.len(),
            page.least_text.as_ref().unwrap().px,
            page.least_chart_text.as_ref().unwrap().px
        );
    }
    let strips: Vec<_> = figures
        .iter()
        .filter(|figure| figure.svg.is_none())
        .collect();
    assert!(strips[0].caption.contains("all 346 x 260 pixels"));
    assert!(strips[1].caption.contains("the 200 x 150 pixels from"));
}

/// Checked squares, white, and the first rows of the former: 8 x 8 grey pixels as PNG.
const SQUARES: &str = "iVBORw0KGgoAAAANSUhEUgAAAAgAAAAICAAAAADhZOFXAAAAU0lEQVR4AQFIALf/AAD/AP8A/wD/AP8A/wD/AP8AAAD/AP8A/wD/AP8A/wD/AP8AAAD/AP8A/wD/AP8A/wD/AP8AAAD/AP8A/wD/AP8A/wD/AP8AfAQf4auofEEAAAAASUVORK5CYII=";
const WHITE: &str = "iVBORw0KGgoAAAANSUhEUgAAAAgAAAAICAAAAADhZOFXAAAAU0lEQVR4AQFIALf/AP//////////AP//////////AP//////////AP//////////AP//////////AP//////////AP//////////AP//////////98A/wQLkt+wAAAAASUVORK5CYII=";
const TORN: &str = "iVBORw0KGgoAAAANSUhEUgAAAAgAAAAICAAAAADhZOFXAAAAU0lEQVR4AQFIALf/AAD/AP8A/wD/AP8A/wD/AP8AAAD/AP8A/wD/AP8A";

#[test]
fn every_fault_of_a_page_is_seen() {
    let Some(browser) = browser::find() else {
        eprintln!("skipped: there is no chromium");
        return;
    };
    let image = |base64: &str, more: &str| {
        format!(
            "<figure><img alt=\"\" src=\"data:image/png;base64,{base64}\" {more}><figcaption>it</figcaption></figure>"
        )
    };
    let svg = |size: &str, inside: &str| format!("<svg {size}><g/>{inside}</svg>");
    let text = |x: u32| format!("<text x=\"{x}\" y=\"30\" font-size=\"12\">label</text>");
    let table = |title: &str, rows: &str| {
        format!(
            "<section><h3>{title}</h3><table><thead><tr><th>a</th></tr></thead><tbody>{rows}</tbody></table></section>"
        )
    };
    let size = "width=\"90\" height=\"50\" viewBox=\"0 0 90 50\"";
    // What no page is blamed for: a chart that is wider than the window too, in a box that scrolls.
    let good = table("T", "<tr><td>1</td></tr>")
        + "<p id=\"here\"><a href=\"#here\">text</a></p><div style=\"overflow-x: auto\">"
        + &svg(
            "width=\"900\" height=\"50\" viewBox=\"0 0 900 50\"",
            &text(700),
        )
        + "</div>"
        + &image(SQUARES, "");
    let wide = "style=\"white-space: nowrap; width: 600px\"";
    let cases = [
        (String::new(), ""),
        (
            "<div style=\"width: 500px; height: 1px\"></div>".to_owned(),
            "the page is 508 wide",
        ),
        (
            format!("<p {wide}>{}</p>", "words ".repeat(20)),
            "out of reach: words",
        ),
        (image("iVBORw0KGgo=", ""), "img it: is not decoded"),
        (image(TORN, ""), "img it: is not decoded"),
        (image(WHITE, ""), "img it: is empty"),
        (image(SQUARES, "width=\"5\""), "img it: letters of 7.5 px"),
        (
            image(SQUARES, "width=\"9\" height=\"50\""),
            "img it: is distorted",
        ),
        (image(SQUARES, "hidden"), "img it: has no size"),
        (
            svg(&format!("{size} style=\"display: none\""), &text(0)),
            "svg : has no size",
        ),
        (svg(size, &text(80)), "cut off: label"),
        (
            svg(
                "width=\"90\" height=\"50\" viewBox=\"0 0 180 100\"",
                &text(0),
            ),
            "letters of 6.0 px: label",
        ),
        (table("None", ""), "table None: no rows"),
        (
            table("Gap", "<tr><td></td></tr>"),
            "table Gap: no rows, or cells without text",
        ),
        (
            "<small style=\"font-size: 7px\">tiny</small>".to_owned(),
            "letters of 7.0 px: tiny",
        ),
        (
            "<a href=\"https://example.invalid/\">away</a>".to_owned(),
            "outside of the page: href=https://example.invalid/",
        ),
        (
            "<style>u { background: url('other.png') }</style>".to_owned(),
            "outside of the page: other.png",
        ),
        (
            "<a href=\"#nowhere\">lost</a>".to_owned(),
            "no such place: nowhere",
        ),
    ];
    let frames: Vec<_> = cases
        .iter()
        .map(|(body, _)| {
            let html = format!(
                "<!doctype html><html><body style=\"margin: 8px\">{good}{body}</body></html>"
            );
            (html, 390)
        })
        .collect();
    let view = browser::view(&browser, &frames);
    for (page, (body, fault)) in view.pages.iter().zip(&cases) {
        let seen = page.faults(12.0);
        if fault.is_empty() {
            assert_eq!(seen, [""; 0]);
        } else {
            let is_seen = seen.iter().any(|seen| seen.starts_with(fault));
            assert!(is_seen, "{fault} is not in {seen:?}: {body}");
        }
    }
}

#[test]
fn a_page_s_console_is_heard() {
    let Some(browser) = browser::find() else {
        eprintln!("skipped: there is no chromium");
        return;
    };
    let heard = |html: &str| browser::view(&browser, &[(html.to_owned(), 390)]).console;
    assert_eq!(heard("<!doctype html><p>quiet</p>"), [""; 0]);
    let lines = heard(
        "<!doctype html><script>console.warn('a note')</script><script>undefined.field</script>",
    );
    for part in ["a note", "TypeError"] {
        assert!(lines.iter().any(|line| line.contains(part)), "{lines:?}");
    }
}
