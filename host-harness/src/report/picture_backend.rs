//! Draws plotters' charts on a [`Picture`], with its own letters instead of system fonts.

use std::convert::Infallible;

use event_pictures::picture::{CELL, Colour, Picture};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontTransform,
};

/// Drawing backend on a picture; whatever lies outside is cut off.
#[derive(Debug)]
pub struct PictureBackend<'p>(pub &'p mut Picture);

/// Returns the scale of the letters: letters of 8 pixels, which are wide, stand for fonts of size 10.
fn scale(size: f64) -> usize {
    (size / 10.0).clamp(1.0, 64.0) as usize
}

impl DrawingBackend for PictureBackend<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        (self.0.width() as u32, self.0.height() as u32)
    }

    fn ensure_prepared(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn present(&mut self) -> Result<(), DrawingErrorKind<Infallible>> {
        Ok(())
    }

    fn draw_pixel(
        &mut self,
        (x, y): BackendCoord,
        colour: BackendColor,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else {
            return Ok(());
        };
        if let Some(below) = self.0.pixel(x, y) {
            let (r, g, b) = colour.rgb;
            let mixed = |over: u8, below: u8| {
                let (over, below) = (f64::from(over), f64::from(below));
                (below + (over - below) * colour.alpha).round() as u8
            };
            let mixed: Colour = [mixed(r, below[0]), mixed(g, below[1]), mixed(b, below[2])];
            self.0.fill(x, y, 1, 1, mixed);
        }
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (x, y): BackendCoord,
    ) -> Result<(), DrawingErrorKind<Infallible>> {
        let (width, height) = self.estimate_text_size(text, style)?;
        let mut letters = Picture::new(width as usize, height as usize, [255; 3]);
        letters.text(0, 0, scale(style.size()), text, [0; 3]);
        let (width, height) = (width as i32, height as i32);
        let dx = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Right => -width,
            HPos::Center => -width / 2,
        };
        let dy = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Center => -height / 2,
            VPos::Bottom => -height,
        };
        let turn: FontTransform = style.transform();
        for (row, column) in (0..height).flat_map(|row| (0..width).map(move |c| (row, c))) {
            if letters.pixel(column as usize, row as usize) == Some([0; 3]) {
                let (right, down) = turn.transform(column + dx, row + dy);
                self.draw_pixel((x + right, y + down), style.color())?;
            }
        }
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        style: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let cell = CELL * scale(style.size());
        Ok(((text.chars().count() * cell) as u32, cell as u32))
    }
}
