//! Charts of bits against speed, of what is lossless: one column per recording, for three recordings; one panel for
//! encoding and one for decoding. Both axes are logarithmic; the best is on the lower right. Digits stand for codecs, in
//! the order of the tables.

use anyhow::{Result, ensure};
use plotters::coord::Shift;
use plotters::prelude::*;

use super::kernel_chart::{Drawn, FRONT, GRID, text};
use super::rate_chart::{COLUMNS, shown, tick};
use super::rate_table::LOSSLESS;
use super::sheet::{Chart, Sheet};
use crate::rate::Row;

const WIDTH: u32 = 1200;
/// Height of title and legend.
const HEAD: u32 = 76;
/// Height of a row of panels.
const ROW: u32 = 400;

const OURS: RGBColor = RGBColor(0, 114, 178);
const PEERS: RGBColor = RGBColor(150, 90, 30);

/// A direction: its name and its time.
type Direction = (&'static str, fn(&Row) -> Option<f64>);

const DIRECTIONS: [Direction; 2] = [
    ("encoded, millions of events a second", |row| {
        Some(row.seconds)
    }),
    ("decoded, millions of events a second", |row| {
        row.decode_seconds
    }),
];

/// A codec of a panel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    mev_per_s: f64,
    bits: f64,
    /// Its place in the tables, from 1 on.
    digit: usize,
    colour: RGBColor,
}

fn colour(codec: &str) -> RGBColor {
    if codec.starts_with("hybrid") {
        OURS
    } else {
        PEERS
    }
}

/// Draws the chart.
///
/// # Errors
/// Fails if a rate or a time is not above 0.
pub fn sheet(title: &str, rows: &[Row]) -> Result<Sheet> {
    Sheet::new(&Speeds {
        title,
        panels: panels(rows)?,
    })
}

struct Speeds<'r> {
    title: &'r str,
    panels: Vec<Panel<'r>>,
}

/// A panel: recording, name of the direction, points.
type Panel<'r> = (&'r str, &'static str, Vec<Point>);

/// Returns the panels, row by row.
fn panels(rows: &[Row]) -> Result<Vec<Panel<'_>>> {
    let mut panels = Vec::new();
    for (direction, seconds) in DIRECTIONS {
        for recording in shown(rows) {
            let here = || {
                rows.iter()
                    .filter(|row| row.recording == recording && row.setting == "lossless")
            };
            let mut points = Vec::new();
            for (digit, (codec, _)) in (1..).zip(LOSSLESS) {
                let Some(row) = here().find(|row| row.codec == codec) else {
                    continue;
                };
                let Some(seconds) = seconds(row) else {
                    continue;
                };
                let (bits, mev_per_s) = (row.bits_per_event, row.events as f64 / seconds / 1e6);
                ensure!(
                    bits > 0.0 && mev_per_s > 0.0 && bits.is_finite() && mev_per_s.is_finite(),
                    "{codec} takes {bits} bits and {seconds} s"
                );
                points.push(Point {
                    mev_per_s,
                    bits,
                    digit,
                    colour: colour(codec),
                });
            }
            panels.push((recording, direction, points));
        }
    }
    Ok(panels)
}

impl Chart for Speeds<'_> {
    fn size(&self) -> (u32, u32) {
        (WIDTH, HEAD + DIRECTIONS.len() as u32 * ROW)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        area.fill(&WHITE)?;
        let (head, rest) = area.split_vertically(HEAD as i32 * scale);
        head.draw_text(self.title, &text(14, scale), (14 * scale, 10 * scale))?;
        let half = LOSSLESS.len().div_ceil(2);
        for (line, codecs) in LOSSLESS.chunks(half).enumerate() {
            let mut x = 14;
            for (digit, (codec, name)) in (half * line + 1..).zip(codecs) {
                let label = format!("{digit} {name}");
                let at = (x * scale, (34 + 18 * line as i32) * scale);
                head.draw_text(&label, &text(12, scale).color(&colour(codec)), at)?;
                x += 22 + 9 * label.len() as i32;
            }
        }
        let columns = (self.panels.len() / DIRECTIONS.len()).clamp(1, COLUMNS);
        let areas = rest.split_evenly((DIRECTIONS.len(), columns));
        for (panel, area) in self.panels.iter().zip(&areas) {
            draw_panel(area, panel, scale)?;
        }
        area.present()
    }
}

fn draw_panel<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    (recording, direction, points): &Panel<'_>,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let ends = |of: fn(&Point) -> f64| {
        points
            .iter()
            .map(of)
            .fold((f64::INFINITY, 0.0_f64), |(low, high), value| {
                (low.min(value), high.max(value))
            })
    };
    let (mut speeds, mut bits) = (ends(|point| point.mev_per_s), ends(|point| point.bits));
    if points.is_empty() {
        (speeds, bits) = ((1.0, 100.0), (1.0, 100.0));
    }
    let mut chart = ChartBuilder::on(area)
        .caption(*recording, text(14, scale))
        .margin(8 * scale)
        .margin_right(16 * scale)
        .x_label_area_size(40 * scale)
        .y_label_area_size(60 * scale)
        .build_cartesian_2d(
            (speeds.0 / 2.0..speeds.1 * 2.0).log_scale(),
            (bits.0 / 1.2..bits.1 * 1.2).log_scale(),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(FRONT)
        .label_style(text(11, scale))
        .axis_desc_style(text(12, scale))
        .x_desc(*direction)
        .y_desc("bits per event")
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .draw()?;
    let (left, top) = area.get_base_pixel();
    let mut drawn: Vec<(i32, i32)> = Vec::new();
    for point in points {
        let (x, y) = chart.backend_coord(&(point.mev_per_s, point.bits));
        let (x, y) = (x - left, y - top);
        area.draw(&Circle::new((x, y), 4 * scale, point.colour.filled()))?;
        // A digit that would lie on another one goes below it.
        let (digit_x, mut digit_y) = (x + 6 * scale, y - 12 * scale);
        let is_taken = |(at, line): &(i32, i32), digit_y: i32| {
            (digit_x - at).abs() < 18 * scale && (digit_y - line).abs() < 11 * scale
        };
        while drawn.iter().any(|other| is_taken(other, digit_y)) {
            digit_y += 11 * scale;
        }
        drawn.push((digit_x, digit_y));
        let style = text(11, scale).color(&point.colour);
        area.draw_text(&point.digit.to_string(), &style, (digit_x, digit_y))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(codec: &'static str, bits: f64, seconds: f64, decode_seconds: Option<f64>) -> Row {
        Row {
            recording: "a".to_owned(),
            codec,
            setting: "lossless".to_owned(),
            events: 1_000_000,
            bits_per_event: bits,
            emd_pixel_us: None,
            mse: None,
            ssim: None,
            volume_nmse: None,
            coefficients_nmse: None,
            seconds,
            decode_seconds,
        }
    }

    #[test]
    fn ours_and_peers_are_drawn_where_they_were_measured() {
        let rows = [
            row("hybrid-keys", 20.0, 0.01, Some(0.02)),
            row("hybrid-dense", 15.0, 0.1, Some(0.1)),
            row("xz-9", 18.0, 2.0, Some(0.1)),
            row("evt2", 33.0, 0.01, None),
        ];
        let panels = panels(&rows).unwrap();
        let speeds: Vec<Vec<f64>> = panels
            .iter()
            .map(|(.., points)| points.iter().map(|point| point.mev_per_s).collect())
            .collect();
        // In the order of the table.
        assert_eq!(
            speeds,
            [vec![10.0, 100.0, 0.5, 100.0], vec![10.0, 50.0, 10.0]]
        );
        let Sheet { svg, png } = sheet("title", &rows).unwrap();
        let circles = |colour: &str| {
            svg.lines()
                .filter(|line| line.starts_with("<circle") && line.contains(colour))
                .count()
        };
        assert_eq!((circles("#0072B2"), circles("#965A1E")), (4, 3));
        assert!(svg.contains("xz -9") && !svg.contains("NaN"));
        assert_eq!((png.width(), png.height()), (2400, 2 * 876));
    }

    #[test]
    fn extremes_are_drawn_or_refused() {
        assert!(sheet("no point", &[]).unwrap().svg.contains("</svg>"));
        for (bits, seconds) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, 0.0), (1.0, -1.0)] {
            assert!(sheet("wrong", &[row("evt2", bits, seconds, None)]).is_err());
        }
    }
}
