//! `density`: publishes the event density of every window, and the transform that it selects.

use std::num::NonZeroU32;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use eecvs::density_series::{DensitySeries, WindowDensity};
use eecvs_cli::options::ThresholdOptions;
use eecvs_nostd::{Regime, Sensor, Thresholds};
use event_files::{EventReader, Pause};

use super::{Context, LossOptions, Now, QosOptions, Sender, refuse_losses};
use crate::message::{
    Density, DiagnosticArray, DiagnosticStatus, EventPacket, Header, KeyValue, Level, Time,
};
use crate::packet_reader::{PacketReader, Received, Watch, look};

/// Topics that the node publishes.
pub const PUBLISHES: &[&str] = &["density", "/diagnostics"];

/// Publish the density, rate and regime of every window of the events on `events`: eecvs_msgs/msg/Density on `density`,
/// and a summary every second on `/diagnostics`
#[derive(Debug, Clone, Args)]
pub struct Monitor {
    /// Duration of a window in microseconds
    #[arg(long, value_name = "T", default_value = "32768")]
    window_us: NonZeroU32,

    /// Name of the sensor in the headers
    #[arg(long, value_name = "NAME", default_value = "event_camera")]
    frame_id: String,

    /// End after this many seconds without events, once one has arrived
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    thresholds: ThresholdOptions,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Interval at which diagnostics are published.
const DIAGNOSE: Duration = Duration::from_secs(1);

/// Counts events in windows on a grid, as the encoder cuts them.
struct Count {
    window_us: u64,
    t0_us: Option<u64>,
    events: u32,
    /// Events from before their open window, which are in no window.
    late: u64,
}

impl Count {
    /// Counts an event; returns the start and the number of events of a window that it ends. An event from before
    /// the open window is late, as in the encoder.
    fn push(&mut self, t_us: u64) -> Option<(u64, u32)> {
        let ended = self.pass(t_us);
        if t_us >= *self.t0_us.get_or_insert(t_us) {
            self.events = self.events.saturating_add(1);
        } else {
            self.late += 1;
        }
        ended
    }

    /// Ends the open window if its time is over at `now_us`; returns its start and number of events if it has any.
    fn pass(&mut self, now_us: u64) -> Option<(u64, u32)> {
        let t0_us = self.t0_us?;
        let passed = now_us.saturating_sub(t0_us) / self.window_us;
        if passed == 0 {
            return None;
        }
        self.t0_us = Some(t0_us + passed * self.window_us);
        let events = std::mem::take(&mut self.events);
        (events > 0).then_some((t0_us, events))
    }
}

/// The publishers of the node, and what they last published.
struct Outputs<'a> {
    frame_id: &'a str,
    thresholds: Thresholds,
    density: Sender<Density>,
    diagnostics: Sender<DiagnosticArray>,
    seq: u64,
    latest: Option<WindowDensity>,
    told: Received,
}

impl Monitor {
    /// Publishes until a stop is requested, or until no events arrive for the idle time.
    ///
    /// # Errors
    /// The thresholds file cannot be read, the transport fails, or something was lost and the options do not allow
    /// it.
    pub fn run(self, mut context: Context) -> Result<()> {
        let thresholds = self.thresholds.load()?;
        let qos = self.qos.qos();
        let subscription = context.one_publisher::<EventPacket>("events", qos)?;
        let mut outputs = Outputs {
            frame_id: &self.frame_id,
            thresholds,
            density: context.publisher("density", qos)?,
            diagnostics: context.publisher("/diagnostics", qos)?,
            seq: 0,
            latest: None,
            told: Received::default(),
        };
        let idle = self.idle_s.map(|s| Duration::from_secs(s.into()));
        let mut reader = match PacketReader::begin(subscription, &context.stop, idle)? {
            Ok(reader) => reader,
            Err(received) => return refuse_losses(self.losses.allow_loss, &received.losses()),
        };
        let watch = reader.watch();
        let window_us = u64::from(self.window_us.get());
        let mut series = DensitySeries::new(reader.sensor(), window_us, thresholds);
        let mut count = Count {
            window_us,
            t0_us: None,
            events: 0,
            late: 0,
        };
        let mut diagnose = Now::every(DIAGNOSE);
        let mut events = Vec::new();
        loop {
            events.clear();
            let read = reader.read(&mut events)?;
            let mut ended: Vec<(u64, u32)> = Vec::new();
            ended.extend(events.iter().filter_map(|event| count.push(event.t_us)));
            let pause = reader.pause();
            if read == 0 {
                match pause {
                    Pause::Ended => break,
                    Pause::Until(now_us) => ended.extend(count.pass(now_us)),
                }
            }
            for (t0_us, events) in ended {
                let window = series.add(t0_us, self.window_us.get(), events);
                outputs.window(window, reader.sensor(), &watch)?;
            }
            if diagnose.is_due() {
                outputs.diagnose(context.name(), &watch)?;
            }
        }
        let received = look(&watch);
        context.say(&format!(
            "{} windows of {} events in {} messages ({} lost, {} left out, {} of another publisher); {} events late",
            outputs.seq,
            received.events,
            received.packets,
            received.sequence.lost,
            received.refused,
            received.others,
            count.late
        ));
        let [lost, refused, others] = received.losses();
        let late = (count.late, "events came too late and are in no window");
        refuse_losses(self.losses.allow_loss, &[lost, refused, others, late])
    }
}

impl Outputs<'_> {
    fn header(&self, stamp: Time) -> Header {
        Header {
            stamp,
            frame_id: self.frame_id.to_owned(),
        }
    }

    fn window(&mut self, window: WindowDensity, sensor: Sensor, watch: &Watch) -> Result<()> {
        let received = look(watch);
        let duration_s = f64::from(window.duration_us) * 1e-6;
        let end_us = window.t0_us.saturating_add(window.duration_us.into());
        let message = Density {
            header: self.header(received.stamp_at(end_us)),
            seq: self.seq,
            t0_us: window.t0_us,
            duration_us: window.duration_us,
            height: sensor.height.into(),
            width: sensor.width.into(),
            events: window.events,
            packets_lost: received.sequence.lost,
            rate_eps: f64::from(window.events) / duration_s,
            density: window.density_per_px_s,
            tau_low: self.thresholds.tau_low_pico() as f64 * 1e-12,
            tau_high: self.thresholds.tau_high_pico() as f64 * 1e-12,
            regime: match window.regime {
                Regime::Sparse => 0,
                Regime::Moderate => 1,
                Regime::Dense => 2,
            },
            transform: window.regime.transform().name().to_owned(),
        };
        self.density.send(&message)?;
        self.seq += 1;
        self.latest = Some(window);
        Ok(())
    }

    fn diagnose(&mut self, name: &str, watch: &Watch) -> Result<()> {
        let received = look(watch);
        let has_new = received.packets > self.told.packets;
        let has_lost = received.sequence.lost > self.told.sequence.lost
            || received.refused > self.told.refused
            || received.others > self.told.others;
        let (level, message) = match (has_new, has_lost) {
            (false, _) => (Level::Stale, "no events"),
            (true, true) => (Level::Warn, "event messages were lost"),
            (true, false) => (Level::Ok, "events arrive"),
        };
        let figure = |key: &str, value: String| KeyValue {
            key: key.to_owned(),
            value,
        };
        let mut values = vec![
            figure("packets", received.packets.to_string()),
            figure("packets_lost", received.sequence.lost.to_string()),
            figure("packets_left_out", received.refused.to_string()),
            figure("packets_of_another_publisher", received.others.to_string()),
            figure("events", received.events.to_string()),
        ];
        if let Some(latest) = self.latest {
            let duration_s = f64::from(latest.duration_us) * 1e-6;
            let rate_eps = f64::from(latest.events) / duration_s;
            values.push(figure("rate_eps", format!("{rate_eps:.0}")));
            values.push(figure("density", format!("{:.4}", latest.density_per_px_s)));
            values.push(figure("regime", latest.regime.name().to_owned()));
        }
        self.diagnostics.send(&DiagnosticArray {
            header: self.header(Time::now()),
            status: vec![DiagnosticStatus {
                level: level.into(),
                name: format!("{name}: {}", self.frame_id),
                message: message.to_owned(),
                hardware_id: self.frame_id.to_owned(),
                values,
            }],
        })?;
        self.told = received;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_cut_as_the_encoder_cuts_them() {
        let mut count = Count {
            window_us: 100,
            t0_us: None,
            events: 0,
            late: 0,
        };
        let mut ended = Vec::new();
        for t_us in [1005, 1010, 1104, 1105, 1100, 1404, 1405] {
            ended.extend(count.push(t_us));
        }
        assert_eq!(ended, [(1005, 3), (1105, 1), (1305, 1)]);
        assert_eq!(count.late, 1);
        assert_eq!(count.pass(1504), None);
        assert_eq!(count.pass(1505), Some((1405, 1)));
        assert_eq!(count.pass(9999), None);
    }
}
