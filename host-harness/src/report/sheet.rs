//! A chart as SVG text and as a picture, from one drawing.

use anyhow::{Result, anyhow};
use event_pictures::picture::Picture;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::kernel_chart::{Drawn, PNG_SCALE};
use super::picture_backend::PictureBackend;

/// What can be drawn on any backend.
pub trait Chart {
    /// Width and height, in pixels of the SVG.
    fn size(&self) -> (u32, u32);

    /// Draws everything, lengths times `scale`.
    ///
    /// # Errors
    /// What the backend reports.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static;
}

/// Both forms of a chart.
#[derive(Debug, Clone)]
pub struct Sheet {
    /// Scales to any size.
    pub svg: String,
    /// Twice as many pixels each way.
    pub png: Picture,
}

impl Sheet {
    /// Draws a chart twice.
    ///
    /// # Errors
    /// What the backends report.
    pub fn new(chart: &impl Chart) -> Result<Self> {
        let (width, height) = chart.size();
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, (width, height)).into_drawing_area();
            chart
                .draw(&area, 1)
                .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
        }
        let side = |side: u32| side as usize * PNG_SCALE as usize;
        let mut png = Picture::new(side(width), side(height), [255; 3]);
        {
            let area = PictureBackend(&mut png).into_drawing_area();
            chart
                .draw(&area, PNG_SCALE)
                .map_err(|error| anyhow!("the chart cannot be drawn: {error}"))?;
        }
        Ok(Self { svg, png })
    }
}
