//! Charts of the error per event of every kernel over k, n and T: one column per axis, one row per transform that
//! has errors.
//!
//! All axes are logarithmic. A kernel has the same colour as in [`super::kernel_chart`]: its curve with dots is the
//! largest error, the thin curve the root mean square, and the dashed line its documented bound. Errors of 0, or
//! far below every bound, are drawn at the foot.

use anyhow::{Result, anyhow, ensure};
use eecvs_bench::errors::{AXES, Row};
use event_pictures::picture::Picture;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::kernel_chart::{Drawn, FRONT, GRID, PNG_SCALE, colour, legend, power, text};
use super::picture_backend::PictureBackend;

const WIDTH: u32 = 1040;
const HEAD_HEIGHT: u32 = 104;
const PANEL_HEIGHT: u32 = 300;
/// Number of dashes in the line of a bound.
const DASHES: usize = 36;

/// Draws the chart as SVG text.
///
/// # Errors
/// Fails if an error or a bound is negative or not finite.
pub fn svg(rows: &[Row]) -> Result<String> {
    let layout = Layout::new(rows)?;
    let mut svg = String::new();
    {
        let size = (WIDTH, layout.height());
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area, rows, &layout, 1)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(svg)
}

/// Draws the chart as a picture.
///
/// # Errors
/// Fails as [`svg`] does.
pub fn picture(rows: &[Row]) -> Result<Picture> {
    let layout = Layout::new(rows)?;
    let side = |side: u32| side as usize * PNG_SCALE as usize;
    let mut picture = Picture::new(side(WIDTH), side(layout.height()), [255; 3]);
    {
        let area = PictureBackend(&mut picture).into_drawing_area();
        draw(&area, rows, &layout, PNG_SCALE)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(picture)
}

/// What all panels share.
struct Layout {
    /// Transforms that have an error somewhere.
    drawn: Vec<&'static str>,
    /// Their kernels, with the bounds.
    bounds: Vec<(&'static str, f64)>,
    /// Kernels without any error.
    exact: Vec<&'static str>,
    /// Ends of the error axis.
    errors: (f64, f64),
    /// Error at which 0 and all smaller errors are drawn.
    foot: f64,
}

impl Layout {
    fn new(rows: &[Row]) -> Result<Self> {
        let (mut drawn, mut bounds, mut exact) = (Vec::new(), Vec::new(), Vec::new());
        let (mut least_bound, mut most) = (f64::INFINITY, 0.0_f64);
        for row in rows {
            for error in [row.max_error_per_event, row.rms_error_per_event, row.bound] {
                ensure!(
                    error.is_finite() && error >= 0.0,
                    "{} has an error of {error}",
                    row.kernel
                );
                if error > 0.0 {
                    most = most.max(error);
                    add(&mut drawn, row.transform);
                    add(&mut bounds, (row.kernel, row.bound));
                }
            }
            if row.bound > 0.0 {
                least_bound = least_bound.min(row.bound);
            }
        }
        for row in rows {
            if !bounds.iter().any(|(kernel, _)| *kernel == row.kernel) {
                add(&mut exact, row.kernel);
            }
        }
        let least = if least_bound.is_finite() {
            least_bound
        } else {
            1e-8
        };
        // On a grid line of its own, at least two decades below.
        let foot = 10_f64.powf(least.log10().floor() - 2.0);
        Ok(Self {
            drawn,
            bounds,
            exact,
            errors: (foot / 2.0, most.max(foot * 100.0) * 4.0),
            foot,
        })
    }

    fn height(&self) -> u32 {
        HEAD_HEIGHT + PANEL_HEIGHT * self.drawn.len() as u32
    }

    /// Formats the label of an error.
    fn label(&self, error: f64) -> String {
        if (error / self.foot - 1.0).abs() < 1e-6 {
            format!("<{}", power(error))
        } else {
            power(error)
        }
    }
}

fn add<T: PartialEq>(list: &mut Vec<T>, item: T) {
    if !list.contains(&item) {
        list.push(item);
    }
}

/// Returns name and symbol of an axis.
fn describe(axis: &str) -> (&'static str, &'static str) {
    match axis {
        "k" => ("coefficient", "k"),
        "n" => ("events in one pixel", "n"),
        _ => ("length of the window", "T"),
    }
}

/// Formats a power of ten in the axis's unit.
fn tick(axis: &str, value: f64) -> String {
    if axis != "T" {
        return power(value);
    }
    let units = [(1.0, "1 us"), (1e3, "1 ms"), (1e6, "1 s"), (1e9, "1000 s")];
    let unit = units.iter().find(|(us, _)| (value / us - 1.0).abs() < 1e-6);
    unit.map_or_else(String::new, |(_, name)| (*name).to_owned())
}

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    rows: &[Row],
    layout: &Layout,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    let (head, panels) = area.split_vertically(HEAD_HEIGHT as i32 * scale);
    let exact = if layout.exact.is_empty() {
        String::new()
    } else {
        format!("; {}: 0 everywhere", layout.exact.join(", "))
    };
    let lines = [
        "Error of a coefficient per event: largest (dots), root mean square (thin)".to_owned(),
        format!("dashed: documented bound{exact}"),
    ];
    for (line, y) in lines.iter().zip([10, 34]) {
        head.draw_text(line, &text(16, scale), (14 * scale, y * scale))?;
    }
    let label = |(kernel, bound): &(&'static str, f64)| {
        (*kernel, format!("{kernel}, 2^{:.0}", bound.log2()))
    };
    let entries: Vec<_> = layout.bounds.iter().map(label).collect();
    legend(&head, &entries, 78, (16, scale))?;
    if layout.drawn.is_empty() {
        return area.present();
    }
    let panels = panels.split_evenly((layout.drawn.len(), AXES.len()));
    let places = layout
        .drawn
        .iter()
        .flat_map(|transform| AXES.map(|axis| (*transform, axis)));
    for (panel, (transform, axis)) in panels.iter().zip(places) {
        let here: Vec<&Row> = rows
            .iter()
            .filter(|row| row.transform == transform && row.axis == axis)
            .collect();
        draw_panel(panel, (transform, axis), &here, layout, scale)?;
    }
    area.present()
}

fn draw_panel<B: DrawingBackend>(
    panel: &DrawingArea<B, Shift>,
    (transform, axis): (&str, &str),
    rows: &[&Row],
    layout: &Layout,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let values = rows.iter().map(|row| f64::from(row.value));
    let last = values.fold(1.0, f64::max);
    let (first, last) = (0.8, last * 1.25);
    let (name, symbol) = describe(axis);
    let mut chart = ChartBuilder::on(panel)
        .caption(
            format!("{}: {name}", transform.to_uppercase()),
            text(16, scale),
        )
        .margin(6 * scale)
        .margin_right(14 * scale)
        .x_label_area_size(40 * scale)
        .y_label_area_size(52 * scale)
        .build_cartesian_2d(
            (first..last).log_scale(),
            (layout.errors.0..layout.errors.1).log_scale(),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(FRONT)
        .label_style(text(14, scale))
        .axis_desc_style(text(15, scale))
        .x_desc(symbol)
        .x_label_formatter(&|value| tick(axis, *value))
        .y_label_formatter(&|error| layout.label(*error))
        .draw()?;
    // Kernels that share a bound take turns in the dashes of its line.
    let here = |kernel: &str| rows.iter().any(|row| row.kernel == kernel);
    for (kernel, bound) in &layout.bounds {
        let same: Vec<_> = layout
            .bounds
            .iter()
            .filter(|(kernel, other)| other == bound && here(kernel))
            .collect();
        let Some(turn) = same.iter().position(|(other, _)| other == kernel) else {
            continue;
        };
        let at = |part: f64| {
            let x = first * (last / first).powf(part / DASHES as f64);
            (x, *bound)
        };
        let style = colour(kernel).stroke_width(scale as u32);
        chart.draw_series((turn..DASHES).step_by(same.len()).map(|dash| {
            let dash = dash as f64;
            PathElement::new([at(dash), at(dash + 0.6)], style)
        }))?;
    }
    for (kernel, _) in &layout.bounds {
        let rows = rows.iter().filter(|row| row.kernel == *kernel);
        let point = |row: &Row, error: f64| (f64::from(row.value), error.max(layout.foot));
        let colour = colour(kernel);
        let thin = rows.clone().map(|row| point(row, row.rms_error_per_event));
        chart.draw_series(LineSeries::new(thin, colour.stroke_width(scale as u32)))?;
        let most: Vec<_> = rows
            .map(|row| point(row, row.max_error_per_event))
            .collect();
        let line = colour.stroke_width(2 * scale as u32);
        chart.draw_series(LineSeries::new(most.iter().copied(), line))?;
        let dot = |at: &(f64, f64)| Circle::new(*at, 2 * scale, colour.filled());
        chart.draw_series(most.iter().map(dot))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kernel: &'static str, axis: &'static str, value: u32, error: f64, bound: f64) -> Row {
        Row {
            kernel,
            transform: if bound > 0.0 { "dct" } else { "dwt" },
            axis,
            value,
            max_error_per_event: error,
            rms_error_per_event: error / 2.0,
            bound,
        }
    }

    #[test]
    fn every_curve_is_drawn_in_its_colour_and_what_has_no_error_is_named() {
        let mut rows = Vec::new();
        for axis in AXES {
            for value in [1, 10, 1000] {
                rows.push(row("table", axis, value, 1e-5, 6.1e-5));
                rows.push(row("libm", axis, value, 1e-6, 6.1e-5));
                rows.push(row("haar", axis, value, 0.0, 0.0));
            }
        }
        let svg = svg(&rows).unwrap();
        let count = |shape: &str, colour: &str| {
            let is_one = |line: &&str| line.starts_with(shape) && line.contains(colour);
            svg.lines().filter(is_one).count()
        };
        // Three points in each of three panels, and one in the legend.
        for colour in ["#0072B2", "#CC79A7"] {
            assert_eq!(count("<circle", colour), 10);
            // Two curves, and half of the dashes of the bound that both kernels share.
            assert_eq!(count("<polyline", colour), 3 * (2 + DASHES / 2));
        }
        assert_eq!(count("<circle", "#56B4E9"), 0);
        for text in [
            "haar: 0 everywhere",
            "table, 2^-14",
            "DCT: coefficient",
            "1 ms",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("NaN") && !svg.contains("DWT:"));
        let picture = picture(&rows).unwrap();
        assert_eq!((picture.width(), picture.height()), (2080, 808));
    }

    #[test]
    fn extremes_are_drawn_or_refused() {
        assert!(svg(&[]).unwrap().contains("</svg>"));
        picture(&[row("haar", "k", 1, 0.0, 0.0)]).unwrap();
        picture(&[row("table", "T", 1, 0.0, 1e-4)]).unwrap();
        for error in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(svg(&[row("table", "k", 1, error, 1e-4)]).is_err());
        }
    }
}
