//! Layout shared by the charts of a study: a head with title and legend, and below it one panel per set.

use plotters::coord::Shift;
use plotters::prelude::*;

use super::colours::REPRESENTATIONS;
use crate::report::kernel_chart::{Drawn, text};
use crate::report::sheet::Chart;
use crate::study::Results;

const WIDTH: u32 = 820;
const HEAD: u32 = 84;

/// A chart with one panel per set.
pub trait Panels {
    /// Title of the chart.
    const TITLE: &'static str;
    /// Height of a panel.
    const HEIGHT: u32;

    /// Returns the results, which name the sets.
    fn results(&self) -> &Results;

    /// Draws the panel of a set.
    ///
    /// # Errors
    /// Fails with the error of the backend.
    fn panel<B: DrawingBackend>(
        &self,
        set: &str,
        panel: &DrawingArea<B, Shift>,
        scale: i32,
    ) -> Drawn<B>
    where
        B::ErrorType: 'static;
}

/// The whole chart.
#[derive(Debug)]
pub struct Whole<P>(pub P);

impl<P: Panels> Chart for Whole<P> {
    fn size(&self) -> (u32, u32) {
        let sets = self.0.results().sets().len().max(1);
        (WIDTH, HEAD + P::HEIGHT * sets as u32)
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static,
    {
        area.fill(&WHITE)?;
        let (head, rest) = area.split_vertically(HEAD as i32 * scale);
        head.draw_text(P::TITLE, &text(13, scale), (14 * scale, 8 * scale))?;
        key(&head, 36, scale)?;
        let sets = self.0.results().sets();
        let panels = rest.split_evenly((sets.len().max(1), 1));
        for (set, panel) in sets.into_iter().zip(&panels) {
            self.0.panel(set, panel, scale)?;
        }
        area.present()
    }
}

/// Draws a point of a representation at a position in pixels.
pub fn mark<B: DrawingBackend>(
    area: &DrawingArea<B, Shift>,
    at: (i32, i32),
    colour: RGBColor,
    is_triangle: bool,
    scale: i32,
) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    if is_triangle {
        area.draw(&TriangleMarker::new(at, 5 * scale, colour.filled()))
    } else {
        area.draw(&Circle::new(at, 4 * scale, colour.filled()))
    }
}

/// Draws the legend of the representations, in three lines.
fn key<B: DrawingBackend>(head: &DrawingArea<B, Shift>, top: i32, scale: i32) -> Drawn<B>
where
    B::ErrorType: 'static,
{
    for (i, (_, label, colour, is_triangle)) in REPRESENTATIONS.iter().enumerate() {
        let (column, line) = (i as i32 % 5, i as i32 / 5);
        let (x, y) = (20 + 158 * column, top + 18 * line);
        mark(head, (x * scale, y * scale), *colour, *is_triangle, scale)?;
        head.draw_text(label, &text(13, scale), ((x + 12) * scale, (y - 6) * scale))?;
    }
    Ok(())
}
