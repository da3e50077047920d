//! `encode`: turns messages of events into frames.

use std::time::Duration;

use anyhow::{Context as _, Result};
use clap::Args;
use eecvs::encode::{EncodeSummary, Limits, WINDOW_EVENTS};
use eecvs_cli::codec::CodecOptions;
use eecvs_cli::order::OrderOptions;
use eecvs_nostd::OUTPUT_BYTES_MIN;

use super::frames::FrameSender;
use super::{Context, Now, QosOptions, refuse_losses};
use crate::message::{DATA_BYTES, EventPacket};
use crate::operator::{Encoded, Job, Operators, Span};
use crate::packet_reader::{PacketReader, Received, look};

/// Topics that the node publishes.
pub const PUBLISHES: &[&str] = &["frames"];

/// Encode the events on `events` into frames: eecvs_msgs/msg/Frame on `frames`
#[derive(Debug, Clone, Args)]
pub struct Encode {
    /// Operator that encodes
    #[arg(long, value_name = "NAME", default_value = "eecvs")]
    operator: String,

    /// Maximum bytes of a frame: larger windows are split into several frames, as larger messages are more likely
    /// to be lost
    #[arg(long, value_name = "BYTES", default_value_t = DATA_BYTES,
          value_parser = clap::value_parser!(u32)
              .range(OUTPUT_BYTES_MIN as i64..=eecvs_nostd::FRAME_BYTES_MAX as i64))]
    frame_bytes: u32,

    /// Name of the sensor in the headers
    #[arg(long, value_name = "NAME", default_value = "event_camera")]
    frame_id: String,

    /// End after this many seconds without events, once one has arrived
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    order: OrderOptions,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Default duration of a window, in microseconds: at 5 million events per second, its frame arrives elsewhere
/// within 2 ms of the window's end (see the table in the README).
pub const WINDOW_US: &str = "4000";

/// Interval at which losses are reported.
const TELL: Duration = Duration::from_secs(5);

impl Encode {
    /// Encodes until a stop is requested, or until no events arrive for the idle time.
    ///
    /// # Errors
    /// The operator is unknown or rejects its options, the transport fails, or something was lost and the options do
    /// not allow it.
    pub fn run(self, mut context: Context, operators: &Operators) -> Result<()> {
        let operator = operators.find(&self.operator).with_context(|| {
            let names = operators.names();
            format!(
                "unknown operator {:?}; known operators: {names}",
                self.operator
            )
        })?;
        let qos = self.qos.qos();
        let subscription = context.one_publisher::<EventPacket>("events", qos)?;
        let mut sender = FrameSender::new(&mut context, qos, operator.name(), &self.frame_id)?;
        let idle = self.idle_s.map(|s| Duration::from_secs(s.into()));
        let reader = match PacketReader::begin(subscription, &context.stop, idle)? {
            Ok(reader) => reader,
            Err(received) => {
                tell_losses(&context, &received, &mut Received::default());
                return refuse_losses(self.order.allow_loss, &received.losses());
            }
        };
        let watch = reader.watch();
        let mut now = Now::every(TELL);
        let (mut told, mut disorder) = (Received::default(), Disorder::default());
        let job = Job {
            codec: &self.codec,
            limits: Limits {
                window_events: WINDOW_EVENTS,
                frame_bytes: self.frame_bytes as usize,
                reorder_us: self.order.reorder_us,
                ..Limits::default()
            },
        };
        let summary = operator.encode(Box::new(reader), &job, &mut |encoded| {
            let received = look(&watch);
            let Span {
                t0_us, duration_us, ..
            } = encoded.span;
            let end_us = t0_us.saturating_add(duration_us.into());
            disorder.add(&encoded);
            sender.send(encoded, received.stamp_at(end_us))?;
            if now.is_due() {
                tell_losses(&context, &received, &mut told);
                disorder.tell(&context);
            }
            Ok(())
        })?;
        let received = look(&watch);
        tell_losses(&context, &received, &mut told);
        disorder.tell(&context);
        context.say(&line(&received, &summary));
        let [lost, refused, others] = received.losses();
        let late =
            "events came too late and are in no frame (a longer --reorder-us puts them in order)";
        let losses = [
            lost,
            refused,
            others,
            (summary.events_late, late),
            (
                summary.events_dropped,
                "events found no room in the encoder",
            ),
        ];
        refuse_losses(self.order.allow_loss, &losses)
    }
}

/// Clock resets and late events that have not been reported yet.
#[derive(Debug, Default)]
struct Disorder {
    resets: u64,
    late: u64,
}

impl Disorder {
    fn add(&mut self, encoded: &Encoded<'_>) {
        self.resets += u64::from(encoded.begins_run);
        self.late += u64::from(encoded.late);
    }

    fn tell(&mut self, context: &Context) {
        let Self { resets, late } = std::mem::take(self);
        if resets > 0 {
            context.say(&format!(
                "clock restarts: {resets}; frames hold all events; if the clock did not restart \
                 and events only arrived late, a longer --reorder-us puts them in order"
            ));
        }
        if late > 0 {
            context.say(&format!("{late} events came too late and are in no frame"));
        }
    }
}

fn tell_losses(context: &Context, received: &Received, told: &mut Received) {
    let lost = received.sequence.lost;
    if lost > told.sequence.lost {
        context.say(&format!("{lost} event messages have not arrived"));
    }
    if received.refused > told.refused {
        let why = received.why_refused.as_deref().unwrap_or_default();
        context.say(&format!(
            "{} event messages were left out: {why}",
            received.refused
        ));
    }
    *told = received.clone();
}

fn line(received: &Received, summary: &EncodeSummary) -> String {
    format!(
        "{} events of {} messages ({} lost, {} left out, {} of another publisher) in {} runs of the clock: {} encoded, \
         {} late, {} filtered, {} dropped, {} thinned; {} frames of {} bytes",
        summary.events_in,
        received.packets,
        received.sequence.lost,
        received.refused,
        received.others,
        summary.runs,
        summary.events_encoded,
        summary.events_late,
        summary.events_filtered,
        summary.events_dropped,
        summary.events_thinned,
        summary.frames,
        summary.bytes_out
    )
}
