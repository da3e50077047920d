//! Charts of rate against distortion: one column per recording, for three recordings; one panel for the error of
//! times and one for the error of the volume.
//!
//! Both axes are logarithmic; lossless results are drawn at the foot. Colours are of the Okabe-Ito set, and shapes
//! distinguish settings of the same colour: circles for tolerances and for M, triangles for bins, digits for peers.
//! Arrays that would extend the axis to thousands of bits are named at its right end instead.

use anyhow::{Result, anyhow, ensure};
use event_pictures::picture::Picture;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::kernel_chart::{Drawn, FRONT, GRID, INK, PNG_SCALE, power, text};
use super::picture_backend::PictureBackend;
use super::rate_table::{figure, of_times, of_volume, recordings};
use crate::rate::{OWN_WINDOWS_SETTING, Row};

const WIDTH: u32 = 1200;
/// Height of title and legends.
const HEAD: u32 = 82;
/// Height of a row of panels.
const ROW: u32 = 400;
const PANELS: u32 = 2;
/// Number of recordings drawn.
pub(super) const COLUMNS: usize = 3;
/// Recordings that are preferred: with many, some and few events per pixel.
const PREFERRED: [&str; COLUMNS] = [
    "gen3_vga_dense_evt2",
    "davis346_building_dense",
    "imx636_sparse_evt3",
];
const BROWN: RGBColor = RGBColor(150, 90, 30);

/// A line of the chart: the codec, whether it is of its bins, name and colour.
struct Series {
    codec: &'static str,
    is_bins: bool,
    name: &'static str,
    colour: RGBColor,
}

const fn series(
    codec: &'static str,
    is_bins: bool,
    name: &'static str,
    colour: RGBColor,
) -> Series {
    Series {
        codec,
        is_bins,
        name,
        colour,
    }
}

const BLUE: RGBColor = RGBColor(0, 114, 178);
const GREEN: RGBColor = RGBColor(0, 158, 115);
const SERIES: [Series; 7] = [
    series("hybrid-dense", false, "dense", BLUE),
    series("hybrid-dense", true, "dense, bins", BLUE),
    series("hybrid-keys", false, "fast", GREEN),
    series("hybrid-keys", true, "fast, bins", GREEN),
    series("transform-dct", false, "DCT", RGBColor(213, 94, 0)),
    series("transform-dtft", false, "DTFT", RGBColor(230, 159, 0)),
    series("transform-dwt", false, "Haar", RGBColor(204, 121, 167)),
];
/// Lossless peers, in the order of their digits.
const PEERS: [(&str, &str); 6] = [
    ("zstd-19", "zstd -19"),
    ("xz-9", "xz -9"),
    ("evt3", "EVT 3.0"),
    ("evt2", "EVT 2.0"),
    ("aedat4-zstd", "AEDAT 4 zstd"),
    ("aedat4-lz4", "AEDAT 4 LZ4"),
];

/// Arrays: codec, setting, name.
const ARRAYS: [(&str, &str, &str); 2] = [
    ("tore", "u8", "TORE u8"),
    ("voxel", "8 bins, i8", "voxels i8"),
];

/// A distortion, drawn on the vertical axis of a panel.
struct Measure {
    name: &'static str,
    of: fn(&Row) -> Option<f64>,
}

const MEASURES: [Measure; PANELS as usize] = [
    Measure {
        name: "error of times (emd_pixel), us",
        of: of_times,
    },
    Measure {
        name: "error of 8 bins (volume_nmse)",
        of: of_volume,
    },
];

/// Draws the chart as SVG text.
///
/// # Errors
/// Fails if a rate is not above 0, or a distortion is negative or not a number.
pub fn svg(title: &str, rows: &[Row]) -> Result<String> {
    check(rows)?;
    let mut svg = String::new();
    {
        let size = (WIDTH, HEAD + PANELS * ROW);
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area, title, rows, 1)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(svg)
}

/// Draws the chart as a picture.
///
/// # Errors
/// Fails as [`svg`] does.
pub fn picture(title: &str, rows: &[Row]) -> Result<Picture> {
    check(rows)?;
    let side = |side: u32| side as usize * PNG_SCALE as usize;
    let mut picture = Picture::new(side(WIDTH), side(HEAD + PANELS * ROW), [255; 3]);
    {
        let area = PictureBackend(&mut picture).into_drawing_area();
        draw(&area, title, rows, PNG_SCALE)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(picture)
}

fn check(rows: &[Row]) -> Result<()> {
    for row in rows {
        let (codec, bits) = (row.codec, row.bits_per_event);
        ensure!(bits.is_finite() && bits > 0.0, "{codec} takes {bits} bits");
        for measure in &MEASURES {
            let error = (measure.of)(row).unwrap_or(0.0);
            let is_error = error.is_finite() && error >= 0.0;
            ensure!(is_error, "{codec} has an error of {error}");
        }
    }
    Ok(())
}

/// Returns the recordings to draw: the preferred ones, then the first others.
pub(super) fn shown(rows: &[Row]) -> Vec<&str> {
    let all = recordings(rows);
    let preferred = PREFERRED.iter().copied().filter(|name| all.contains(name));
    let others = all.iter().copied().filter(|name| !PREFERRED.contains(name));
    preferred.chain(others).take(COLUMNS).collect()
}

fn is_array(row: &Row) -> bool {
    ["tore", "voxel"].contains(&row.codec)
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    rows: &[Row],
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    let (head, rest) = area.split_vertically(HEAD as i32 * scale);
    head.draw_text(title, &text(14, scale), (14 * scale, 10 * scale))?;
    keys(&head, scale)?;
    let shown = shown(rows);
    for (measure, line) in MEASURES.iter().zip(rest.split_evenly((PANELS as usize, 1))) {
        let panels = line.split_evenly((1, COLUMNS));
        for (recording, panel) in shown.iter().zip(&panels) {
            let here: Vec<&Row> = rows
                .iter()
                .filter(|row| row.recording == *recording && row.setting != OWN_WINDOWS_SETTING)
                .collect();
            Panel {
                measure,
                rows: &here,
                axes: Axes::new(&here, measure),
                scale,
            }
            .draw(panel, recording)?;
        }
    }
    area.present()
}

/// Draws the legends of the colours and the digits.
fn keys<B: DrawingBackend>(head: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let mut x = 20;
    for series in &SERIES {
        mark(head, (x * scale, 44 * scale), series, scale)?;
        let at = ((x + 10) * scale, 38 * scale);
        head.draw_text(series.name, &text(12, scale), at)?;
        x += 34 + 9 * series.name.len() as i32;
    }
    let note = "numbers beside them: M";
    head.draw_text(note, &text(12, scale), (x * scale, 38 * scale))?;
    let mut x = 14;
    let peers = PEERS
        .iter()
        .zip(1..)
        .map(|((_, name), digit)| format!("{digit} {name}"));
    for label in std::iter::once("lossless, at the foot:".to_owned()).chain(peers) {
        head.draw_text(&label, &text(12, scale), (x * scale, 60 * scale))?;
        x += 22 + 9 * label.len() as i32;
    }
    Ok(())
}

/// Draws a point of a series at a position in pixels.
fn mark<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    at: (i32, i32),
    series: &Series,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let style = series.colour.filled();
    if series.is_bins {
        area.draw(&TriangleMarker::new(at, 5 * scale, style))
    } else {
        area.draw(&Circle::new(at, 4 * scale, style))
    }
}

/// Ends of both axes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axes {
    bits: (f64, f64),
    errors: (f64, f64),
    /// Error at which 0 is drawn.
    zero: f64,
}

impl Axes {
    fn new(rows: &[&Row], measure: &Measure) -> Self {
        let (mut bits, mut errors) = ((f64::INFINITY, 0.0_f64), (f64::INFINITY, 0.0_f64));
        for row in rows.iter().filter(|row| !is_array(row)) {
            bits = (
                bits.0.min(row.bits_per_event),
                bits.1.max(row.bits_per_event),
            );
            if let Some(error) = (measure.of)(row).filter(|error| *error > 0.0) {
                errors = (errors.0.min(error), errors.1.max(error));
            }
        }
        if bits.1 == 0.0 {
            bits = (1.0, 100.0);
        }
        if errors.1 == 0.0 {
            errors = (1e-3, 1.0);
        }
        let zero = 10_f64.powf(errors.0.log10().floor() - 1.0);
        Self {
            bits: (bits.0 / 1.3, bits.1 * 1.6),
            errors: (zero / 2.0, errors.1 * 3.0),
            zero,
        }
    }

    fn label(&self, error: f64) -> String {
        if (error / self.zero - 1.0).abs() < 1e-6 {
            "0".to_owned()
        } else {
            power(error)
        }
    }
}

struct Panel<'p> {
    measure: &'p Measure,
    rows: &'p [&'p Row],
    axes: Axes,
    scale: i32,
}

impl Panel<'_> {
    fn draw<B: DrawingBackend>(&self, panel: &DrawingArea<B, Shift>, recording: &str) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        let (axes, scale) = (self.axes, self.scale);
        let mut chart = ChartBuilder::on(panel)
            .caption(recording, text(14, scale))
            .margin(8 * scale)
            .margin_right(16 * scale)
            .x_label_area_size(40 * scale)
            .y_label_area_size(60 * scale)
            .build_cartesian_2d(
                (axes.bits.0..axes.bits.1).log_scale(),
                (axes.errors.0..axes.errors.1).log_scale(),
            )?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(FRONT)
            .label_style(text(11, scale))
            .axis_desc_style(text(12, scale))
            .x_desc("bits per event")
            .y_desc(self.measure.name)
            .x_label_formatter(&|v| tick(*v))
            .y_label_formatter(&|v| axes.label(*v))
            .draw()?;
        // In nested areas, pixels count from the corner of the whole chart.
        let (left, top) = panel.get_base_pixel();
        let place = |at: &(f64, f64)| {
            let (x, y) = chart.backend_coord(at);
            (x - left, y - top)
        };
        for series in &SERIES {
            let points = self.points(series);
            let places: Vec<_> = points.iter().map(|(at, _)| place(at)).collect();
            let line = series.colour.stroke_width(scale as u32);
            panel.draw(&PathElement::new(places.clone(), line))?;
            for (at, (_, label)) in places.into_iter().zip(&points) {
                mark(panel, at, series, scale)?;
                let at = (at.0 + 5 * scale, at.1 - 13 * scale);
                panel.draw_text(label, &text(10, scale).color(&series.colour), at)?;
            }
        }
        // Digits at increasing heights stay legible next to each other.
        for (digit, (codec, _)) in (1..).zip(PEERS) {
            let peer = self.rows.iter().find(|row| row.codec == codec);
            let Some(row) = peer else { continue };
            let (x, y) = place(&(row.bits_per_event, axes.zero));
            let style = INK.stroke_width(scale as u32);
            let step = (12 + 13 * (digit - 1)) * scale;
            panel.draw(&PathElement::new([(x, y), (x, y - step)], style))?;
            let at = (x - 4 * scale, y - step - 12 * scale);
            panel.draw_text(&digit.to_string(), &text(11, scale), at)?;
        }
        for (line, (codec, setting, name)) in (0..).zip(ARRAYS) {
            let mut rows = self.rows.iter();
            let row = rows.find(|row| row.codec == codec && row.setting == setting);
            let Some((row, error)) = row.and_then(|row| Some((row, (self.measure.of)(row)?)))
            else {
                continue;
            };
            let error = error.clamp(axes.zero, axes.errors.1);
            if row.bits_per_event < axes.bits.1 {
                let at = place(&(row.bits_per_event, error));
                panel.draw(&TriangleMarker::new(at, 5 * scale, BROWN.filled()))?;
                // The label is on the left, since arrays are near the right border.
                let width = 8 * name.len() as i32 * scale;
                let at = (at.0 - 6 * scale - width, at.1 - 4 * scale);
                panel.draw_text(name, &text(10, scale).color(&BROWN), at)?;
                continue;
            }
            let label = format!("{name}: {} bits >", figure(row.bits_per_event));
            let (x, y) = place(&(axes.bits.1, axes.errors.1));
            let at = (
                x - 8 * label.len() as i32 * scale,
                y + (3 + 14 * line) * scale,
            );
            panel.draw_text(&label, &text(11, scale).color(&BROWN), at)?;
        }
        Ok(())
    }

    /// Returns the points of a series with their labels, in order of the rates.
    fn points(&self, series: &Series) -> Vec<((f64, f64), String)> {
        let mut points: Vec<_> = self
            .rows
            .iter()
            .filter(|row| row.codec == series.codec)
            .filter(|row| row.setting.ends_with("bins") == series.is_bins)
            .filter_map(|row| {
                let error = (self.measure.of)(row)?.max(self.axes.zero);
                let m = row.setting.strip_prefix("M = ").unwrap_or_default();
                Some(((row.bits_per_event, error), m.to_owned()))
            })
            .collect();
        points.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        points
    }
}

/// Formats a rate at a grid line; only labels that have room beside each other are not empty.
pub(super) fn tick(bits: f64) -> String {
    let digit = bits / 10_f64.powf((bits.log10() + 1e-9).floor());
    if [1.0, 2.0, 5.0]
        .iter()
        .any(|label| (digit - label).abs() < 1e-6)
    {
        format!("{}", (bits * 1e3).round() / 1e3)
    } else {
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(recording: &str, codec: &'static str, setting: &str, bits: f64, error: f64) -> Row {
        Row {
            recording: recording.to_owned(),
            codec,
            setting: setting.to_owned(),
            events: 1,
            bits_per_event: bits,
            emd_pixel_us: Some(error),
            mse: None,
            ssim: None,
            volume_nmse: Some(error),
            coefficients_nmse: None,
            seconds: 1.0,
            decode_seconds: None,
        }
    }

    #[test]
    fn every_series_is_drawn_in_its_colour() {
        let rows = [
            row("a", "hybrid-dense", "lossless", 15.0, 0.0),
            row("a", "hybrid-dense", "50 us", 9.0, 25.0),
            row("a", "hybrid-dense", "8 bins", 4.0, 999.0),
            row("a", "transform-dct", "M = 16", 40.0, 70.0),
            row("a", "evt2", "lossless", 33.0, 0.0),
            row("a", "tore", "u8", 4000.0, 0.3),
        ];
        let svg = svg("title", &rows).unwrap();
        let count = |tag: &str, colour: &str| {
            let found = |line: &&str| line.starts_with(tag) && line.contains(colour);
            svg.lines().filter(found).count()
        };
        // In two panels, and in the legend.
        assert_eq!(count("<circle", "#0072B2"), 2 * 2 + 1);
        assert_eq!(count("<polygon", "#0072B2"), 2 + 1);
        assert_eq!(count("<circle", "#D55E00"), 2 + 1);
        assert!(svg.contains("TORE u8: 4,000 bits &gt;"), "{svg}");
        assert!(svg.contains("</svg>") && !svg.contains("NaN"));
        let picture = picture("title", &rows).unwrap();
        assert_eq!((picture.width(), picture.height()), (2400, 2 * 882));
        let is_there =
            |colour| (0..2400).any(|x| (200..1764).any(|y| picture.pixel(x, y) == Some(colour)));
        assert!(is_there([213, 94, 0]) && is_there([0, 114, 178]) && !is_there([230, 159, 0]));
    }

    #[test]
    fn three_recordings_are_drawn_the_preferred_ones_first() {
        let names = ["a", "imx636_sparse_evt3", "b", "gen3_vga_dense_evt2", "c"];
        let rows = names.map(|name| row(name, "evt2", "lossless", 33.0, 0.0));
        let expected = ["gen3_vga_dense_evt2", "imx636_sparse_evt3", "a"];
        assert_eq!(shown(&rows), expected);
    }

    #[test]
    fn labels_are_1_2_and_5_times_powers_of_ten() {
        let cases = [0.5, 0.7, 1.0, 2.0, 3.0, 20.0, 60.0, 500.0].map(tick);
        assert_eq!(cases, ["0.5", "", "1", "2", "", "20", "", "500"]);
    }

    #[test]
    fn extremes_are_drawn_or_refused() {
        assert!(svg("no point", &[]).unwrap().contains("</svg>"));
        picture("one", &[row("a", "evt2", "lossless", 33.0, 0.0)]).unwrap();
        for (bits, error) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, f64::NAN), (1.0, -1.0)] {
            assert!(svg("wrong", &[row("a", "evt2", "x", bits, error)]).is_err());
        }
    }
}
