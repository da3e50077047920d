//! Chart of bits per event against the error of times: one panel per set, with medians over its sources.
//!
//! Both axes are logarithmic; exact results are drawn at the foot. A point is a setting of a representation, at its
//! bits when packed best; settings of one group are joined.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::colours::REPRESENTATIONS;
use super::panels::{Panels, mark};
use crate::report::kernel_chart::{Drawn, FRONT, GRID, power, text};
use crate::study::Results;
use crate::study::claims::{family, median};

/// Error at which exact results are drawn, and the least error drawn above it, in us.
const FOOT_US: f64 = 0.01;
const LEAST_US: f64 = 0.1;
/// Points at most this far apart, in pixels, share a label.
const NEAR: i32 = 12;

/// A point of a representation.
#[derive(Debug, Clone, PartialEq)]
struct Point {
    bits: f64,
    error_us: f64,
    label: String,
    /// Points of one group are joined: those of one number type, of tolerances, or of bins.
    group: String,
}

/// The chart of a study's rows.
#[derive(Debug)]
pub struct RateDistortion<'r>(pub &'r Results);

impl RateDistortion<'_> {
    /// Returns the points of a representation, group by group in the order of their bits.
    fn points(&self, set: &str, representation: &str) -> Vec<Point> {
        let rows = || {
            self.0.quality.iter().filter(|row| {
                row.set == set
                    && family(&row.method) == representation
                    && !row.setting.ends_with("peaks")
                    && row.has_times
            })
        };
        let mut settings: Vec<(&str, u8, &str)> = rows()
            .map(|row| (row.method.as_str(), row.m, row.setting.as_str()))
            .collect();
        settings.sort_unstable();
        settings.dedup();
        let mut points: Vec<Point> = settings
            .into_iter()
            .filter_map(|(method, m, setting)| {
                let of = |metric: fn(&crate::study::quality::Quality) -> f64| {
                    let rows = rows().filter(|row| {
                        (row.method.as_str(), row.m, row.setting.as_str()) == (method, m, setting)
                    });
                    median(rows.map(metric).collect())
                };
                let label = match (m, setting) {
                    (0, "lossless") => method.trim_start_matches("hybrid-").to_owned(),
                    (0, setting) => setting.trim_end_matches(" on average").to_owned(),
                    (m, _) => m.to_string(),
                };
                Some(Point {
                    bits: of(|row| row.packed_bits_per_event)?,
                    error_us: of(|row| row.emd_pixel_us)?,
                    label,
                    group: match m {
                        0 if setting.ends_with("bins") => "bins".to_owned(),
                        0 => "times".to_owned(),
                        _ => setting.to_owned(),
                    },
                })
            })
            .collect();
        points.sort_by(|a, b| a.group.cmp(&b.group).then(a.bits.total_cmp(&b.bits)));
        points
    }
}

impl Panels for RateDistortion<'_> {
    const TITLE: &'static str =
        "Bits per event against the error of times, medians; beside points their M or setting";
    const HEIGHT: u32 = 430;

    fn results(&self) -> &Results {
        self.0
    }

    fn panel<B: DrawingBackend>(
        &self,
        set: &str,
        panel: &DrawingArea<B, Shift>,
        scale: i32,
    ) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        let all: Vec<_> = REPRESENTATIONS
            .iter()
            .map(|representation| (representation, self.points(set, representation.0)))
            .collect();
        let points = || all.iter().flat_map(|(_, points)| points);
        let least = points()
            .map(|point| point.bits)
            .fold(f64::INFINITY, f64::min);
        let most = points().map(|point| point.bits).fold(0.0, f64::max);
        let worst = points()
            .map(|point| point.error_us)
            .fold(LEAST_US, f64::max);
        let bits = if least < most {
            (least / 3.4, most * 1.6)
        } else {
            (1.0, 100.0)
        };
        let name = self.0.sources(set).len();
        let mut chart = ChartBuilder::on(panel)
            .caption(format!("{name} {set}"), text(14, scale))
            .margin(8 * scale)
            .margin_right(18 * scale)
            .x_label_area_size(40 * scale)
            .y_label_area_size(64 * scale)
            .build_cartesian_2d(
                (bits.0..bits.1).log_scale(),
                (FOOT_US / 2.0..worst * 3.0).log_scale(),
            )?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(FRONT)
            .label_style(text(13, scale))
            .axis_desc_style(text(14, scale))
            .x_desc("bits per event, packed")
            .y_desc("emd_pixel, us")
            .x_label_formatter(&|bits| bits_label(*bits))
            .y_label_formatter(&|error| {
                if *error < FOOT_US * 1.01 {
                    "0".to_owned()
                } else {
                    power(*error)
                }
            })
            .draw()?;
        let (left, top) = panel.get_base_pixel();
        for ((name, _, colour, is_triangle), points) in &all {
            let places: Vec<_> = points
                .iter()
                .map(|point| {
                    let error = if point.error_us > 0.0 {
                        point.error_us.max(LEAST_US)
                    } else {
                        FOOT_US
                    };
                    let (x, y) = chart.backend_coord(&(point.bits, error));
                    (x - left, y - top)
                })
                .collect();
            let all: Vec<_> = places.into_iter().zip(points).collect();
            for group in all.chunk_by(|(_, a), (_, b)| a.group == b.group) {
                let line: Vec<_> = group.iter().map(|(at, _)| *at).collect();
                panel.draw(&PathElement::new(line, colour.stroke_width(scale as u32)))?;
            }
            for (at, _) in &all {
                mark(panel, *at, *colour, *is_triangle, scale)?;
            }
            let named = all
                .iter()
                .map(|(at, point)| (*at, point.label.as_str()))
                .collect::<Vec<_>>();
            for (at, label) in labels(&named, NEAR * scale) {
                // Labels of events are below their points, which form the front, those of all others above. The two
                // exact settings are close together, so their labels are on either side.
                let (x, y, anchor) = match (*name, label.as_str()) {
                    ("events", "fast") => (6, 2, HPos::Left),
                    ("events", _) => (-6, 2, HPos::Right),
                    _ => (6, -14, HPos::Left),
                };
                let beside = (at.0 + x * scale, at.1 + y * scale);
                let style = text(12, scale)
                    .color(colour)
                    .pos(Pos::new(anchor, VPos::Top));
                panel.draw_text(&label, &style, beside)?;
            }
        }
        Ok(())
    }
}

/// Returns the labels; points at most `near` pixels along each axis from the first of a label share it.
fn labels(points: &[((i32, i32), &str)], near: i32) -> Vec<((i32, i32), String)> {
    let mut labels: Vec<((i32, i32), String)> = Vec::new();
    for ((x, y), label) in points {
        let is_near = |((at_x, at_y), _): &&mut ((i32, i32), String)| {
            (x - at_x).abs() <= near && (y - at_y).abs() <= near
        };
        match labels.iter_mut().find(is_near) {
            Some((_, all)) => {
                all.push_str(", ");
                all.push_str(label);
            }
            None => labels.push(((*x, *y), (*label).to_owned())),
        }
    }
    labels
}

/// Labels only one, two and five times powers of ten.
fn bits_label(bits: f64) -> String {
    let lead = bits / 10_f64.powf(bits.log10().floor());
    let is_round = [1.0, 2.0, 5.0, 10.0]
        .iter()
        .any(|round| (lead - round).abs() < 1e-6);
    if is_round {
        format!("{bits:.0}")
    } else {
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_beside_each_other_have_one_label() {
        let points = [
            ((100, 100), "4 bins"),
            ((300, 100), "8 bins"),
            ((112, 88), "4000 us"),
            ((113, 100), "1000 us"),
            ((300, 113), "500 us"),
        ];
        let labels = labels(&points, 12);
        let labels: Vec<_> = labels
            .iter()
            .map(|(at, label)| (*at, label.as_str()))
            .collect();
        assert_eq!(
            labels,
            [
                ((100, 100), "4 bins, 4000 us"),
                ((300, 100), "8 bins"),
                ((113, 100), "1000 us"),
                ((300, 113), "500 us"),
            ]
        );
    }
}
