//! Charts of run time against error of every kernel: one row of panels per target, one panel per transform.
//!
//! Both axes are logarithmic. A kernel has a colour of the Okabe-Ito set and a point for each M. Points on the
//! Pareto front of their M are filled, and a line joins the points of one front. An error of 0 is drawn at the
//! foot.

use anyhow::{Result, anyhow, ensure};
use eecvs_bench::Row;
use event_pictures::picture::Picture;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::picture_backend::PictureBackend;

const WIDTH: u32 = 1200;
/// Height of title and legend.
const HEAD: u32 = 62;
/// Height of a row of panels.
const ROW: u32 = 458;
/// Pixels of the PNG per pixel of the SVG.
pub(super) const PNG_SCALE: i32 = 2;

pub(super) const INK: RGBColor = RGBColor(50, 50, 50);
pub(super) const GRID: RGBColor = RGBColor(228, 228, 228);
pub(super) const FRONT: RGBColor = RGBColor(140, 140, 140);
pub(super) const COLOURS: [(&str, RGBColor); 9] = [
    ("table", RGBColor(0, 114, 178)),
    ("recurrence", RGBColor(213, 94, 0)),
    ("precise", RGBColor(0, 158, 115)),
    ("micromath", RGBColor(230, 159, 0)),
    ("libm", RGBColor(204, 121, 167)),
    ("haar", RGBColor(86, 180, 233)),
    ("oracle-f64", RGBColor(0, 0, 0)),
    ("binning-fft", RGBColor(130, 130, 130)),
    ("voxel-bilinear", VOXEL),
];
const VOXEL: RGBColor = RGBColor(150, 110, 60);
/// Targets and the headings of their panels.
const TARGETS: [(&str, &str); 3] = [
    ("host", "host"),
    ("cortex-m4", "Cortex-M4"),
    ("cortex-m7", "Cortex-M7"),
];
const PANELS: [(&str, &str); 3] = [("dct", "DCT"), ("dtft", "DTFT"), ("dwt", "Haar DWT")];

/// Draws the chart as SVG text.
///
/// # Errors
/// Fails if a cost is not above 0, or an error is not a number.
pub fn svg(title: &str, rows: &[Row]) -> Result<String> {
    let targets = targets(rows)?;
    let mut svg = String::new();
    {
        let size = (WIDTH, height(&targets));
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area, title, &targets, 1)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(svg)
}

/// Draws the chart as a picture.
///
/// # Errors
/// Fails as [`svg`] does.
pub fn picture(title: &str, rows: &[Row]) -> Result<Picture> {
    let targets = targets(rows)?;
    let side = |side: u32| side as usize * PNG_SCALE as usize;
    let mut picture = Picture::new(side(WIDTH), side(height(&targets)), [255; 3]);
    {
        let area = PictureBackend(&mut picture).into_drawing_area();
        draw(&area, title, &targets, PNG_SCALE)
            .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
    }
    Ok(picture)
}

/// A target and its rows.
struct Target<'r> {
    name: &'static str,
    rows: Vec<&'r Row>,
    axes: Axes,
}

/// Returns the targets that have rows; if none has, the first of all.
fn targets(rows: &[Row]) -> Result<Vec<Target<'_>>> {
    let mut targets = Vec::new();
    for (target, name) in TARGETS {
        let here: Vec<&Row> = rows.iter().filter(|row| row.target == target).collect();
        if here.is_empty() && !(rows.is_empty() && targets.is_empty()) {
            continue;
        }
        targets.push(Target {
            name,
            axes: Axes::new(&here)?,
            rows: here,
        });
    }
    Ok(targets)
}

fn height(targets: &[Target<'_>]) -> u32 {
    HEAD + ROW * targets.len() as u32
}

/// Ends of both axes.
#[derive(Debug, Clone, Copy)]
struct Axes {
    costs: (f64, f64),
    errors: (f64, f64),
    /// Error at which 0 is drawn.
    zero: f64,
}

impl Axes {
    fn new(rows: &[&Row]) -> Result<Self> {
        let (mut costs, mut errors) = ((f64::INFINITY, 0.0_f64), (f64::INFINITY, 0.0_f64));
        for row in rows {
            ensure!(
                row.cost.is_finite() && row.cost > 0.0,
                "{} costs {}",
                row.kernel,
                row.cost
            );
            costs = (costs.0.min(row.cost), costs.1.max(row.cost));
            if let Some(error) = row.max_error {
                ensure!(
                    error.is_finite() && error >= 0.0,
                    "{} has an error of {error}",
                    row.kernel
                );
                if error > 0.0 {
                    errors = (errors.0.min(error), errors.1.max(error));
                }
            }
        }
        // Default axes if there are no points.
        if costs.1 == 0.0 {
            costs = (1.0, 100.0);
        }
        if errors.1 == 0.0 {
            errors = (1e-8, 1.0);
        }
        // On a grid line of its own.
        let zero = 10_f64.powf(errors.0.log10().floor() - 1.0);
        Ok(Self {
            costs: (costs.0 / 1.6, costs.1 * 2.0),
            errors: (zero / 3.0, errors.1 * 5.0),
            zero,
        })
    }

    fn error(&self, row: &Row) -> Option<f64> {
        row.max_error.map(|error| error.max(self.zero))
    }

    /// Formats the label of an error.
    fn label(&self, error: f64) -> String {
        if (error / self.zero - 1.0).abs() < 1e-6 {
            "0".to_owned()
        } else {
            power(error)
        }
    }
}

pub(super) fn colour(kernel: &str) -> RGBColor {
    let known = COLOURS.iter().find(|(name, _)| *name == kernel);
    known.map_or(INK, |(_, colour)| *colour)
}

pub(super) fn text(size: i32, scale: i32) -> TextStyle<'static> {
    ("sans-serif", size * scale).into_font().color(&INK)
}

/// Formats a power of ten; any other value gives an empty text.
pub(super) fn power(value: f64) -> String {
    let log10 = value.log10();
    let whole = log10.round();
    if (log10 - whole).abs() > 1e-6 {
        return String::new();
    }
    if (0.0..=4.0).contains(&whole) {
        format!("{:.0}", 10_f64.powf(whole))
    } else {
        format!("1e{whole:.0}")
    }
}

pub(super) type Drawn<B> =
    std::result::Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

fn draw<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    targets: &[Target<'_>],
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    let (head, mut rest) = area.split_vertically(HEAD as i32 * scale);
    head.draw_text(title, &text(14, scale), (14 * scale, 10 * scale))?;
    let names = COLOURS.iter().map(|(name, _)| *name);
    let here = names.filter(|name| {
        let mut rows = targets.iter().flat_map(|target| &target.rows);
        rows.any(|row| row.kernel == *name)
    });
    let entries: Vec<_> = here.map(|name| (name, name.to_owned())).collect();
    legend(&head, &entries, 46, (12, scale))?;
    for target in targets {
        let panels;
        (panels, rest) = rest.split_vertically(ROW as i32 * scale);
        for (panel, transform) in panels.split_evenly((1, 3)).iter().zip(PANELS) {
            draw_panel(panel, transform, target, scale)?;
        }
    }
    area.present()
}

/// Draws the legend in a row at height `y`: kernels and their labels.
pub(super) fn legend<B: DrawingBackend>(
    head: &DrawingArea<B, Shift>,
    entries: &[(&str, String)],
    y: i32,
    (size, scale): (i32, i32),
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let (mut x, y) = (20 * scale, y * scale);
    for (name, label) in entries {
        let (radius, style) = (5 * scale, colour(name).filled());
        if *name == "voxel-bilinear" {
            head.draw(&TriangleMarker::new((x, y), radius, style))?;
        } else {
            head.draw(&Circle::new((x, y), radius, style))?;
        }
        let at = (x + 10 * scale, y - size / 2 * scale);
        head.draw_text(label, &text(size, scale), at)?;
        x += (30 + 3 * size * label.len() as i32 / 4) * scale;
    }
    Ok(())
}

fn draw_panel<B: DrawingBackend>(
    panel: &DrawingArea<B, Shift>,
    (transform, name): (&str, &str),
    target: &Target<'_>,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let Target { rows, axes, .. } = target;
    let unit = rows.first().map_or("ns/event", |row| row.unit);
    let mut chart = ChartBuilder::on(panel)
        .caption(format!("{name}, {}", target.name), text(14, scale))
        .margin(8 * scale)
        .margin_right(16 * scale)
        .x_label_area_size(40 * scale)
        .y_label_area_size(60 * scale)
        .build_cartesian_2d(
            (axes.costs.0..axes.costs.1).log_scale(),
            (axes.errors.0..axes.errors.1).log_scale(),
        )?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(FRONT)
        .label_style(text(12, scale))
        .axis_desc_style(text(13, scale))
        .x_desc(unit)
        .y_desc("largest error of a coefficient")
        .x_label_formatter(&|v| power(*v))
        .y_label_formatter(&|v| axes.label(*v))
        .draw()?;
    let here = || rows.iter().filter(|row| row.transform == transform);
    let mut ms: Vec<u8> = here().map(|row| row.m).collect();
    ms.sort_unstable();
    ms.dedup();
    for m in ms {
        let mut front: Vec<_> = here()
            .filter(|row| row.m == m && row.pareto)
            .filter_map(|row| Some((row.cost, axes.error(row)?)))
            .collect();
        front.sort_by(|a, b| a.0.total_cmp(&b.0));
        let line = FRONT.stroke_width(scale as u32);
        chart.draw_series(LineSeries::new(front, line))?;
    }
    for row in here() {
        let Some(error) = axes.error(row) else {
            continue;
        };
        let (at, colour) = ((row.cost, error), colour(row.kernel));
        // A white disc below a ring hides the line inside it.
        chart.draw_series([Circle::new(at, 4 * scale, WHITE.filled())])?;
        let style = if row.pareto {
            colour.filled()
        } else {
            colour.stroke_width(scale as u32)
        };
        chart.draw_series([Circle::new(at, 4 * scale, style)])?;
        let (x, y) = chart.backend_coord(&at);
        let (left, top) = panel.get_base_pixel();
        let label = text(12, scale).color(&colour);
        let at = (x - left + 5 * scale, y - top - 14 * scale);
        panel.draw_text(&row.m.to_string(), &label, at)?;
    }
    // Methods without an error are drawn at the foot.
    for row in rows.iter().filter(|row| row.transform == "none") {
        let at = (row.cost, axes.errors.0);
        chart.draw_series([TriangleMarker::new(at, 4 * scale, VOXEL.filled())])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(kernel: &'static str, m: u8, cost: f64, max_error: Option<f64>) -> Row {
        Row {
            kernel,
            transform: if max_error.is_some() { "dct" } else { "none" },
            m,
            target: "host",
            window: "all".into(),
            cost,
            unit: "ns/event",
            cost_low: cost,
            cost_high: cost,
            max_error,
            rms_error: max_error,
            pareto: kernel == "table",
            is_crowded: false,
            events: 1,
            coefficients: 1,
        }
    }

    #[test]
    fn every_point_is_drawn_in_its_colour() {
        let rows = [
            row("table", 8, 3.0, Some(1e-4)),
            row("table", 16, 7.0, Some(2e-4)),
            row("micromath", 8, 9.0, Some(1e-2)),
            row("oracle-f64", 8, 900.0, Some(0.0)),
            row("voxel-bilinear", 8, 2.0, None),
        ];
        let svg = svg("title", &rows).unwrap();
        let dots = |colour: &str| {
            let circle = |line: &&str| line.starts_with("<circle") && line.contains(colour);
            svg.lines().filter(circle).count()
        };
        // The legend has one more of each.
        assert_eq!(dots("#0072B2"), 3);
        assert_eq!(dots("#E69F00"), 2);
        assert!(svg.contains("</svg>") && !svg.contains("NaN"));
        let picture = picture("title", &rows).unwrap();
        assert_eq!(picture.width(), 2400);
        let has =
            |colour| (0..2400).any(|x| (0..1040).any(|y| picture.pixel(x, y) == Some(colour)));
        assert!(has([0, 114, 178]) && has([230, 159, 0]) && !has([213, 94, 0]));
    }

    #[test]
    fn every_target_has_its_panels() {
        let mcu = Row {
            target: "cortex-m4",
            unit: "instructions/event",
            ..row("table", 8, 3000.0, Some(1e-4))
        };
        let rows = [row("table", 8, 3.0, Some(1e-4)), mcu];
        let svg = svg("title", &rows).unwrap();
        for text in [
            "DCT, host",
            "DCT, Cortex-M4",
            "ns/event",
            "instructions/event",
        ] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("Cortex-M7"));
        let height = |rows: &[Row]| picture("title", rows).unwrap().height();
        assert_eq!(height(&rows), 2 * (62 + 2 * 458));
        assert_eq!(height(&rows[1..]), 2 * (62 + 458));
    }

    #[test]
    fn extremes_are_drawn_or_refused() {
        assert!(svg("no point", &[]).unwrap().contains("</svg>"));
        picture("one", &[row("table", 8, 1.0, Some(0.0))]).unwrap();
        for (cost, error) in [(0.0, 1.0), (f64::NAN, 1.0), (1.0, f64::NAN), (1.0, -1.0)] {
            assert!(svg("wrong", &[row("table", 8, cost, Some(error))]).is_err());
        }
    }

    #[test]
    fn labels_are_powers_of_ten() {
        let cases = [
            (1.0, "1"),
            (100.0, "100"),
            (1e-5, "1e-5"),
            (3.0, ""),
            (1e7, "1e7"),
        ];
        for (value, label) in cases {
            assert_eq!(power(value), label);
        }
    }
}
