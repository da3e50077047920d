//! Optical flow of the original and of the decoded events, by contrast maximisation (Gallego,
//! Rebecq, Scaramuzza 2018): no trained model.
//!
//! A window of [`WINDOW_US`] is cut into tiles of [`TILE_PX`] x [`TILE_PX`] pixels. A tile's flow is the
//! velocity at which the image of its warped events has the most contrast, in px per window:
//! first of those on a grid of 2 px per window up to [`SPEED_MAX_PX`] along each axis, in an image of
//! 2 x 2 px cells; then, from the best of these on, of all, by the simplex method in a blurred
//! image of the sensor's pixels.
//!
//! A tile is *reliable* where the first look shows that it has one flow and no other:
//!
//! * it has [`EVENTS_MIN`] events or more;
//! * *contrast gain*: the greatest contrast is [`GAIN_MIN`] times the grid's median or more; noise, and events
//!   that have lost their times, have the same contrast at any velocity;
//! * velocities that reach [`PEAK_SHARE`] of the way from the median to the greatest contrast are
//!   [`PEAK_RADIUS_PX`] from the best, or nearer: the flow along a straight edge cannot be told;
//! * the best is not on the grid's border.
//!
//! Compared are the tiles that are reliable in the original. One that is not in the reconstruction
//! has no flow there any more: it is counted as lost. So that a comparison takes seconds, at most
//! [`WINDOWS`] windows are used: those with events are cut into as many stretches of equal number, and of
//! each the window with the most events is taken (the first of equal ones).

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

/// Side of a tile in px; the last ones of a row or column are what is left.
pub const TILE_PX: u16 = 32;
/// Greatest flow along an axis, in px per window: faster edges leave their tile within it.
pub const SPEED_MAX_PX: u16 = 32;
/// Least events of a reliable tile.
pub const EVENTS_MIN: usize = 64;
/// Least contrast gain of a reliable tile.
pub const GAIN_MIN: f32 = 1.5;
/// Where the foot of the peak of a reliable tile is: 0 at the median contrast, 1 at the greatest.
pub const PEAK_SHARE: f32 = 0.75;
/// Greatest radius of the peak's foot, in px per window.
pub const PEAK_RADIUS_PX: f32 = 6.0;
/// Most windows that are compared.
pub const WINDOWS: usize = 8;

/// How far two flows agree; the fields are JSON keys.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Flow {
    /// Tiles that are reliable in the original.
    pub tiles: usize,
    /// Of them, those that are not in the reconstruction.
    pub lost: usize,
    /// Mean length of the difference of the flows of the other tiles, in px per window; `None` where
    /// there are none.
    pub mean_px: Option<f64>,
    /// The median of these lengths.
    pub median_px: Option<f64>,
}

/// Number of a window, row and column of a tile in it.
pub type Tile = (u64, u16, u16);

/// The flow of a reliable tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileFlow {
    /// Which tile.
    pub tile: Tile,
    /// To the right and down, in px per window.
    pub velocity: (f32, f32),
}

/// Compares the flow of a recording with that of what was decoded; see [`FlowReference`], which serves
/// where there are several decoded ones.
#[must_use]
pub fn flow(original: &Source, decoded: &[Event]) -> Flow {
    FlowReference::new(original).against(decoded)
}

/// The flow of a recording.
#[derive(Debug, Clone)]
pub struct FlowReference {
    slices: Slices,
    flows: Vec<TileFlow>,
}

impl FlowReference {
    /// Finds the flow in windows of [`WINDOW_US`] from the recording's first event on; see
    /// [the module](self) for which ones.
    #[must_use]
    pub fn new(original: &Source) -> Self {
        let slices = Slices::new(original.sensor, &original.events, WINDOW_US);
        let sorted = slices.sorted(&original.events);
        let windows = slices.cut(&sorted);
        let stretch = windows.len().div_ceil(WINDOWS).max(1);
        let mut tiles = BTreeMap::new();
        for stretch in windows.chunks(stretch) {
            // The last of equal ones, of the reversed.
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

    /// The flow of the tiles that are reliable, in order.
    #[must_use]
    pub fn flows(&self) -> &[TileFlow] {
        &self.flows
    }

    /// Compares it with the flow of `decoded`: events in any order; those outside of the sensor or of
    /// the recording's windows are ignored.
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

    /// Whether window `number` has a reliable tile.
    fn flows_of(&self, number: u64) -> bool {
        let (Ok(at) | Err(at)) = self.position(&(number, 0, 0));
        self.flows.get(at).is_some_and(|flow| flow.tile.0 == number)
    }
}

/// Compares the flows of tiles, each at most once on either side: those of `original`, and where
/// `reconstructed` has them, too, |difference| in px per window.
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

/// Sorts the events of a window into its tiles.
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

/// The flow of those tiles that are reliable, in order.
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
