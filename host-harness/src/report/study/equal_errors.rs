//! Chart of the fewest bits per event at equal errors: one panel per set, on the left the error of times, on the right
//! that of the smoothed volume.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::colours::REPRESENTATIONS;
use super::panels::{Panels, mark};
use crate::report::kernel_chart::{Drawn, FRONT, GRID, text};
use crate::study::Results;
use crate::study::equal_errors::{ASKED, Asked, COMPARED};

/// The chart of a study's rows.
#[derive(Debug)]
pub struct EqualErrors<'r>(pub &'r Results);

/// One of the two errors: its name, and the errors that are asked for.
struct Axis {
    name: &'static str,
    asked: Vec<Asked>,
}

impl Axis {
    fn both() -> [Self; 2] {
        let (times, volumes) = ASKED
            .into_iter()
            .partition(|asked| matches!(asked, Asked::TimesUs(_)));
        [
            Self {
                name: "emd_pixel of at most, us",
                asked: times,
            },
            Self {
                name: "error of the volume of at most",
                asked: volumes,
            },
        ]
    }

    fn label(&self, at: f64) -> String {
        let index = at.round();
        let is_at = (at - index).abs() < 1e-6 && index >= 0.0;
        match self.asked.get(index as usize).filter(|_| is_at) {
            Some(Asked::TimesUs(us)) => us.to_string(),
            Some(Asked::Volume(most)) => most.to_string(),
            None => String::new(),
        }
    }
}

impl EqualErrors<'_> {
    /// Returns the bits of a representation at each error that every source has a setting for.
    fn points(&self, set: &str, representation: &str, axis: &Axis) -> Vec<(f64, f64)> {
        let of = self.0.sources(set).len();
        let at = axis.asked.iter().enumerate();
        at.filter_map(|(at, asked)| {
            let (bits, count) = self.0.fewest_bits_median(set, representation, *asked);
            bits.filter(|_| count == of).map(|bits| (at as f64, bits))
        })
        .collect()
    }

    fn half<B: DrawingBackend>(
        &self,
        set: &str,
        axis: &Axis,
        half: &DrawingArea<B, Shift>,
        scale: i32,
    ) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        let shown = REPRESENTATIONS
            .iter()
            .filter(|(name, ..)| COMPARED.contains(name));
        let all: Vec<_> = shown.map(|of| (of, self.points(set, of.0, axis))).collect();
        let bits = || {
            all.iter()
                .flat_map(|(_, points)| points)
                .map(|(_, bits)| *bits)
        };
        let least = bits().fold(f64::INFINITY, f64::min);
        let most = bits().fold(0.0, f64::max);
        let range = if least < most {
            least / 1.3..most * 1.3
        } else {
            1.0..100.0
        };
        let last = axis.asked.len().saturating_sub(1) as f64;
        let mut chart = ChartBuilder::on(half)
            .caption(
                format!("{} {set}", self.0.sources(set).len()),
                text(14, scale),
            )
            .margin(8 * scale)
            .margin_right(18 * scale)
            .x_label_area_size(40 * scale)
            .y_label_area_size(56 * scale)
            .build_cartesian_2d(-0.3..last + 0.3, range.log_scale())?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID)
            .axis_style(FRONT)
            .label_style(text(13, scale))
            .axis_desc_style(text(14, scale))
            .x_labels(axis.asked.len())
            .x_desc(axis.name)
            .y_desc("bits per event, packed")
            .x_label_formatter(&|at| axis.label(*at))
            .y_label_formatter(&|bits| format!("{bits:.0}"))
            .draw()?;
        let (left, top) = half.get_base_pixel();
        for ((_, _, colour, is_triangle), points) in &all {
            let places: Vec<_> = points
                .iter()
                .map(|point| {
                    let (x, y) = chart.backend_coord(point);
                    (x - left, y - top)
                })
                .collect();
            let line = colour.stroke_width(2 * scale as u32);
            half.draw(&PathElement::new(places.clone(), line))?;
            for at in places {
                mark(half, at, *colour, *is_triangle, scale)?;
            }
        }
        Ok(())
    }
}

impl Panels for EqualErrors<'_> {
    const TITLE: &'static str = "Fewest bits per event within an error of times, and within an error of the smoothed volume";
    const HEIGHT: u32 = 340;

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
        let halves = panel.split_evenly((1, 2));
        for (axis, half) in Axis::both().iter().zip(&halves) {
            self.half(set, axis, half, scale)?;
        }
        Ok(())
    }
}
