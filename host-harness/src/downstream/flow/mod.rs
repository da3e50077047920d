//! Optical flow of the original and of the decoded events, by contrast maximisation (Gallego, Rebecq, Scaramuzza
//! 2018), without a trained model.
//!
//! A window of [`WINDOW_US`] is cut into tiles of [`TILE_PX`] x [`TILE_PX`] pixels. A tile's flow is the velocity,
//! in px per window, at which the image of its warped events has the greatest contrast. The search starts on a grid
//! of velocities, 2 px per window apart and up to [`SPEED_MAX_PX`] along each axis, with an image of 2 x 2 px cells
//! and some of the events. The simplex method then refines the best of these, with all events and a blurred image
//! of the sensor's pixels.
//!
//! A tile is *reliable* if the grid search shows that it has one distinct flow:
//!
//! * it has [`EVENTS_MIN`] events or more;
//! * *contrast gain*: the greatest contrast is at least [`GAIN_MIN`] times the grid's median; noise, and events that
//!   have lost their times, have the same contrast at any velocity;
//! * all velocities whose contrast reaches [`PEAK_SHARE`] of the way from the median to the greatest are within
//!   [`PEAK_RADIUS_PX`] of the best; this excludes straight edges, along which the flow is ambiguous;
//! * the best velocity is not on the grid's border.
//!
//! The comparison covers the tiles that are reliable in the original. Such a tile counts as lost if it is not
//! reliable in the reconstruction. So that a comparison takes seconds, at most [`WINDOWS`] windows are used: the
//! windows with events are divided into that many stretches of equal length, and each stretch contributes its
//! window with the most events (the first of equals).

mod contrast;
mod search;

use std::collections::BTreeMap;

use eecvs_bench::source::{Source, WINDOW_US};
use eecvs_nostd::Event;
use rayon::prelude::*;
use serde::Serialize;

use super::slices::Slices;
use contrast::Point;
use search::Search;

/// Side of a tile in px; the last tile of a row or column may be smaller.
pub const TILE_PX: u16 = 32;
/// Greatest flow along an axis, in px per window; faster edges leave their tile within a window.
pub const SPEED_MAX_PX: u16 = 32;
/// Least number of events of a reliable tile.
pub const EVENTS_MIN: usize = 64;
/// Least contrast gain of a reliable tile.
pub const GAIN_MIN: f32 = 1.5;
/// Level of the peak's foot in a reliable tile: 0 is the median contrast, 1 the greatest.
pub const PEAK_SHARE: f32 = 0.75;
/// Greatest radius of the peak's foot, in px per window.
pub const PEAK_RADIUS_PX: f32 = 6.0;
/// Greatest number of windows compared.
pub const WINDOWS: usize = 8;

/// Agreement of two flows; the fields are JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Flow {
    /// Number of tiles that are reliable in the original.
    pub tiles: usize,
    /// Number of these that are not reliable in the reconstruction.
    pub lost: usize,
    /// Mean length of the difference of the flows over the other tiles, in px per window; `None` if there are none.
    pub mean_px: Option<f64>,
    /// Median of these lengths, in px per window.
    pub median_px: Option<f64>,
}

/// Number of a window, row and column of a tile in the window.
pub type Tile = (u64, u16, u16);

/// Flow of a reliable tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileFlow {
    /// The tile.
    pub tile: Tile,
    /// Components to the right and down, in px per window.
    pub velocity: (f32, f32),
}

/// Compares the flow of a recording with that of its decoded events; use [`FlowReference`] to compare one recording
/// with several decoded versions.
#[must_use]
pub fn flow(original: &Source, decoded: &[Event]) -> Flow {
    FlowReference::new(original).against(decoded)
}

/// Flow of a recording, to compare decoded events with.
#[derive(Debug, Clone)]
pub struct FlowReference {
    slices: Slices,
    flows: Vec<TileFlow>,
}

impl FlowReference {
    /// Finds the flow in windows of [`WINDOW_US`] from the recording's first event on; [the module](self) says
    /// which windows are used.
    #[must_use]
    pub fn new(original: &Source) -> Self {
        let slices = Slices::new(original.sensor, &original.events, WINDOW_US);
        let sorted = slices.sorted(&original.events);
        let windows = slices.cut(&sorted);
        let stretch = windows.len().div_ceil(WINDOWS).max(1);
        let mut tiles = BTreeMap::new();
        for stretch in windows.chunks(stretch) {
            // On the reversed stretch, the last of equals is the first window.
            let most = stretch.iter().rev().max_by_key(|(_, events)| events.len());
            if let Some((number, events)) = most {
                add_points(&mut tiles, &slices, *number, events);
            }
        }
        Self {
            slices,
            flows: flows(tiles),
        }
    }

    /// Returns the flow of the reliable tiles, in order of the tiles.
    #[must_use]
    pub fn flows(&self) -> &[TileFlow] {
        &self.flows
    }

    /// Compares the flow with that of `decoded`, whose events may be in any order; events outside of the sensor or
    /// of the recording's windows are ignored.
    #[must_use]
    pub fn against(&self, decoded: &[Event]) -> Flow {
        let sorted = self.slices.sorted(decoded);
        let mut tiles = BTreeMap::new();
        for (number, events) in self.slices.cut(&sorted) {
            if self.flows_of(number) {
                add_points(&mut tiles, &self.slices, number, events);
            }
        }
        tiles.retain(|tile, _| self.position(tile).is_ok());
        end_point_difference(&self.flows, &flows(tiles))
    }

    fn position(&self, tile: &Tile) -> Result<usize, usize> {
        self.flows.binary_search_by_key(tile, |flow| flow.tile)
    }

    /// Returns whether window `number` has a reliable tile.
    fn flows_of(&self, number: u64) -> bool {
        let (Ok(at) | Err(at)) = self.position(&(number, 0, 0));
        self.flows.get(at).is_some_and(|flow| flow.tile.0 == number)
    }
}

/// Returns the length of the flow difference, in px per window, over the tiles of `original` that `reconstructed`
/// has as well; the others count as lost. A tile occurs at most once on either side.
#[must_use]
pub fn end_point_difference(original: &[TileFlow], reconstructed: &[TileFlow]) -> Flow {
    let of_tile: BTreeMap<Tile, (f32, f32)> = reconstructed
        .iter()
        .map(|flow| (flow.tile, flow.velocity))
        .collect();
    let mut lengths: Vec<f64> = original
        .iter()
        .filter_map(|flow| {
            let (x, y) = of_tile.get(&flow.tile)?;
            let difference = |a: f32, b: f32| f64::from(a) - f64::from(b);
            Some(difference(flow.velocity.0, *x).hypot(difference(flow.velocity.1, *y)))
        })
        .collect();
    lengths.sort_by(f64::total_cmp);
    let upper = lengths.get(lengths.len() / 2);
    let lower = lengths.get(lengths.len().saturating_sub(1) / 2);
    Flow {
        tiles: original.len(),
        lost: original.len() - lengths.len(),
        mean_px: (!lengths.is_empty()).then(|| lengths.iter().sum::<f64>() / lengths.len() as f64),
        median_px: upper.zip(lower).map(|(upper, lower)| (upper + lower) / 2.0),
    }
}

/// Distributes the events of a window among its tiles.
fn add_points(
    tiles: &mut BTreeMap<Tile, Vec<Point>>,
    slices: &Slices,
    number: u64,
    events: &[Event],
) {
    let middle_us = slices.middle_us(number);
    for event in events {
        let since_start_us = event.t_us.saturating_sub(slices.start_us) as f64;
        let tile = (number, event.y / TILE_PX, event.x / TILE_PX);
        tiles.entry(tile).or_default().push(Point {
            x: f32::from(event.x % TILE_PX),
            y: f32::from(event.y % TILE_PX),
            t: ((since_start_us - middle_us) / f64::from(slices.slice_us)) as f32,
            p: event.polarity.sign() as f32,
        });
    }
}

/// Returns the flow of the reliable tiles, in order of the tiles.
fn flows(tiles: BTreeMap<Tile, Vec<Point>>) -> Vec<TileFlow> {
    let tiles: Vec<(Tile, Vec<Point>)> = tiles.into_iter().collect();
    tiles
        .par_iter()
        .map_init(Search::new, |search, (tile, points)| {
            let v = search.velocity(points)?;
            Some(TileFlow {
                tile: *tile,
                velocity: (v.x, v.y),
            })
        })
        .flatten()
        .collect()
}

#[cfg(test)]
mod tests;
