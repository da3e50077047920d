//! Pictures of a study: charts of its rows, and strips of its sources.

use anyhow::Result;
use eecvs::reconstruct::events::Finder;
use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::{Coder, Event, Fidelity, Transform};
use event_pictures::picture::Picture;

use super::colours::label;
use super::equal_errors::EqualErrors;
use super::panels::Whole;
use super::rate_distortion::RateDistortion;
use super::section::Section;
use super::time_errors::TimeErrors;
use crate::baseline::{Baseline, Stored};
use crate::report::chart::{self, DensityPoint, Thresholds};
use crate::report::kernel_chart;
use crate::report::sheet::Sheet;
use crate::report::strips::{Strips, strips};
use crate::study::density::Densities;
use crate::study::effort::M;
use crate::study::kernels::KernelRow;
use crate::study::method::Method;
use crate::study::perception::SLICE_US;
use crate::study::set::{RECORDINGS, SCENES, Set};
use crate::study::{Results, quality};

/// A picture on the page, which is also saved beside it.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Section of the page that shows it.
    pub section: Section,
    /// Name of its files without extension.
    pub name: String,
    /// Caption below the picture.
    pub caption: String,
    /// The picture as SVG, if it is a chart.
    pub svg: Option<String>,
    /// The picture in pixels.
    pub png: Picture,
}

impl Figure {
    fn chart(section: Section, name: String, caption: &str, sheet: Sheet) -> Self {
        Self {
            section,
            name,
            caption: caption.to_owned(),
            svg: Some(sheet.svg),
            png: sheet.png,
        }
    }
}

/// Beginnings of the figures' names, after which the set may follow.
const NAMES: [&str; 7] = [
    "rate-distortion",
    "rate-equal-errors",
    "rate-times",
    "density-histogram",
    "density-over-time",
    "table-one-strips",
    "table-three-kernels",
];

/// Returns whether a file is named like one of a figure.
#[must_use]
pub fn is_file(name: &str) -> bool {
    let stem = name.strip_suffix(".svg").or(name.strip_suffix(".png"));
    let is_of = |stem: &str, name: &str| {
        stem.strip_prefix(name).is_some_and(|set| {
            let set = set.strip_prefix('-').unwrap_or(set);
            ["", SCENES, RECORDINGS].contains(&set)
        })
    };
    stem.is_some_and(|stem| NAMES.iter().any(|name| is_of(stem, name)))
}

/// Makes all pictures of the page.
///
/// # Errors
/// Fails as [`charts`], [`of_slices`] and [`of_kernels`] do.
pub fn all(sets: &[Set], results: &Results) -> Result<Vec<Figure>> {
    let mut figures = charts(results)?;
    figures.extend(of_slices(sets)?);
    figures.push(of_kernels(results)?);
    Ok(figures)
}

/// Makes the charts of rates, errors of times and densities.
///
/// # Errors
/// Fails if a row holds a value that is not a number.
pub fn charts(results: &Results) -> Result<Vec<Figure>> {
    let mut figures = vec![
        Figure::chart(
            Section::Rate,
            "rate-distortion".to_owned(),
            "Bits per event against the error of event times; exact results are at the foot. Down \
             and left is better.",
            Sheet::new(&Whole(RateDistortion(results)))?,
        ),
        Figure::chart(
            Section::Rate,
            "rate-equal-errors".to_owned(),
            "The fewest bits of all settings of a representation that are within an error, medians; \
             on the left the error of times, on the right that of the volume smoothed by 4 ms. Only \
             representations that have such a setting for every source. Down is better.",
            Sheet::new(&Whole(EqualErrors(results)))?,
        ),
        Figure::chart(
            Section::Rate,
            "rate-times".to_owned(),
            "Share of events within a given error of their own time. A curve that does not reach \
             100 % came back with a different number of events. Up and left is better.",
            Sheet::new(&Whole(TimeErrors(results)))?,
        ),
    ];
    for set in results.densities() {
        let densities: Vec<f64> = set
            .sources
            .iter()
            .flat_map(|source| source.density_per_px_s.iter().copied())
            .collect();
        let title = format!("{} windows of the {}", densities.len(), set.set);
        figures.push(Figure::chart(
            Section::Density,
            format!("density-histogram-{}", set.set),
            "Densities of all windows of a set, empty ones included, with the two thresholds that \
             separate the regimes: its 25th and 75th percentile.",
            chart::density_histogram(&title, &densities, thresholds(set))?,
        ));
        figures.push(Figure::chart(
            Section::Density,
            format!("density-over-time-{}", set.set),
            "Density and regime of every window in turn, source by source in the order of the \
             table.",
            over_time(set)?,
        ));
    }
    Ok(figures)
}

fn thresholds(set: &Densities) -> Thresholds {
    Thresholds {
        tau_low: set.tau_low,
        tau_high: set.tau_high,
    }
}

fn over_time(set: &Densities) -> Result<Sheet> {
    let densities = set
        .sources
        .iter()
        .flat_map(|source| source.density_per_px_s.iter());
    let points: Vec<DensityPoint> = densities
        .enumerate()
        .map(|(window, density)| DensityPoint {
            time_s: window as f64 * f64::from(WINDOW_US) * 1e-6,
            density: *density,
        })
        .collect();
    let title = format!("The {}, one after the other", set.set);
    chart::density_over_time(&title, &points, thresholds(set))
}

/// Draws a tenth of a window of each set as each method decodes it: original, decoded, difference.
///
/// # Errors
/// Fails if a codec breaks its promise.
pub fn of_slices(sets: &[Set]) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for set in sets {
        let Some((source, window)) = dense_window(set) else {
            continue;
        };
        let from_us = window.start_us() + u64::from(3 * SLICE_US);
        let slice = |events: &[Event]| -> Vec<Event> {
            let until_us = from_us + u64::from(SLICE_US);
            let inside = |event: &&Event| (from_us..until_us).contains(&event.t_us);
            events.iter().filter(inside).copied().collect()
        };
        let mut methods = Vec::new();
        for method in shown() {
            let trip = method.round_trip(&window, set.thresholds)?;
            let name = match method {
                Method::Hybrid { .. } => format!("events, {}", method.setting()),
                _ => label(method.name()).to_owned(),
            };
            methods.push((name, slice(&trip.events)));
        }
        let Strips { picture, part } = strips(window.sensor, &slice(&window.events), &methods);
        figures.push(Figure {
            section: Section::TableOne,
            name: format!("table-one-strips-{}", set.name),
            caption: format!(
                "{} ms out of a window of {} ({} events), {part}{}: the original, and for each \
                 representation at M = {M} what came back, above its difference from the original.",
                figure_ms(SLICE_US),
                source.name,
                window.events.len(),
                if part.is_cut() { ", the densest" } else { "" }
            ),
            svg: None,
            png: picture,
        });
    }
    Ok(figures)
}

fn figure_ms(us: u32) -> String {
    format!("{:.1}", f64::from(us) / 1e3)
}

/// Returns the methods shown in strips.
fn shown() -> Vec<Method> {
    let transform = |transform| Method::Transform {
        transform: Some(transform),
        m: M,
        finder: Finder::Exact,
    };
    let mut methods = vec![
        Method::Hybrid {
            coder: Coder::Dense,
            fidelity: Fidelity::ToleranceUs(1000),
        },
        Method::Hybrid {
            coder: Coder::Dense,
            fidelity: Fidelity::Bins(8),
        },
    ];
    methods.extend(Transform::ALL.map(transform));
    methods.extend(Baseline::ALL.map(|baseline| Method::Baseline {
        baseline,
        m: M,
        stored: Stored::F32,
    }));
    methods
}

/// Returns the densest source, and its window in the middle of its events.
fn dense_window(set: &Set) -> Option<(&Source, Source)> {
    let by_density = |a: &&Source, b: &&Source| {
        let density = |source: &Source| quality::density_per_px_s(source);
        density(a).total_cmp(&density(b))
    };
    let source = set.sources.iter().max_by(by_density)?;
    let number = |t_us: u64| (t_us - source.start_us()) / u64::from(WINDOW_US);
    let middle = source
        .events
        .get(source.events.len() / 2)
        .map(|event| number(event.t_us))?;
    let events = source
        .events
        .iter()
        .filter(|event| number(event.t_us) == middle);
    let window = Source {
        name: source.name.clone(),
        sensor: source.sensor,
        events: events.copied().collect(),
    };
    Some((source, window))
}

/// Makes the chart of run time against error of every kernel.
///
/// # Errors
/// Fails if a row cannot be drawn.
pub fn of_kernels(results: &Results) -> Result<Figure> {
    let rows = results.kernels.iter().map(KernelRow::of_bench);
    let rows = rows.collect::<Result<Vec<_>>>()?;
    let title =
        "Accumulate stage: run time against error at M = 8, 16, 24, 64; windows of emulated scenes";
    Ok(Figure {
        section: Section::TableThree,
        name: "table-three-kernels".to_owned(),
        caption: "Every kernel and its peers. Filled points are on the front of their M. Down and left is \
                  better."
            .to_owned(),
        svg: Some(kernel_chart::svg(title, &rows)?),
        png: kernel_chart::picture(title, &rows)?,
    })
}
