//! `delay`: measures how long after the end of its window a frame arrives, and what was lost.

use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use eecvs_cli::output::{print, print_json, rows};
use serde::Serialize;

use super::{Context, LossOptions, QosOptions, refuse_losses};
use crate::message::{Frame, Message as _, Time, from_cdr, sequence_of};
use crate::sequence::Sequence;

/// Measure how long after the end of their windows frames arrive on `frames`, and what is lost
#[derive(Debug, Clone, Args)]
pub struct Delay {
    /// Seconds to measure, from the first frame on
    #[arg(long, value_name = "S", default_value_t = 10)]
    seconds: u32,

    /// Leave out the delays of the first N frames
    #[arg(long, value_name = "N", default_value_t = 0)]
    skip: usize,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Longest wait before the stop request is checked again.
const WAIT: Duration = Duration::from_millis(20);

/// The measurement; the fields are the JSON keys.
#[derive(Debug, Serialize)]
struct Measured {
    frames: usize,
    frames_lost: u64,
    frames_malformed: u64,
    frames_of_others: u64,
    events: u64,
    bytes: u64,
    seconds: f64,
    events_per_s: f64,
    delay_p50_ms: f64,
    delay_p99_ms: f64,
    delay_max_ms: f64,
}

impl Delay {
    /// Measures for the set time, and prints the result.
    ///
    /// # Errors
    /// The transport fails, stdout cannot be written, or something was lost and the options do not allow it.
    pub fn run(self, mut context: Context) -> Result<()> {
        let mut subscription = context.one_publisher::<Frame>("frames", self.qos.qos())?;
        let mut delays_ns = Vec::new();
        let mut sequence = Sequence::default();
        let (mut malformed, mut events, mut bytes) = (0, 0, 0);
        let mut started = None;
        let length = Duration::from_secs(self.seconds.into());
        while !context.stop.is_asked() {
            if started.is_some_and(|started: Instant| started.elapsed() >= length) {
                break;
            }
            let Some(taken) = subscription.take(WAIT)? else {
                continue;
            };
            let now = Time::now();
            started.get_or_insert_with(Instant::now);
            if taken.is_new_publisher {
                sequence.restart();
            }
            if let Some(number) = sequence_of(Frame::TYPE, &taken.cdr) {
                sequence.follow(number);
            }
            let Ok(frame) = from_cdr::<Frame>(&taken.cdr) else {
                malformed += 1;
                continue;
            };
            events += u64::from(frame.events);
            bytes += frame.data.len() as u64;
            delays_ns.push(now.ns() - frame.header.stamp.ns());
        }
        let seconds = started.map_or(0.0, |started| started.elapsed().as_secs_f64());
        delays_ns.drain(..self.skip.min(delays_ns.len()));
        delays_ns.sort_unstable();
        let delay = |part: f64| match delays_ns.len() {
            0 => 0.0,
            // Nearest-rank percentile.
            n => delays_ns[((n as f64 * part).ceil() as usize).clamp(1, n) - 1] as f64 * 1e-6,
        };
        let measured = Measured {
            frames: delays_ns.len(),
            frames_lost: sequence.lost,
            frames_malformed: malformed,
            frames_of_others: subscription.left_out(),
            events,
            bytes,
            seconds,
            events_per_s: if seconds > 0.0 {
                events as f64 / seconds
            } else {
                0.0
            },
            delay_p50_ms: delay(0.5),
            delay_p99_ms: delay(0.99),
            delay_max_ms: delay(1.0),
        };
        let losses = [
            (measured.frames_lost, "frames have not arrived"),
            (measured.frames_malformed, "frames were malformed"),
            (
                measured.frames_of_others,
                "frames of another publisher were left out",
            ),
        ];
        if self.json {
            print_json(&measured)?;
            return refuse_losses(self.losses.allow_loss, &losses);
        }
        print(&rows([
            ("frames", measured.frames.to_string()),
            ("  lost", measured.frames_lost.to_string()),
            ("  malformed", measured.frames_malformed.to_string()),
            (
                "  of another publisher",
                measured.frames_of_others.to_string(),
            ),
            ("events", measured.events.to_string()),
            ("events per second", format!("{:.0}", measured.events_per_s)),
            ("bytes", measured.bytes.to_string()),
            ("delay, median, ms", format!("{:.3}", measured.delay_p50_ms)),
            ("  99th percentile", format!("{:.3}", measured.delay_p99_ms)),
            ("  largest", format!("{:.3}", measured.delay_max_ms)),
        ]))?;
        refuse_losses(self.losses.allow_loss, &losses)
    }
}
