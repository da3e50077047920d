//! Charts of the event density, drawn without system fonts.
//!
//! Regimes have colours of the Okabe-Ito set, which colour-blind readers can distinguish: sparse blue, moderate
//! green, dense vermilion. The density axis is logarithmic if the positive densities and thresholds span a factor
//! of 30 or more; densities of 0 are then drawn at the foot of the axis.

use std::ops::Range;

use anyhow::{Result, ensure};
use plotters::chart::MeshStyle;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::kernel_chart::Drawn;
use super::sheet::{Chart, Sheet};

const WIDTH: u32 = 960;
const HEIGHT: u32 = 420;
/// Largest number of windows that a line chart draws one by one; of more, runs of windows are merged.
const POINTS_MAX: usize = 2000;
const BINS: usize = 48;
/// Ratio of the largest to the least density from which the axis is logarithmic.
const LOGARITHMIC_SPAN: f64 = 30.0;

const INK: RGBColor = RGBColor(50, 50, 50);
const GRID: RGBColor = RGBColor(225, 225, 225);
const LINE: RGBColor = RGBColor(150, 150, 150);
const SPARSE: RGBColor = RGBColor(0, 114, 178);
const MODERATE: RGBColor = RGBColor(0, 158, 115);
const DENSE: RGBColor = RGBColor(213, 94, 0);
const REGIMES: [(&str, RGBColor); 3] =
    [("sparse", SPARSE), ("moderate", MODERATE), ("dense", DENSE)];

/// The two densities that separate the regimes, in events per pixel per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thresholds {
    /// Windows below this density are sparse.
    pub tau_low: f64,
    /// Windows of this density or more are dense.
    pub tau_high: f64,
}

impl Thresholds {
    /// Returns the index of a density's regime: 0 sparse, 1 moderate, 2 dense.
    fn regime(self, density: f64) -> usize {
        usize::from(density >= self.tau_low) + usize::from(density >= self.tau_high)
    }

    fn check(self) -> Result<()> {
        ensure!(
            self.tau_low.is_finite() && self.tau_high.is_finite() && self.tau_low <= self.tau_high,
            "thresholds {} and {} are not finite and in order; calibrate again",
            self.tau_low,
            self.tau_high
        );
        Ok(())
    }
}

/// One window of a line chart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DensityPoint {
    /// Start of the window in seconds, from any origin.
    pub time_s: f64,
    /// Density in events per pixel per second, 0 or more.
    pub density: f64,
}

/// The density axis: linear or logarithmic.
#[derive(Debug, Clone, Copy)]
struct Axis {
    logarithmic: bool,
    /// Ends of the axis, in its own coordinate.
    from: f64,
    to: f64,
}

impl Axis {
    fn new(densities: impl Iterator<Item = f64> + Clone, thresholds: Thresholds) -> Self {
        let marks = densities.chain([thresholds.tau_low, thresholds.tau_high]);
        let greatest = marks.clone().fold(0.0, f64::max);
        let least = marks.filter(|v| *v > 0.0).fold(f64::INFINITY, f64::min);
        if greatest <= 0.0 {
            return Self {
                logarithmic: false,
                from: 0.0,
                to: 1.0,
            };
        }
        if greatest / least < LOGARITHMIC_SPAN {
            return Self {
                logarithmic: false,
                from: 0.0,
                to: greatest * 1.08,
            };
        }
        let (from, to) = (least.log10(), greatest.log10());
        let margin = 0.06 * (to - from);
        Self {
            logarithmic: true,
            from: from - margin,
            to: to + margin,
        }
    }

    fn at(self, density: f64) -> f64 {
        if self.logarithmic {
            density.max(f64::MIN_POSITIVE).log10().max(self.from)
        } else {
            density
        }
    }

    fn label(self, coordinate: f64) -> String {
        let density = if self.logarithmic {
            10_f64.powf(coordinate)
        } else {
            coordinate
        };
        short(density)
    }
}

/// Formats a density with three digits.
fn short(density: f64) -> String {
    if density == 0.0 {
        return "0".to_owned();
    }
    let magnitude = density.abs().log10().floor();
    if !(-3.0..6.0).contains(&magnitude) {
        return format!("{density:.2e}");
    }
    let decimals = (2.0 - magnitude).clamp(0.0, 6.0) as usize;
    let text = format!("{density:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Draws the density per window over time: a line, a dot per window in the colour of its regime, and the two
/// thresholds as dashed lines.
///
/// With more than 2,000 windows, each run of neighbours is merged into its windows of least and greatest density,
/// so that the file stays small and no peak is lost. Without windows, the axes are empty.
///
/// # Errors
/// Fails if a time, density or threshold is not finite, or a density is negative.
pub fn density_over_time(
    title: &str,
    windows: &[DensityPoint],
    thresholds: Thresholds,
) -> Result<Sheet> {
    thresholds.check()?;
    for (i, w) in windows.iter().enumerate() {
        ensure!(w.time_s.is_finite(), "window {i} starts at {} s", w.time_s);
        check_density(i, w.density)?;
    }
    let points = merged(windows);
    let axis = Axis::new(points.iter().map(|p| p.density), thresholds);
    let first = windows
        .iter()
        .map(|w| w.time_s)
        .fold(f64::INFINITY, f64::min);
    let last = windows
        .iter()
        .map(|w| w.time_s)
        .fold(f64::NEG_INFINITY, f64::max);
    let (first, last) = if first < last {
        (first, last)
    } else {
        (first.min(0.0), first.min(0.0) + 1.0)
    };
    Sheet::new(&OverTime {
        title,
        points,
        axis,
        thresholds,
        span: (first, last),
    })
}

/// The chart of [`density_over_time`].
struct OverTime<'c> {
    title: &'c str,
    points: Vec<DensityPoint>,
    axis: Axis,
    thresholds: Thresholds,
    /// First and last time in seconds.
    span: (f64, f64),
}

impl Chart for OverTime<'_> {
    fn size(&self) -> (u32, u32) {
        (WIDTH, HEIGHT)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        let Self {
            title,
            points,
            axis,
            thresholds,
            span: (first, last),
        } = self;
        let (axis, thresholds, first, last) = (*axis, *thresholds, *first, *last);
        let mut chart = framed(area, title, [first..last, axis.from..axis.to], scale)?;
        mesh(&mut chart, scale)
            .x_desc("time (s)")
            .y_desc("events per pixel per second")
            .y_label_formatter(&|v| axis.label(*v))
            .x_label_formatter(&|v| short(*v))
            .draw()?;
        let line = points.iter().map(|p| (p.time_s, axis.at(p.density)));
        chart.draw_series(LineSeries::new(line, LINE.stroke_width(scale as u32)))?;
        for (regime, (_, colour)) in REGIMES.iter().enumerate() {
            let radius = scale * if points.len() > 400 { 2 } else { 3 };
            chart.draw_series(
                points
                    .iter()
                    .filter(|p| thresholds.regime(p.density) == regime)
                    .map(|p| Circle::new((p.time_s, axis.at(p.density)), radius, colour.filled())),
            )?;
        }
        for (tau, colour) in [(thresholds.tau_low, SPARSE), (thresholds.tau_high, DENSE)] {
            let ends = [(first, axis.at(tau)), (last, axis.at(tau))];
            chart.draw_series(DashedLineSeries::new(
                ends,
                6 * scale,
                4 * scale,
                colour.stroke_width(scale as u32),
            ))?;
        }
        let heights = [thresholds.tau_low, thresholds.tau_high]
            .map(|tau| chart.backend_coord(&(last, axis.at(tau))));
        let labels = [("tau_low", SPARSE), ("tau_high", DENSE)];
        let taus = [thresholds.tau_low, thresholds.tau_high];
        // Labels of thresholds close to each other are spread apart to stay legible.
        let close = (heights[0].1 - heights[1].1).abs() < 28 * scale;
        for (i, ((name, colour), (x, y))) in labels.iter().zip(heights).enumerate() {
            let shift = match (close, i) {
                (false, _) => -6,
                (true, 0) => 2,
                (true, _) => -26,
            };
            let style = text_style(12 * scale).color(colour);
            area.draw_text(name, &style, (x + 6 * scale, y + (shift - 6) * scale))?;
            area.draw_text(
                &short(taus[i]),
                &style,
                (x + 6 * scale, y + (shift + 6) * scale),
            )?;
        }
        draw_regimes(area, scale)?;
        area.present()
    }
}

/// Draws a histogram of the windows' densities, each bar in the colour of the regime at its middle, and the two
/// thresholds as dashed lines.
///
/// It has 48 bins of equal width on the axis. On a logarithmic axis, densities of 0 count in the first bin. Without
/// windows, the axes are empty.
///
/// # Errors
/// Fails if a density or threshold is not finite, or a density is negative.
pub fn density_histogram(title: &str, densities: &[f64], thresholds: Thresholds) -> Result<Sheet> {
    thresholds.check()?;
    for (i, density) in densities.iter().enumerate() {
        check_density(i, *density)?;
    }
    let axis = Axis::new(densities.iter().copied(), thresholds);
    let bins = histogram(densities, axis);
    let highest = bins.iter().max().copied().unwrap_or(0).max(1) as f64 * 1.12;
    Sheet::new(&Histogram {
        title,
        bins,
        axis,
        thresholds,
        highest,
    })
}

/// The chart of [`density_histogram`].
struct Histogram<'c> {
    title: &'c str,
    bins: [u64; BINS],
    axis: Axis,
    thresholds: Thresholds,
    /// End of the axis of window counts.
    highest: f64,
}

impl Chart for Histogram<'_> {
    fn size(&self) -> (u32, u32) {
        (WIDTH, HEIGHT)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        let Self {
            title,
            bins,
            axis,
            thresholds,
            highest,
        } = self;
        let (axis, thresholds, highest) = (*axis, *thresholds, *highest);
        let bin_width = (axis.to - axis.from) / BINS as f64;
        let mut chart = framed(area, title, [axis.from..axis.to, 0.0..highest], scale)?;
        mesh(&mut chart, scale)
            .disable_x_mesh()
            .x_desc("events per pixel per second")
            .y_desc("windows")
            .x_label_formatter(&|v| axis.label(*v))
            .y_label_formatter(&|v| {
                if v.fract() == 0.0 {
                    format!("{v}")
                } else {
                    String::new()
                }
            })
            .draw()?;
        chart.draw_series(
            bins.iter()
                .enumerate()
                .filter(|(_, n)| **n > 0)
                .map(|(i, n)| {
                    let left = axis.from + i as f64 * bin_width;
                    let middle = left + 0.5 * bin_width;
                    let regime = usize::from(middle >= axis.at(thresholds.tau_low))
                        + usize::from(middle >= axis.at(thresholds.tau_high));
                    let colour = REGIMES.get(regime).map_or(INK, |r| r.1);
                    let corners = [
                        (left + 0.06 * bin_width, 0.0),
                        (left + 0.94 * bin_width, *n as f64),
                    ];
                    Rectangle::new(corners, colour.mix(0.85).filled())
                }),
        )?;
        let taus = [
            ("tau_low", thresholds.tau_low, SPARSE),
            ("tau_high", thresholds.tau_high, DENSE),
        ];
        let places = taus.map(|(_, tau, _)| chart.backend_coord(&(axis.at(tau), highest)));
        for (i, (name, tau, colour)) in taus.iter().enumerate() {
            let ends = [(axis.at(*tau), 0.0), (axis.at(*tau), highest)];
            chart.draw_series(DashedLineSeries::new(
                ends,
                6 * scale,
                4 * scale,
                colour.stroke_width(scale as u32),
            ))?;
            let (x, y) = places[i];
            let label = format!("{name} {}", short(*tau));
            // The lower threshold's label is to the left of its line, so the two never meet. At the left border,
            // where it has no room, it is on the right, one row lower.
            let length = 6 * label.len() as i32 * scale;
            let (dx, dy) = match i {
                0 if x - length > 90 * scale => (-6 * scale - length, 2 * scale),
                0 => (6 * scale, 16 * scale),
                _ => (6 * scale, 2 * scale),
            };
            area.draw_text(
                &label,
                &text_style(12 * scale).color(colour),
                (x + dx, y + dy),
            )?;
        }
        draw_regimes(area, scale)?;
        area.present()
    }
}

fn check_density(window: usize, density: f64) -> Result<()> {
    ensure!(
        density.is_finite() && density >= 0.0,
        "window {window} has a density of {density}"
    );
    Ok(())
}

fn histogram(densities: &[f64], axis: Axis) -> [u64; BINS] {
    let mut bins = [0; BINS];
    for density in densities {
        let place = (axis.at(*density) - axis.from) / (axis.to - axis.from) * BINS as f64;
        // A cast of a negative value gives 0.
        if let Some(bin) = bins.get_mut((place as usize).min(BINS - 1)) {
            *bin += 1;
        }
    }
    bins
}

/// Returns at most [`POINTS_MAX`] points: the least and the greatest of each run of neighbours.
fn merged(windows: &[DensityPoint]) -> Vec<DensityPoint> {
    if windows.len() <= POINTS_MAX {
        return windows.to_vec();
    }
    let run = windows.len().div_ceil(POINTS_MAX / 2);
    let by_density = |a: &&DensityPoint, b: &&DensityPoint| a.density.total_cmp(&b.density);
    windows
        .chunks(run)
        .flat_map(|run| {
            let least = run.iter().min_by(by_density);
            let greatest = run.iter().max_by(by_density);
            let mut ends: Vec<_> = least.into_iter().chain(greatest).copied().collect();
            ends.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            ends
        })
        .collect()
}

fn text_style(size: i32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

/// A chart with numeric axes.
type Axes<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Makes a chart with a title, two axes, and room for labels at the left, the bottom and the right.
fn framed<'a, B: DrawingBackend>(
    area: &'a DrawingArea<B, Shift>,
    title: &str,
    [across, up]: [Range<f64>; 2],
    scale: i32,
) -> std::result::Result<Axes<'a, B>, DrawingAreaErrorKind<B::ErrorType>>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE)?;
    ChartBuilder::on(area)
        .caption(title, text_style(18 * scale))
        .margin(14 * scale)
        .margin_right(110 * scale)
        .x_label_area_size(44 * scale)
        .y_label_area_size(64 * scale)
        .build_cartesian_2d(across, up)
}

/// Sets the lines and labels common to all charts.
fn mesh<'a, 'c, B: DrawingBackend>(
    chart: &'c mut Axes<'a, B>,
    scale: i32,
) -> MeshStyle<'a, 'c, RangedCoordf64, RangedCoordf64, B> {
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(LINE)
        .label_style(text_style(12 * scale))
        .axis_desc_style(text_style(13 * scale));
    mesh
}

/// Draws the names of the regimes, in their colours, at the right border.
fn draw_regimes<B: DrawingBackend>(area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    let x = (WIDTH as i32 - 84) * scale;
    for (i, (name, colour)) in REGIMES.iter().rev().enumerate() {
        let y = (20 + 16 * i as i32) * scale;
        area.draw(&Circle::new((x, y), 4 * scale, colour.filled()))?;
        area.draw_text(
            name,
            &text_style(12 * scale),
            (x + 10 * scale, y - 5 * scale),
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const THRESHOLDS: Thresholds = Thresholds {
        tau_low: 0.5,
        tau_high: 5.0,
    };

    fn points(densities: &[f64]) -> Vec<DensityPoint> {
        let point = |(i, density): (usize, &f64)| DensityPoint {
            time_s: i as f64 * 0.033,
            density: *density,
        };
        densities.iter().enumerate().map(point).collect()
    }

    fn dots(svg: &str, colour: &str) -> usize {
        svg.lines()
            .filter(|line| line.starts_with("<circle") && line.contains(colour))
            .count()
    }

    #[test]
    fn every_window_is_a_dot_of_its_regime() {
        let windows = points(&[0.0, 0.4, 0.5, 4.9, 5.0, 6.0, 700.0]);
        let svg = density_over_time("density", &windows, THRESHOLDS)
            .unwrap()
            .svg;
        // The legend has one more dot per regime.
        assert_eq!(dots(&svg, "#0072B2"), 2 + 1);
        assert_eq!(dots(&svg, "#009E73"), 2 + 1);
        assert_eq!(dots(&svg, "#D55E00"), 3 + 1);
    }

    #[test]
    fn the_histogram_counts_every_window() {
        let densities = [0.0, 0.001, 0.4, 0.5, 4.9, 5.0, 6.0, 700.0];
        let axis = Axis::new(densities.iter().copied(), THRESHOLDS);
        assert!(axis.logarithmic);
        let bins = histogram(&densities, axis);
        assert_eq!(bins.iter().sum::<u64>(), 8);
        assert_eq!(bins[0], 1);
        let narrow = Axis::new([4.0, 6.0].into_iter(), THRESHOLDS);
        assert!(!narrow.logarithmic);
        assert_eq!(histogram(&[0.0, 6.48], narrow)[BINS - 1], 1);
        density_histogram("histogram", &densities, THRESHOLDS).unwrap();
    }

    #[test]
    fn extremes_are_drawn_or_refused() {
        let zero = Thresholds {
            tau_low: 0.0,
            tau_high: 0.0,
        };
        for densities in [
            &[][..],
            &[0.0],
            &[0.0, 0.0],
            &[f64::MIN_POSITIVE, f64::MAX / 2.0],
        ] {
            for thresholds in [zero, THRESHOLDS] {
                let windows = points(densities);
                for svg in [
                    density_over_time("x", &windows, thresholds).unwrap().svg,
                    density_histogram("x", densities, thresholds).unwrap().svg,
                ] {
                    assert!(svg.contains("</svg>") && !svg.contains("NaN"));
                }
            }
        }
        for wrong in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(density_over_time("x", &points(&[wrong]), THRESHOLDS).is_err());
            assert!(density_histogram("x", &[wrong], THRESHOLDS).is_err());
        }
        let reversed = Thresholds {
            tau_low: 2.0,
            tau_high: 1.0,
        };
        assert!(density_histogram("x", &[1.0], reversed).is_err());
    }

    #[test]
    fn long_recordings_keep_their_peaks() {
        let mut densities = vec![1.0; 100_000];
        densities[77_777] = 9.0;
        densities[77_778] = 0.1;
        let points = merged(&points(&densities));
        assert!(points.len() <= POINTS_MAX);
        assert!(points.iter().any(|p| p.density == 9.0));
        assert!(points.iter().any(|p| p.density == 0.1));
        assert!(points.is_sorted_by(|a, b| a.time_s <= b.time_s));
    }

    #[test]
    fn labels_have_three_digits() {
        let cases = [
            (0.0, "0"),
            (0.123_456, "0.123"),
            (12.0, "12"),
            (1234.5, "1234"),
            (0.5, "0.5"),
            (1e9, "1.00e9"),
            (100.0, "100"),
        ];
        for (value, text) in cases {
            assert_eq!(short(value), text);
        }
    }
}
