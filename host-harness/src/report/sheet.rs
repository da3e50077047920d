//! A chart as SVG text and as a picture, from one drawing.

use anyhow::{Result, anyhow};
use event_pictures::picture::Picture;
use plotters::coord::Shift;
use plotters::prelude::*;

use super::kernel_chart::{Drawn, PNG_SCALE};
use super::picture_backend::PictureBackend;

/// A chart that can be drawn on any backend.
pub trait Chart {
    /// Returns width and height, in pixels of the SVG.
    fn size(&self) -> (u32, u32);

    /// Draws the chart with all lengths times `scale`.
    ///
    /// # Errors
    /// Fails with the error of the backend.
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, scale: i32) -> Drawn<B>
    where
        B::ErrorType: 'static;
}

/// A chart in both forms.
#[derive(Debug, Clone)]
pub struct Sheet {
    /// The chart as SVG, for any size.
    pub svg: String,
    /// The chart as a picture with twice as many pixels each way.
    pub png: Picture,
}

impl Sheet {
    /// Draws a chart in both forms.
    ///
    /// # Errors
    /// Fails with the error of a backend.
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
