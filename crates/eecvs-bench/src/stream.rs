//! Takes a long stream of events through an encoder and a decoder at once, as two threads with a pipe between them:
//! do its memory and its rate stay what they were at its start, and is every event the same at its end?

use std::io::{BufWriter, pipe};
use std::num::NonZeroUsize;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use eecvs::decode::WindowReader;
use eecvs::encode::{Limits, encode};
use eecvs::frame_file::{FrameFileWriter, FrameReader};
use eecvs_nostd::{Coder, Config, Event, Fidelity, Hybrid, Mode, Sensor, Thresholds, WindowConfig};
use event_emulator::Preset;
use event_files::{EventReader, Pause, Skipped};
use serde::{Deserialize, Serialize};

use crate::machine::SEED;
use crate::repeated::Repeated;
use crate::source::{Source, WINDOW_US};

/// Scene whose events are repeated, and its duration.
const PRESET: Preset = Preset::OutdoorWellLitBlur;
const SCENE_US: u64 = 2_000_000;
/// Duration whose rates at both ends are compared, if the stream takes five times as long; else a fifth of it.
const SPAN: Duration = Duration::from_secs(60);
/// How often the rate and the memory are looked at.
const TICK: Duration = Duration::from_millis(500);

/// One stream; the fields are its JSON keys.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the coder.
    pub coder: String,
    /// Number of events that were encoded, and that came back.
    pub events: u64,
    /// Size of all frames in bytes.
    pub bytes: u64,
    /// Duration in s.
    pub seconds: f64,
    /// Events decoded per second in the first part.
    pub first_per_s: f64,
    /// Events decoded per second in the last part.
    pub last_per_s: f64,
    /// Duration of either part in s.
    pub part_s: f64,
    /// Memory of the process after the first part, in bytes; 0 where that is not known.
    pub first_memory: u64,
    /// Most memory of the process after that, in bytes; 0 where that is not known.
    pub most_memory: u64,
}

/// Encodes and decodes `events` events without loss with a coder of that name, in windows of 32,768 us.
///
/// # Errors
/// Fails if events are missing at the end or are not those that were encoded, by the sum of a hash of each.
pub fn measure(name: &str, coder: Coder, events: u64) -> Result<Row> {
    let (scene, config) = scene(coder)?;
    let (output, input) = pipe().context("cannot open a pipe")?;
    let started = Instant::now();
    thread::scope(|scope| {
        let encoder = scope.spawn(|| -> Result<(u64, u64)> {
            let mut reader = Summed {
                inner: Repeated::new(&scene.events, events, scene.sensor),
                sum: 0,
            };
            let mut frames = FrameFileWriter::stream(BufWriter::new(input));
            let one = NonZeroUsize::MIN;
            encode(
                &mut reader,
                config,
                Limits::default(),
                one,
                &mut frames,
                &mut |_| (),
            )?;
            let bytes = frames.bytes();
            frames
                .finish()?
                .into_inner()
                .context("the pipe is closed")?;
            Ok((reader.sum, bytes))
        });
        let mut ticks = Ticks::new(started);
        let mut windows = WindowReader::new(FrameReader::new(output));
        let mut sum = 0_u64;
        let mut decode = || -> Result<()> {
            while let Some(window) = windows.next_window()? {
                sum = add(sum, &window.events);
                ticks.add(window.events.len() as u64);
                windows.reuse(window);
            }
            Ok(())
        };
        let decoded = decode();
        let report = windows.report().clone();
        // An encoder that still writes ends at a closed pipe.
        drop(windows);
        let encoded = encoder
            .join()
            .map_err(|_| anyhow::anyhow!("the encoder panicked"))?;
        // What ended the encoder explains what the decoder met.
        let (encoded, bytes) = encoded?;
        decoded?;
        ensure!(report.is_clean(), "{report:?}");
        ensure!(ticks.events == events, "{} events came back", ticks.events);
        ensure!(sum == encoded, "other events came back");
        Ok(ticks.row(name, bytes))
    })
}

/// Returns the scene whose events are repeated, and the configuration of a coder for it.
pub(crate) fn scene(coder: Coder) -> Result<(Source, Config)> {
    let scene = Source::scene(PRESET, SEED, SCENE_US)?;
    let config = Config::new(
        WindowConfig::new(scene.sensor, WINDOW_US),
        // Unused: no transform is chosen.
        Thresholds::new(0, 0).context("thresholds of 0")?,
        Mode::Hybrid(Hybrid {
            coder,
            fidelity: Fidelity::Lossless,
        }),
    );
    Ok((scene, config))
}

/// Adds a hash of each event to a sum, which does not depend on their order.
pub(crate) fn add(sum: u64, events: &[Event]) -> u64 {
    events.iter().fold(sum, |sum, event| {
        let place = u64::from(event.x) << 17 | u64::from(event.y) << 1;
        let on = u64::from(event.polarity.sign() > 0);
        // The finaliser of MurmurHash3 over both.
        let mut hash = event.t_us.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (place | on);
        hash = (hash ^ hash >> 33).wrapping_mul(0xFF51_AFD7_ED55_8CCD);
        hash = (hash ^ hash >> 33).wrapping_mul(0xC4CE_B9FE_1A85_EC53);
        sum.wrapping_add(hash ^ hash >> 33)
    })
}

/// A reader that sums what it reads.
struct Summed<'e> {
    inner: Repeated<'e>,
    sum: u64,
}

impl EventReader for Summed<'_> {
    fn format(&self) -> &'static str {
        self.inner.format()
    }

    fn sensor(&self) -> Sensor {
        self.inner.sensor()
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let before = events.len();
        let count = self.inner.read(events)?;
        self.sum = add(self.sum, events.get(before..).unwrap_or_default());
        Ok(count)
    }

    fn skipped(&self) -> &Skipped {
        self.inner.skipped()
    }

    fn pause(&self) -> Pause {
        self.inner.pause()
    }
}

/// Looks at the clock and the memory now and then.
struct Ticks {
    started: Instant,
    events: u64,
    /// Time since the start, events until then, and memory then.
    seen: Vec<(Duration, u64, u64)>,
}

impl Ticks {
    fn new(started: Instant) -> Self {
        Self {
            started,
            events: 0,
            seen: vec![(started.elapsed(), 0, memory())],
        }
    }

    fn add(&mut self, events: u64) {
        self.events += events;
        let now = self.started.elapsed();
        if self
            .seen
            .last()
            .is_none_or(|(last, ..)| now - *last >= TICK)
        {
            self.seen.push((now, self.events, memory()));
        }
    }

    fn row(&self, coder: &str, bytes: u64) -> Row {
        let whole = self.started.elapsed();
        let part = SPAN.min(whole / 5);
        let end = (whole, self.events, memory());
        // At that time or the next look after it; the end if there was none.
        let at = |time: Duration| {
            let count = self.seen.partition_point(|(seen, ..)| *seen < time);
            self.seen.get(count).copied().unwrap_or(end)
        };
        let before = |time: Duration| {
            let count = self.seen.partition_point(|(seen, ..)| *seen <= time);
            let last = self.seen.get(count.saturating_sub(1));
            last.copied().unwrap_or_default()
        };
        let rate = |(from, first, _): (Duration, u64, u64), (to, last, _): (Duration, u64, u64)| {
            (last - first) as f64 / (to - from).as_secs_f64().max(1e-9)
        };
        let (begin, first, last) = (at(Duration::ZERO), at(part), before(whole - part));
        let after = self.seen.iter().filter(|(seen, ..)| *seen >= first.0);
        Row {
            coder: coder.to_owned(),
            events: self.events,
            bytes,
            seconds: whole.as_secs_f64(),
            first_per_s: rate(begin, first),
            last_per_s: rate(last, end),
            part_s: part.as_secs_f64(),
            first_memory: first.2,
            most_memory: after.map(|(.., memory)| *memory).max().unwrap_or(0),
        }
    }
}

/// Returns the memory of this process in bytes, or 0 where the system has no such file.
fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kibibytes = line.and_then(|line| line.trim().strip_suffix(" kB"));
    kibibytes
        .and_then(|count| count.parse().ok())
        .map_or(0, |count: u64| count << 10)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::Effort;

    use super::*;

    #[test]
    fn a_stream_comes_back_whole() {
        for coder in [Coder::Keys, Coder::Quick, Coder::Tree(Effort::One)] {
            let row = measure("a coder", coder, 100_001).unwrap();
            assert_eq!(row.events, 100_001);
            assert!(row.bytes > 100_001 && row.seconds > 0.0, "{row:?}");
            // A part of so short a stream may have seen no event.
            assert!((row.first_per_s + row.last_per_s).is_finite(), "{row:?}");
        }
    }

    #[test]
    fn the_sum_notices_one_bit_but_no_order() {
        let event = |t_us, x| Event {
            t_us,
            x,
            ..Event::UNSET
        };
        let of = |events: &[Event]| add(0, events);
        let [a, b, c] = [event(1, 2), event(2, 1), event(2, 2)];
        assert_eq!(of(&[a, b, c]), of(&[c, a, b]));
        assert_ne!(of(&[a, b]), of(&[a, c]));
        assert_ne!(of(&[a, a]), of(&[b, b]));
    }
}
