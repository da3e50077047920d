//! An encoder that events are pushed into: the frames of [`super::encode`], where no reader can be waited for.
//!
//! ```
//! use eecvs::encode::Limits;
//! use eecvs::encode::options::EncodeOptions;
//! use eecvs::encode::push::{PushEncoder, Settings};
//! use event_types::{Event, Polarity, Sensor};
//!
//! let sensor = Sensor::new(8, 8).expect("sides from 1 to 2048");
//! let config = EncodeOptions::default().config_of_file(sensor)?;
//! let mut encoder = PushEncoder::new(Settings::from(config), Limits::default())?;
//! let mut frames = Vec::new();
//! for t_us in 0..100_000 {
//!     let event = Event { t_us, x: 3, y: 5, polarity: Polarity::On };
//!     encoder.push(&[event], &mut frames)?;
//! }
//! let summary = encoder.finish(&mut frames)?;
//! assert_eq!(summary.events_encoded, 100_000);
//! # Ok::<(), eecvs::Error>(())
//! ```

use std::time::{Duration, Instant};

use eecvs_nostd::ingest::reorder::Reorder;
use eecvs_nostd::{Config, Event, Kernel, NextStart, OUTPUT_BYTES_MIN, Window, WindowEncoder};
use event_types::stream::{Context, Result};
use event_types::{bail, ensure};
use self_cell::{MutBorrow, self_cell};

use super::codec::Chooser;
use super::cutter::HELD_EVENTS;
use super::{Codec, EncodeSummary, HostStorage, Limits, NO_ROOM, REORDER_US, write_frame};
use crate::frame_file::FrameSink;
use crate::storage::{NO_MEMORY, frame_room, touch};

/// Settings of a [`PushEncoder`]: those of a [`Codec`], owned.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Configuration of the core.
    pub config: Config,
    /// Kernel of the DCT and the DTFT.
    pub kernel: Kernel,
    /// Pixels that are never sent, as (column, row).
    pub hot: Vec<(u16, u16)>,
    /// As [`Codec::max_nmse`].
    pub max_nmse: Option<f64>,
}

impl From<Config> for Settings {
    /// Uses the encoder's default kernel.
    fn from(config: Config) -> Self {
        Self {
            config,
            kernel: Kernel::Table,
            hot: Vec::new(),
            max_nmse: None,
        }
    }
}

impl Settings {
    fn codec(&self) -> Codec<'_> {
        Codec {
            config: self.config,
            kernel: self.kernel,
            hot: &self.hot,
            budget: None,
            max_nmse: self.max_nmse,
        }
    }
}

/// A window and its encoder, over a storage.
struct Parts<'s> {
    window: Window<'s>,
    encoder: WindowEncoder<'s>,
}

self_cell! {
    struct Owned {
        owner: MutBorrow<HostStorage>,
        #[not_covariant]
        dependent: Parts,
    }
}

/// An encoder that owns its memory. Events may be pushed in any portions: the frames do not depend on these.
pub struct PushEncoder {
    owned: Owned,
    settings: Settings,
    reorder: Reorder<Vec<Event>>,
    chooser: Chooser,
    frame: Vec<u8>,
    summary: EncodeSummary,
    busy: Duration,
    started: Instant,
}

impl PushEncoder {
    /// Allocates an encoder before the first event. Events are held back for [`Limits::reorder_us`], or for
    /// [`REORDER_US`] microseconds, to be sorted.
    ///
    /// # Errors
    /// An invalid configuration; the system refuses the memory.
    pub fn new(settings: Settings, limits: Limits) -> Result<Self> {
        ensure!(
            limits.frame_bytes >= OUTPUT_BYTES_MIN,
            Refused,
            "a frame needs room for at least {OUTPUT_BYTES_MIN} bytes"
        );
        let reorder_us = limits.reorder_us.unwrap_or(REORDER_US);
        let mut held = Vec::new();
        if reorder_us > 0 {
            held.try_reserve_exact(HELD_EVENTS)
                .ok()
                .context(NO_MEMORY)?;
            held.resize(HELD_EVENTS, Event::UNSET);
        }
        let storage = HostStorage::with_limits(settings.config.window.sensor, limits)?;
        let owned = Owned::try_new(MutBorrow::new(storage), |storage| {
            let (mut window, encoder) =
                storage.borrow_mut().parts(settings.config, &settings.hot)?;
            window.follow(NextStart::ANY);
            Ok::<_, event_types::stream::Error>(Parts { window, encoder })
        })?;
        let mut frame = frame_room(limits.frame_bytes)?;
        touch(&mut frame);
        Ok(Self {
            owned,
            chooser: settings.codec().chooser(),
            settings,
            reorder: Reorder::new(held, reorder_us),
            frame,
            summary: EncodeSummary {
                threads: 1,
                ..EncodeSummary::default()
            },
            busy: Duration::ZERO,
            started: Instant::now(),
        })
    }

    /// Encodes events; the frames of all windows that they close go to `out`.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn push(&mut self, events: &[Event], out: &mut dyn FrameSink) -> Result<()> {
        self.summary.events_in += events.len() as u64;
        let mut rest = events;
        loop {
            let started = Instant::now();
            let reorder = &mut self.reorder;
            let (taken, is_closed) = self.owned.with_dependent_mut(|_, parts| {
                let taken = reorder.fill(&mut parts.window, rest);
                (taken, parts.window.closed().is_some())
            });
            self.busy += started.elapsed();
            rest = rest.get(taken..).unwrap_or_default();
            if is_closed {
                self.frames(out)?;
            } else if rest.is_empty() {
                return Ok(());
            }
        }
    }

    /// Encodes what is held back and the open window, and returns the counts of all that was pushed.
    ///
    /// # Errors
    /// `out` cannot be written; the counts do not account for every event.
    pub fn finish(mut self, out: &mut dyn FrameSink) -> Result<EncodeSummary> {
        loop {
            let reorder = &mut self.reorder;
            let is_closed = self.owned.with_dependent_mut(|_, parts| {
                reorder.flush(&mut parts.window);
                parts.window.closed().is_some()
            });
            if !is_closed {
                break;
            }
            self.frames(out)?;
        }
        self.summary.finish(self.busy, self.started.elapsed());
        self.summary.check_accounted()?;
        Ok(self.summary)
    }

    /// Returns the counts so far.
    #[must_use]
    pub const fn summary(&self) -> &EncodeSummary {
        &self.summary
    }

    /// Writes the frames of the closed window, and begins the next one.
    fn frames(&mut self, out: &mut dyn FrameSink) -> Result<()> {
        let Self {
            owned,
            settings,
            chooser,
            frame,
            summary,
            busy,
            ..
        } = self;
        let codec = settings.codec();
        owned.with_dependent_mut(|_, Parts { window, encoder }| {
            let next = window.next_start();
            chooser.choose(encoder, window, busy)?;
            loop {
                let started = Instant::now();
                let encoded = codec.next_frame(encoder, window, frame);
                *busy += started.elapsed();
                match encoded {
                    Ok(Some(encoded)) => {
                        summary.add(&encoded.header, encoded.range.len());
                        write_frame(out, &encoded.header, &frame[encoded.range])?;
                    }
                    Ok(None) => break,
                    Err(_) => bail!(Refused, "{}", NO_ROOM),
                }
            }
            window.follow(next);
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use event_types::stream::MemoryReader;
    use event_types::{Polarity, Sensor};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};

    use super::super::encode;
    use super::super::options::{CoderName, EncodeOptions, ModeName};
    use super::*;

    const SENSOR: Sensor = Sensor {
        width: 64,
        height: 48,
    };

    /// Events of which some come late by a little, with a silence and a clock that falls back.
    fn events() -> Vec<Event> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(43);
        (0..60_000_u64)
            .map(|i| {
                let noise = u64::from(random.next_u32() % 900);
                let base = match i {
                    0..20_000 => 1_000_000 + 9 * i,
                    20_000..40_000 => 9_000_000 + 4 * i,
                    _ => 2 * i,
                };
                Event {
                    t_us: base + noise,
                    x: (random.next_u32() % 64) as u16,
                    y: (random.next_u32() % 48) as u16,
                    polarity: Polarity::from_bool(random.next_u32() % 2 == 0),
                }
            })
            .collect()
    }

    #[test]
    fn frames_are_those_of_a_reader_in_any_portions() {
        let events = events();
        for options in [
            EncodeOptions::default(),
            EncodeOptions {
                coder: Some(CoderName::Dense),
                keep_order: true,
                ..EncodeOptions::default()
            },
            EncodeOptions {
                coder: Some(CoderName::Quick),
                ..EncodeOptions::default()
            },
            EncodeOptions {
                mode: ModeName::Transform,
                ..EncodeOptions::default()
            },
            EncodeOptions {
                bytes_per_second: std::num::NonZeroU32::new(40_000),
                ..EncodeOptions::default()
            },
        ] {
            let config = options.config_of_file(SENSOR).unwrap();
            let mut wanted = Vec::new();
            let mut reader = MemoryReader::new(SENSOR, events.clone());
            let of_reader = encode(
                &mut reader,
                config,
                Limits::default(),
                NonZeroUsize::MIN,
                &mut wanted,
                &mut |_| {},
            )
            .unwrap();
            for portion in [1, 977, events.len()] {
                let mut encoder =
                    PushEncoder::new(Settings::from(config), Limits::default()).unwrap();
                let mut frames = Vec::new();
                for events in events.chunks(portion) {
                    encoder.push(events, &mut frames).unwrap();
                }
                let summary = encoder.finish(&mut frames).unwrap();
                assert!(frames == wanted, "{options:?} by {portion}");
                assert_eq!(summary.events_in, of_reader.events_in);
                assert_eq!(summary.events_encoded, of_reader.events_encoded);
                assert_eq!(summary.windows, of_reader.windows);
            }
        }
    }

    #[test]
    fn nothing_pushed_is_nothing() {
        let config = EncodeOptions::default().config_of_file(SENSOR).unwrap();
        let encoder = PushEncoder::new(Settings::from(config), Limits::default()).unwrap();
        let mut frames = Vec::new();
        let summary = encoder.finish(&mut frames).unwrap();
        assert_eq!((summary.events_in, frames.len()), (0, 0));
    }
}
