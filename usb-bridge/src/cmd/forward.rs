//! `eecvs-usb forward`: a device's stream to many consumers at once.

use std::num::NonZeroUsize;
use std::time::Duration;

use anyhow::Result;
use clap::{Args, ValueEnum};
use eecvs_nostd::Event;
use host_harness::cmd::encode::{CodecOptions, LimitOptions};
use host_harness::cmd::output::{print, print_json, rows};
use host_harness::encode::{Codec, EncodeSummary, encode};
use host_harness::formats::EventReader;
use serde::Serialize;

use super::options::{DeviceOptions, StreamOptions, warn_of_losses};
use crate::forward::address::Address;
use crate::forward::consumer::Report as ConsumerReport;
use crate::forward::fan_out::FanOut;
use crate::forward::packetise::Packetiser;
use crate::queue::Taken;
use crate::record;
use crate::session::{Report, Session};
use crate::stop::Stop;

/// Time that consumers get at the end to take what is queued.
const GRACE: Duration = Duration::from_secs(3);

/// Send a device's events on, as frames or as they are, to any number of consumers: one that is slow,
/// stops reading or vanishes holds up neither the others nor the device, and what it lost is told
#[derive(Debug, Args)]
pub struct Forward {
    /// Where to: tcp://HOST:PORT, udp://HOST:PORT, unix:PATH, file:PATH, - for standard output; may be
    /// given several times
    #[arg(long, value_name = "URL", required = true)]
    to: Vec<Address>,

    /// What is sent
    #[arg(long = "as", value_enum, default_value = "frames")]
    what: What,

    /// Bytes that wait for each consumer, in MiB; beyond, the oldest are let go of and counted
    #[arg(long, value_name = "MIB", default_value_t = 16,
          value_parser = clap::value_parser!(u16).range(1..=4096))]
    consumer_queue_mib: u16,

    #[command(flatten)]
    device: DeviceOptions,

    #[command(flatten)]
    stream: StreamOptions,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    limits: LimitOptions,
}

/// What is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    /// Frames of docs/wire-format.md
    Frames,
    /// The device's own words in packets that say what they are
    Raw,
}

/// What a forward was.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(flatten)]
    session: Report,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoding: Option<EncodeSummary>,
    consumers: Vec<ConsumerReport>,
}

impl Forward {
    /// Forwards until Ctrl-C, a limit, or the end of the device.
    ///
    /// # Errors
    /// A device or a consumer that cannot be reached, a link that fails.
    pub fn run(self) -> Result<()> {
        let stop = Stop::on_signals()?;
        let fan_out = FanOut::start(&self.to, usize::from(self.consumer_queue_mib) << 20)?;
        let source = self.device.open(&self.codec, &stop)?;
        let session = Session::start(
            source,
            self.stream.queue_bytes(),
            &stop,
            self.stream.limits(),
        )?;
        let mut fan_out = fan_out;
        let (encoding, outcome) = match self.what {
            What::Raw => (None, raw(&session, &mut fan_out)),
            What::Frames if self.device.sets_up() => {
                (None, record::encoders_frames(&session, &mut fan_out))
            }
            What::Frames => match self.frames(&session, &mut fan_out) {
                Ok(summary) => (Some(summary), Ok(())),
                Err(error) => (None, Err(error)),
            },
        };
        let (report, unstopped) = session.finish();
        let consumers = fan_out.finish(GRACE);
        warn_of_losses(&report);
        for consumer in &consumers {
            if consumer.lost.messages > 0 || consumer.failure.is_some() {
                eprintln!(
                    "eecvs-usb: {}: lost {} messages of {} events{}",
                    consumer.to,
                    consumer.lost.messages,
                    consumer.lost.events,
                    match &consumer.failure {
                        Some(failure) => format!(": {failure}"),
                        None => String::new(),
                    }
                );
            }
        }
        // Standard output may be a consumer's: the summary would stand in its stream.
        if !self.to.contains(&Address::Stdout) {
            let summary = Summary {
                session: report,
                encoding,
                consumers,
            };
            if self.stream.json {
                print_json(&summary)?;
            } else {
                print(&summary.table())?;
            }
        }
        outcome?;
        unstopped.map_or(Ok(()), Err)
    }

    fn frames(&self, session: &Session, fan_out: &mut FanOut) -> Result<EncodeSummary> {
        let reader: Box<dyn EventReader> = Box::new(session.reader());
        let config = self.codec.config(reader.sensor())?;
        let (mut reader, config) = self.codec.look(reader, config);
        let hot = self.codec.hot_pixels(reader.sensor())?;
        let codec = Codec {
            hot: &hot,
            ..Codec::from(config)
        };
        encode(
            reader.as_mut(),
            codec,
            self.limits.limits(),
            NonZeroUsize::MIN,
            fan_out,
            &mut |_| {},
        )
    }
}

/// The device's words in packets.
fn raw(session: &Session, fan_out: &mut FanOut) -> Result<()> {
    let encoding = format!("{}/{}", session.model.name(), session.info.stream);
    let mut packetiser = Packetiser::new(encoding, session.follower());
    let mut events: Vec<Event> = Vec::new();
    loop {
        let chunk = match session.pumped.queue.take(Duration::from_millis(100)) {
            Taken::Item(chunk) => chunk,
            Taken::Nothing => {
                packetiser.tell();
                continue;
            }
            Taken::Closed => break,
        };
        packetiser.chunk(&chunk, &mut events, &mut |packet, events| {
            fan_out.give(packet, events);
        });
        session.pumped.reuse(chunk.bytes);
    }
    packetiser.tell();
    session.outcome()
}

impl Summary {
    fn table(&self) -> String {
        let mut table = self.session.table();
        for consumer in &self.consumers {
            table += &rows([
                ("to", consumer.to.clone()),
                ("  messages sent", consumer.sent.messages.to_string()),
                ("  messages lost", consumer.lost.messages.to_string()),
                ("  events sent", consumer.sent.events.to_string()),
                ("  events lost", consumer.lost.events.to_string()),
                ("  bytes sent", consumer.sent.bytes.to_string()),
                ("  reconnects", consumer.reconnects.to_string()),
                ("  queue peak, bytes", consumer.queue_peak_bytes.to_string()),
            ]);
        }
        table
    }
}
