//! Chooses the duration of windows that suits a recording, by encoding its first events with several.
//!
//! Where many events share a pixel, short windows cost the fewest bits; in a quiet scene a longer window shares its
//! header and its active pixels between more events.

use std::cell::Cell;
use std::io::Write;
use std::num::NonZeroUsize;

use eecvs_nostd::{Axis, Config, Fidelity, Hybrid, Mode, Readout, Sensor, WindowConfig};
use event_types::ensure;
use event_types::stream::{Ahead, EventReader, MemoryReader, Pause, Result};

use super::{Codec, Limits, encode};
use crate::frame_file::FrameFileWriter;

/// Largest number of events that are encoded with each duration.
pub const EVENTS: usize = 1 << 18;
/// Durations that are tried, in microseconds.
pub const DURATIONS_US: [u32; 10] = [
    4_096, 8_192, 16_384, 32_768, 65_536, 131_072, 262_144, 524_288, 1_048_576, 2_097_152,
];
/// The shortest of these.
const SHORTEST_US: u32 = DURATIONS_US[0];
/// The longest of these.
const LONGEST_US: u32 = DURATIONS_US[DURATIONS_US.len() - 1];
/// Logarithms of the numbers of scans in windows that are tried for a sensor that scans.
const SCANS_LOG2: [u32; 4] = [6, 7, 8, 9];
/// Fewest windows of the first events for which a duration is tried, where more events follow.
const WINDOWS_MIN: u64 = 4;

/// Returns whether the duration of windows can be chosen for a configuration: in mode hybrid with exact times or within
/// a tolerance, and without a byte budget. Else it is part of what is asked for.
#[must_use]
pub const fn is_free(config: &Config) -> bool {
    let is_of_times = matches!(
        config.mode,
        Mode::Hybrid(Hybrid {
            fidelity: Fidelity::Lossless | Fidelity::ToleranceUs(_),
            ..
        })
    );
    is_of_times && config.bytes_per_second.is_none()
}

/// Reads a recording's first events, up to [`EVENTS`] and a batch more, and returns the reader, which delivers them
/// again, with the configuration that has the duration with the fewest bytes of those events' frame file.
///
/// It tries that of the configuration, and those of [`DURATIONS_US`] of which at least four lie in the events' span, or,
/// where these are all events, one, and one window of them all if it is of such a length; where [`Config::readout`] is
/// set, also windows of 64, 128, 256 and 512 scans. A live or growing source
/// is not waited for; a pipe is, until it has given as many events or ends.
///
/// # Errors
/// Configurations that are not [`is_free`], and a budget of the codec. Errors of the encoder.
pub fn look(
    reader: Box<dyn EventReader>,
    codec: Codec<'_>,
    limits: Limits,
    threads: NonZeroUsize,
) -> Result<(Box<dyn EventReader>, Config)> {
    let config = codec.config;
    ensure!(
        is_free(&config) && codec.budget.is_none(),
        Refused,
        "the duration of windows can be chosen for --mode hybrid, without --bins and --bytes-per-second"
    );
    let ahead = Ahead::new(reader, EVENTS);
    let events = ahead.events();
    let times = events.iter().map(|event| event.t_us);
    let span_us = match (times.clone().min(), times.max()) {
        (Some(first), Some(last)) => last - first,
        _ => 0,
    };
    let scans = config.readout.into_iter().flat_map(|readout| {
        SCANS_LOG2.map(|log2| scans_us(readout, config.window.sensor, 1 << log2))
    });
    let given_us = config.window.window_us;
    let is_whole = events.len() < EVENTS && matches!(ahead.pause(), Pause::Ended);
    let windows_min = if is_whole { 1 } else { WINDOWS_MIN };
    let durations = DURATIONS_US
        .into_iter()
        .chain(scans)
        .filter(|duration_us| u64::from(*duration_us) <= span_us / windows_min);
    let all_us = u32::try_from(span_us.saturating_add(1)).ok();
    let all_us = all_us.filter(|us| is_whole && (SHORTEST_US..=LONGEST_US).contains(us));
    let durations = durations.chain(all_us).filter(|us| *us != given_us);
    let mut best = None;
    for duration_us in [given_us].into_iter().chain(durations) {
        let config = Config {
            window: WindowConfig {
                window_us: duration_us,
                ..config.window
            },
            ..config
        };
        let mut reader = MemoryReader::new(ahead.sensor(), events.to_vec());
        let is_over = Cell::new(false);
        let mut out = FrameFileWriter::new(UpTo {
            left: best.map_or(u64::MAX, |(fewest, _)| fewest),
            is_over: &is_over,
        });
        let codec = Codec { config, ..codec };
        let outcome = encode(&mut reader, codec, limits, threads, &mut out, &mut |_| ());
        if is_over.get() {
            continue;
        }
        outcome?;
        let bytes = out.bytes();
        if best.is_none_or(|(fewest, _)| bytes < fewest) {
            best = Some((bytes, config));
        }
    }
    let config = best.map_or(config, |(_, config)| config);
    Ok((Box::new(ahead), config))
}

/// Writes nothing, and ends with an error once it was given too much: a duration that takes more bytes than another one
/// is not tried to its end, which in a recording of long pauses may be far.
struct UpTo<'c> {
    left: u64,
    is_over: &'c Cell<bool>,
}

impl Write for UpTo<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let Some(left) = self.left.checked_sub(bytes.len() as u64) else {
            self.is_over.set(true);
            return Err(std::io::ErrorKind::FileTooLarge.into());
        };
        self.left = left;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Returns the duration of a window that has at most `count` scans wherever it begins, in microseconds.
fn scans_us(readout: Readout, sensor: Sensor, count: u32) -> u32 {
    let lines = match readout.axis() {
        Axis::Columns => sensor.width,
        Axis::Rows => sensor.height,
    };
    let lag_q16 = u64::from(readout.slope_q16().unsigned_abs()) * u64::from(lines);
    // The first scan of a line is up to a scan before the window, a time is rounded to its nearest one.
    let scans_q16 = u64::from(count - 3) * u64::from(readout.period_q16());
    let duration_us = scans_q16.saturating_sub(lag_q16) >> 16;
    u32::try_from(duration_us.max(1)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use eecvs_nostd::{Coder, Effort, Event, Polarity, Scans, Thresholds};

    use super::*;

    fn config(sensor: Sensor) -> Config {
        let mode = Mode::Hybrid(Hybrid {
            coder: Coder::Tree(Effort::One),
            fidelity: Fidelity::Lossless,
        });
        let thresholds = Thresholds::new(0, 0).unwrap();
        Config::new(WindowConfig::new(sensor, 32_768), thresholds, mode)
    }

    fn chosen(events: &[Event], config: Config) -> Result<(Vec<Event>, u32)> {
        let reader = MemoryReader::new(config.window.sensor, events.to_vec());
        let (limits, one) = (Limits::default(), NonZeroUsize::MIN);
        let (mut reader, config) = look(Box::new(reader), config.into(), limits, one)?;
        let mut read = Vec::new();
        while reader.read(&mut read)? > 0 {}
        Ok((read, config.window.window_us))
    }

    /// A crowd of events, then a quiet scene: the window follows, and no event is lost.
    #[test]
    fn a_dense_scene_has_shorter_windows_than_a_sparse_one() {
        let sensor = Sensor::new(64, 48).unwrap();
        let events = |count: u64, gap_us: u64| -> Vec<Event> {
            let event = |i: u64| {
                let mixed = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
                Event {
                    t_us: 500 + i * gap_us / 16,
                    x: (mixed >> 20) as u16 % 64,
                    y: (mixed >> 40) as u16 % 48,
                    polarity: Polarity::from_bool(mixed >> 60 > 7),
                }
            };
            (0..count).map(event).collect()
        };
        let dense = events(300_000, 10);
        let sparse = events(20_000, 16_000);
        let (read, short_us) = chosen(&dense, config(sensor)).unwrap();
        assert_eq!(read, dense);
        let (read, long_us) = chosen(&sparse, config(sensor)).unwrap();
        assert_eq!(read, sparse);
        assert!(short_us < long_us, "{short_us} {long_us}");
        // All of a short recording is known: its windows may be as long as it, and no longer.
        let (read, whole_us) = chosen(&sparse[..700], config(sensor)).unwrap();
        assert_eq!(read, sparse[..700]);
        assert!((262_144..=700_000).contains(&whole_us), "{whole_us}");
        // Nothing to choose from.
        for events in [&[][..], &dense[..1]] {
            assert_eq!(chosen(events, config(sensor)).unwrap().1, 32_768);
        }
    }

    #[test]
    fn other_modes_are_refused() {
        let sensor = Sensor::new(64, 48).unwrap();
        let bins = Mode::Hybrid(Hybrid {
            coder: Coder::Fast,
            fidelity: Fidelity::Bins(8),
        });
        for mode in [Mode::Transform, bins] {
            let config = Config {
                mode,
                ..config(sensor)
            };
            assert!(chosen(&[], config).is_err());
        }
        let config = Config {
            bytes_per_second: std::num::NonZeroU32::new(100_000),
            ..config(sensor)
        };
        assert!(chosen(&[], config).is_err());
    }

    #[test]
    fn windows_of_scans_have_no_more_of_them() {
        let sensor = Sensor::new(320, 240).unwrap();
        for (axis, period, slope) in [
            (Axis::Columns, 197 << 16, -39_000),
            (Axis::Rows, 16 << 16, 3_000),
            (Axis::Columns, 250 << 16, 0),
        ] {
            let readout = Readout::new(axis, period, slope).unwrap();
            for count in SCANS_LOG2.map(|log2| 1 << log2) {
                let duration_us = scans_us(readout, sensor, count);
                for ago in [0, period / 2, period - 1] {
                    // The line that is read last has its first scan up to a period before the window.
                    let last = slope.max(0) * 319;
                    let phase = -last - ago as i32;
                    let scans = Scans::new(readout, phase, sensor, duration_us).unwrap();
                    assert!(scans.count() <= count, "{} {count}", scans.count());
                }
            }
        }
    }
}
