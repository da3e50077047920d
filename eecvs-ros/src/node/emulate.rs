//! `emulate`: publishes a scene or a recording as a driver would.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use eecvs_cli::options::ReadingOptions;
use eecvs_cli::values::preset;
use eecvs_nostd::{Event, Sensor};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::{EventReader, Pause};
use usb_bridge::peripheral::stream::Pace;

use super::{Context, QosOptions, Sender};
use crate::message::{DATA_BYTES, EventPacket};
use crate::packing::{Encoding, Packer, PacketLimits};

/// Topics that the node publishes.
pub const PUBLISHES: &[&str] = &["events"];

/// Parameters that can be set while the node runs.
pub const CHANGEABLE: &[&str] = &["rate"];

/// Publish a scene or a recording as a camera's driver does: event_camera_msgs/msg/EventPacket on `events`
#[derive(Debug, Clone, Args)]
pub struct Emulate {
    /// Scene, one of those that `eecvs emulate --list` shows
    #[arg(long, value_parser = preset(), default_value = "indoor-flying")]
    scene: Preset,

    /// The same seed gives the same events on every machine
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Duration of the scene in microseconds [default: 1000000]
    #[arg(long, value_name = "D")]
    duration_us: Option<u64>,

    /// Recording to publish instead of a scene
    #[arg(long, value_name = "FILE")]
    recording: Option<PathBuf>,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Pace: real (as recorded), max (as fast as possible), N events per second, or Fx (F times as fast as
    /// recorded)
    #[arg(long, value_name = "real|max|N|Fx", default_value = "real")]
    rate: Pace,

    /// Start again at the end, with times that continue
    #[arg(long)]
    repeat: bool,

    /// Wait at most this many seconds for the first subscriber, so that it gets the first events
    #[arg(long, value_name = "S", default_value_t = 0)]
    wait_s: u32,

    #[command(flatten)]
    packets: PacketOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Options for packing events into messages.
#[derive(Debug, Clone, Args)]
pub struct PacketOptions {
    /// Encoding of events in messages
    #[arg(long, value_enum, default_value = "libcaer")]
    encoding: Encoding,

    /// Maximum time spanned by a message, in microseconds
    #[arg(long, value_name = "T", default_value_t = 1000)]
    packet_us: u32,

    /// Maximum bytes of events per message: larger messages are more likely to be lost
    #[arg(long, value_name = "BYTES", default_value_t = DATA_BYTES,
          value_parser = clap::value_parser!(u32).range(64..=100_000_000))]
    packet_bytes: u32,

    /// Name of the sensor in the headers
    #[arg(long, value_name = "NAME", default_value = "event_camera")]
    frame_id: String,
}

impl PacketOptions {
    /// Returns the name of the sensor.
    #[must_use]
    pub fn frame_id(&self) -> &str {
        &self.frame_id
    }

    /// Creates a packer for the events of a sensor.
    #[must_use]
    pub fn packer(&self, sensor: Sensor) -> Packer {
        let limits = PacketLimits::of(
            self.encoding,
            self.packet_bytes as usize,
            self.packet_us.into(),
        );
        Packer::new(sensor, self.encoding, limits, &self.frame_id)
    }
}

/// Counts of published events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Published {
    events: u64,
    /// Longest delay after the time at which events were due, in microseconds.
    late_us: u64,
}

impl Emulate {
    /// Publishes until the end, or until a stop is requested.
    ///
    /// # Errors
    /// The recording cannot be read, or the transport fails.
    pub fn run(self, mut context: Context) -> Result<()> {
        let mut sender = context.publisher::<EventPacket>("events", self.qos.qos())?;
        let sensor = self.open()?.sensor();
        context.wait_for_subscriber(&sender, Duration::from_secs(self.wait_s.into()));
        let mut packer = self.packets.packer(sensor);
        let mut pacer = Pacer::new(self.rate);
        let mut published = Published::default();
        let mut next_us = None;
        while !context.stop.is_asked() {
            let mut reader = self.open()?;
            let shifted = next_us;
            let played = self.play(
                &context,
                reader.as_mut(),
                shifted,
                &mut pacer,
                &mut packer,
                &mut sender,
                &mut published,
            )?;
            match played {
                Some(last_us) if self.repeat => next_us = Some(last_us + 1),
                _ => break,
            }
        }
        packer.flush(&mut |packet: &EventPacket, _| sender.send(packet))?;
        let sent = sender.sent();
        context.say(&format!(
            "{} events in {} messages of {} bytes, at most {} us late",
            published.events, sent.messages, sent.bytes, published.late_us
        ));
        Ok(())
    }

    fn open(&self) -> Result<Box<dyn EventReader>> {
        match &self.recording {
            Some(path) => Ok(event_files::open(path, self.reading.reading())?),
            None => {
                let mut config = SceneConfig::model_1(self.scene, self.seed);
                config.sensor = self.reading.sensor().unwrap_or(config.sensor);
                config.duration_us = self.duration_us.unwrap_or(config.duration_us);
                Ok(Box::new(emulate(config)?))
            }
        }
    }

    /// Publishes the reader's events to the end and returns the latest time published. For a repetition, `start_us`
    /// is the time that its first event gets.
    #[allow(clippy::too_many_arguments)]
    fn play(
        &self,
        context: &Context,
        reader: &mut dyn EventReader,
        start_us: Option<u64>,
        pacer: &mut Pacer,
        packer: &mut Packer,
        sender: &mut Sender<EventPacket>,
        published: &mut Published,
    ) -> Result<Option<u64>> {
        let mut events: Vec<Event> = Vec::new();
        let mut shift_us = None;
        let mut last_us = None;
        loop {
            events.clear();
            if reader.read(&mut events)? == 0 && reader.pause() == Pause::Ended {
                return Ok(last_us);
            }
            if let Some(first) = events.first() {
                let shift = *shift_us.get_or_insert_with(|| {
                    start_us.map_or(0, |start_us| start_us.wrapping_sub(first.t_us))
                });
                for event in &mut events {
                    event.t_us = event.t_us.wrapping_add(shift);
                }
            }
            let mut rest = events.as_slice();
            while let Some(first) = rest.first() {
                if context.stop.is_asked() {
                    return Ok(last_us);
                }
                // Events within the time span of one message are published together.
                let span_us = u64::from(self.packets.packet_us.max(1));
                let end_us = (first.t_us / span_us + 1).saturating_mul(span_us);
                let count = rest.iter().take_while(|event| event.t_us < end_us).count();
                let (now, later) = rest.split_at(count.max(1));
                let due_us = now.last().map_or(0, |event| event.t_us);
                let count = published.events + now.len() as u64;
                let late_us = loop {
                    let is_disturbed = || context.stop.is_asked() || context.has_changed();
                    let late_us = pacer.wait(due_us, count, &is_disturbed);
                    match context.changed::<Self>() {
                        Some(now) => pacer.set(now.rate),
                        None => break late_us,
                    }
                };
                if context.stop.is_asked() {
                    return Ok(last_us);
                }
                published.late_us = published.late_us.max(late_us);
                packer.push(now, |packet, _| sender.send(packet))?;
                published.events += now.len() as u64;
                last_us = last_us.max(Some(due_us));
                // The next batch may contain more events of the last message's time span.
                if !later.is_empty() {
                    packer.flush(&mut |packet: &EventPacket, _| sender.send(packet))?;
                }
                rest = later;
            }
        }
    }
}

/// Waits until events are due.
pub struct Pacer {
    pace: Pace,
    /// When its time began: by the clock, by the events' time, and by their number.
    start: Option<(Instant, u64, u64)>,
    /// Number and time of the latest event that was waited for.
    latest: (u64, Option<u64>),
}

/// Longest sleep before the stop request is checked again.
const LOOK: Duration = Duration::from_millis(50);

impl Pacer {
    /// Creates a pacer whose time begins with the first event.
    #[must_use]
    pub const fn new(pace: Pace) -> Self {
        Self {
            pace,
            start: None,
            latest: (0, None),
        }
    }

    /// Restarts the time at the next event.
    pub const fn restart(&mut self) {
        self.start = None;
        self.latest.1 = None;
    }

    /// Goes on at another pace, from the latest event that was waited for.
    pub const fn set(&mut self, pace: Pace) {
        self.pace = pace;
        self.start = None;
    }

    /// Waits until an event is due: the `count`th, of time `t_us`. Returns how late it is, in microseconds; 0 if
    /// the pace is unlimited or the wait was disturbed.
    pub fn wait(&mut self, t_us: u64, count: u64, is_disturbed: &dyn Fn() -> bool) -> u64 {
        let (counted, latest_us) = self.latest;
        let begin = || (Instant::now(), latest_us.unwrap_or(t_us), counted);
        let (at, first_us, first) = *self.start.get_or_insert_with(begin);
        let due_s = match self.pace {
            Pace::Max => 0.0,
            Pace::Recorded(factor) => t_us.saturating_sub(first_us) as f64 * 1e-6 / factor,
            Pace::Rate(per_second) => count.saturating_sub(first) as f64 / per_second,
        };
        let Some(due) = Duration::try_from_secs_f64(due_s)
            .ok()
            .and_then(|due| at.checked_add(due))
        else {
            return 0;
        };
        loop {
            if is_disturbed() {
                return 0;
            }
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() {
                self.latest = (count, Some(t_us));
                if matches!(self.pace, Pace::Max) {
                    return 0;
                }
                let late = Instant::now().saturating_duration_since(due);
                return u64::try_from(late.as_micros()).unwrap_or(u64::MAX);
            }
            std::thread::sleep(left.min(LOOK));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_pace_begins_where_the_last_one_ended() {
        let mut pacer = Pacer::new(Pace::Rate(100.0));
        let started = Instant::now();
        let never = || false;
        for count in 1..=10 {
            pacer.wait(count * 1000, count, &never);
        }
        let after = |from: Duration| {
            let elapsed = started.elapsed();
            let is_near = elapsed >= from && elapsed < from + Duration::from_millis(90);
            assert!(is_near, "{elapsed:?} after {from:?}");
        };
        after(Duration::from_millis(100));
        // Ten times as fast as recorded: 1 s takes 100 ms.
        pacer.set(Pace::Recorded(10.0));
        pacer.wait(1_010_000, 11, &never);
        after(Duration::from_millis(200));
        pacer.set(Pace::Rate(100.0));
        for count in 12..=21 {
            pacer.wait(count * 1000, count, &never);
        }
        after(Duration::from_millis(300));
        // A wait that is disturbed ends at once.
        pacer.set(Pace::Rate(0.001));
        assert_eq!(pacer.wait(0, 22, &|| true), 0);
        after(Duration::from_millis(300));
        pacer.set(Pace::Max);
        assert_eq!(pacer.wait(u64::MAX, 23, &never), 0);
        after(Duration::from_millis(300));
    }
}
