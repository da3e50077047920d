//! A cut as the accumulate stage meets it: impulses by pixel.

use std::num::NonZeroU32;

use anyhow::{Context, Result};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_oracle::transform as oracle;
use eecvs_oracle::window::{HOST_CAPACITY, windows};

use super::cut::Cut;

/// Events of a crowded pixel at the least.
pub const CROWDED_EVENTS: usize = 16;

/// One window's pixels, in raster order.
#[derive(Debug, Clone)]
pub struct Window {
    /// T.
    pub duration_us: u32,
    /// T's.
    pub scale: PhaseScale,
    impulses: Vec<Impulse>,
    oracles: Vec<oracle::Impulse>,
    /// By pixel, where its impulses end.
    ends: Vec<usize>,
}

/// The windows of a cut.
#[derive(Debug, Clone)]
pub struct Windows {
    /// The cut's name.
    pub name: &'static str,
    /// One or more.
    pub windows: Vec<Window>,
    /// Events in all of them.
    pub events: usize,
}

/// A pixel's events, oldest first: the core's, and the oracle's.
#[derive(Debug, Clone, Copy)]
pub struct Pixel<'w> {
    /// The window it is of.
    pub window: &'w Window,
    /// For the core.
    pub impulses: &'w [Impulse],
    /// The same for the oracle.
    pub oracles: &'w [oracle::Impulse],
}

impl Window {
    /// A window of some pixels' events, whose offsets are below `duration_us`.
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

    /// Its pixels with events.
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
    /// The windows of a cut's first `most` events.
    ///
    /// # Errors
    /// A cut of a window of 0 us.
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

    /// The pixels of less than [`CROWDED_EVENTS`], and the crowded ones, in order.
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

    /// The pixels of all windows.
    pub fn pixels(&self) -> impl Iterator<Item = Pixel<'_>> {
        self.windows.iter().flat_map(Window::pixels)
    }
}
