//! A cut in the form in which the accumulate stage receives it: impulses grouped by pixel.

use std::num::NonZeroU32;

use anyhow::{Context, Result};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_oracle::transform as oracle;
use eecvs_oracle::window::{HOST_CAPACITY, windows};

use super::cut::Cut;

/// Minimum number of events in a crowded pixel.
pub const CROWDED_EVENTS: usize = 16;

/// The events of one window, grouped by pixel.
#[derive(Debug, Clone)]
pub struct Window {
    /// T in us.
    pub duration_us: u32,
    /// The scale that turns offsets into phases, for this T.
    pub scale: PhaseScale,
    impulses: Vec<Impulse>,
    oracles: Vec<oracle::Impulse>,
    /// The index at which each pixel's impulses end.
    ends: Vec<usize>,
}

/// The windows of a cut.
#[derive(Debug, Clone)]
pub struct Windows {
    /// Name of the cut.
    pub name: &'static str,
    /// The windows, one or more, in order of time.
    pub windows: Vec<Window>,
    /// Number of events in all windows.
    pub events: usize,
}

/// The events of one pixel, once in the core's type and once in the oracle's. Those of a cut are in order of arrival.
#[derive(Debug, Clone, Copy)]
pub struct Pixel<'w> {
    /// The window that contains the pixel.
    pub window: &'w Window,
    /// The events as the core takes them.
    pub impulses: &'w [Impulse],
    /// The same events as the oracle takes them.
    pub oracles: &'w [oracle::Impulse],
}

impl Window {
    /// Creates a window of T = `duration_us`, 1 or more, from the events of its pixels. Their offsets must be below
    /// T. The core's impulses keep only the sign of p.
    #[must_use]
    pub fn new(duration_us: u32, pixels: impl IntoIterator<Item = Vec<oracle::Impulse>>) -> Self {
        let (mut oracles, mut ends) = (Vec::new(), Vec::new());
        for pixel in pixels {
            oracles.extend(pixel);
            ends.push(oracles.len());
        }
        let impulses = oracles.iter().map(|impulse| Impulse {
            offset_us: impulse.offset_us,
            is_on: impulse.p > 0.0,
        });
        Self {
            duration_us,
            scale: PhaseScale::new(duration_us),
            impulses: impulses.collect(),
            oracles,
            ends,
        }
    }

    /// Returns the pixels that have events, in the order in which they were given.
    pub fn pixels(&self) -> impl Iterator<Item = Pixel<'_>> {
        let mut start = 0;
        self.ends.iter().map(move |end| {
            let range = start..*end;
            start = *end;
            Pixel {
                window: self,
                impulses: &self.impulses[range.clone()],
                oracles: &self.oracles[range],
            }
        })
    }
}

impl Windows {
    /// Divides the first `most` events of a cut into windows, with the pixels of each in raster order.
    ///
    /// # Errors
    /// Fails if the cut's T is 0 us.
    pub fn new(cut: &Cut, most: usize) -> Result<Self> {
        let window_us = NonZeroU32::new(cut.window_us).context("a window of 0 us")?;
        let events = &cut.events[..most.min(cut.events.len())];
        let windows: Vec<Window> = windows(events, window_us, HOST_CAPACITY)
            .iter()
            .map(|window| {
                let pixels = eecvs_oracle::impulses(window).into_values();
                Window::new(window.duration_us, pixels)
            })
            .collect();
        let events = windows.iter().map(|window| window.impulses.len()).sum();
        Ok(Self {
            name: cut.name,
            windows,
            events,
        })
    }

    /// Returns all windows twice: with only the pixels of fewer than [`CROWDED_EVENTS`] events, and with only the
    /// crowded pixels. The order of the pixels is kept.
    #[must_use]
    pub fn parts(&self) -> [Self; 2] {
        [false, true].map(|crowded| {
            let part = |window: &Window| {
                let (mut impulses, mut oracles, mut ends) = (Vec::new(), Vec::new(), Vec::new());
                for pixel in window.pixels() {
                    if (pixel.impulses.len() >= CROWDED_EVENTS) == crowded {
                        impulses.extend_from_slice(pixel.impulses);
                        oracles.extend_from_slice(pixel.oracles);
                        ends.push(impulses.len());
                    }
                }
                Window {
                    impulses,
                    oracles,
                    ends,
                    ..*window
                }
            };
            let windows: Vec<Window> = self.windows.iter().map(part).collect();
            Self {
                name: self.name,
                events: windows.iter().map(|window| window.impulses.len()).sum(),
                windows,
            }
        })
    }

    /// Returns the pixels of all windows, one window after the other.
    pub fn pixels(&self) -> impl Iterator<Item = Pixel<'_>> {
        self.windows.iter().flat_map(Window::pixels)
    }
}
