//! Chart of the errors of event times: the share of events within an error, for each representation of Table I.
//!
//! All sources of a set are taken together. A curve stays below 100 % by the events in whose place another number
//! of events was decoded.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::colours::REPRESENTATIONS;
use super::panels::{Panels, mark};
use crate::report::kernel_chart::{Drawn, FRONT, GRID, text};
use crate::study::Results;
use crate::study::claims::family;
use crate::study::times::EDGES_US;

/// The chart of a study's rows.
#[derive(Debug)]
pub struct TimeErrors<'r>(pub &'r Results);

impl TimeErrors<'_> {
    /// Returns the shares of events within each edge, in per cent; `None` if there are no rows.
    fn shares(&self, set: &str, representation: &str) -> Option<Vec<f64>> {
        let rows = self.0.times.iter().filter(|row| {
            row.set == set
                && family(&row.method) == representation
                && row.setting != "peaks"
                // The curve of lossless events would be a line along the top.
                && (row.m > 0 || row.setting == "50 us")
        });
        let mut counts = [0_u64; EDGES_US.len()];
        let mut all = 0;
        for row in rows {
            for (sum, count) in counts.iter_mut().zip(row.counts) {
                *sum += count;
            }
            all += row.counts.iter().sum::<u64>() + row.unpaired;
        }
        let mut within = 0;
        let shares = counts.iter().map(|count| {
            within += count;
            100.0 * within as f64 / all as f64
        });
        let shares = shares.collect();
        (all > 0).then_some(shares)
    }
}

impl Panels for TimeErrors<'_> {
    const TITLE: &'static str =
        "Share of events whose times are off by at most so much; M = 16, events within 50 us";
    const HEIGHT: u32 = 380;

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
        let last = EDGES_US.len() - 1;
        let mut chart = ChartBuilder::on(panel)
            .caption(
                format!("{} {set}", self.0.sources(set).len()),
                text(14, scale),
            )
            .margin(8 * scale)
            .margin_right(18 * scale)
            .x_label_area_size(40 * scale)
            .y_label_area_size(56 * scale)
            .build_cartesian_2d(-0.3..last as f64 + 0.3, 0.0..103.0)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(FRONT)
            .label_style(text(13, scale))
            .axis_desc_style(text(14, scale))
            .x_labels(EDGES_US.len())
            .x_desc("off by at most, us")
            .y_desc("events, %")
            .x_label_formatter(&|at| edge(*at))
            .draw()?;
        let (left, top) = panel.get_base_pixel();
        for (name, _, colour, is_triangle) in &REPRESENTATIONS {
            let Some(shares) = self.shares(set, name) else {
                continue;
            };
            let places: Vec<_> = shares
                .iter()
                .enumerate()
                .map(|(at, share)| {
                    let (x, y) = chart.backend_coord(&(at as f64, *share));
                    (x - left, y - top)
                })
                .collect();
            panel.draw(&PathElement::new(
                places.clone(),
                colour.stroke_width(2 * scale as u32),
            ))?;
            for at in places {
                mark(panel, at, *colour, *is_triangle, scale)?;
            }
        }
        Ok(())
    }
}

/// Labels every third edge.
fn edge(at: f64) -> String {
    let index = at.round();
    if (at - index).abs() > 1e-6 || index < 0.0 || !(index as usize).is_multiple_of(3) {
        return String::new();
    }
    EDGES_US
        .get(index as usize)
        .map(u64::to_string)
        .unwrap_or_default()
}
