//! `eecvs-usb forward`: sends a device's stream to many consumers at once.

use std::cell::Cell;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use clap::{Args, ValueEnum};
use eecvs::encode::{Codec, EncodeSummary};
use eecvs_cli::codec::{CodecOptions, LimitOptions};
use eecvs_cli::output::{Place, rows};
use eecvs_nostd::Event;
use event_files::EventReader;
use event_files::output::{self, Kind, is_stdout};
use serde::Serialize;

use super::options::{
    DeviceOptions, StreamOptions, is_one_place, order_rows, refuse_late, warn_of_losses,
    warn_of_runs,
};
use super::warn;
use crate::forward::address::Address;
use crate::forward::consumer::Report as ConsumerReport;
use crate::forward::fan_out::{FanOut, NobodyLeft};
use crate::forward::packetise::Packetiser;
use crate::queue::Taken;
use crate::record::{self, Kept, Order};
use crate::session::{Report, Session};
use crate::stop::Stop;

/// Time that consumers get at the end to take what is queued.
const GRACE: Duration = Duration::from_secs(3);

/// The same where Ctrl-C or a signal ended the stream: somebody waits.
const HURRY: Duration = Duration::from_millis(150);

/// Send a device's events, as frames or as raw packets, to any number of consumers: one that is slow, stops reading
/// or vanishes holds up neither the others nor the device, and its losses are reported
#[derive(Debug, Args)]
pub struct Forward {
    /// Destination: tcp://HOST:PORT, udp://HOST:PORT, unix:PATH, file:PATH, or - for standard output; may be given
    /// several times. A consumer that cannot be reached is tried again until the end
    #[arg(long, value_name = "URL", required = true)]
    to: Vec<Address>,

    /// Overwrite existing files
    #[arg(long)]
    overwrite: bool,

    /// What to send
    #[arg(long = "as", value_enum, default_value = "frames")]
    what: What,

    /// Queue of each consumer, in MiB; when it is full, the oldest messages are dropped and counted
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

/// Form in which events are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    /// Frames as in docs/wire-format.md
    Frames,
    /// The device's own words, in packets that name their encoding
    Raw,
}

/// Summary of a forward.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(flatten)]
    session: Report,
    /// Runs of the clock in the frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    runs: Option<u64>,
    /// Events that came too late and are in no frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    events_late: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoding: Option<EncodeSummary>,
    consumers: Vec<ConsumerReport>,
}

impl Forward {
    /// Forwards until Ctrl-C, a limit, or the end of the device's stream or of all consumers.
    ///
    /// # Errors
    /// The device cannot be used, the link fails, a file is incomplete, or a consumer was never reached.
    pub fn run(self) -> Result<()> {
        self.check()?;
        let stop = Stop::on_signals()?;
        let source = self.device.open(&self.codec, &stop)?;
        let queue_bytes = usize::from(self.consumer_queue_mib) << 20;
        let mut fan_out =
            FanOut::start(&self.to, queue_bytes, self.overwrite, &|| !stop.is_asked())?;
        for absent in fan_out.reports() {
            if let Some(failure) = absent.failure {
                warn(&format!(
                    "{}: {failure}: trying again until the end",
                    absent.to
                ));
            }
        }
        let session = Session::start(
            source,
            self.stream.queue_bytes(),
            &stop,
            self.stream.limits(),
        )?;
        let mut kept = Kept::default();
        let outcome = match self.what {
            What::Raw => raw(&session, &mut fan_out),
            What::Frames if self.device.sets_up() => {
                record::encoders_frames(&session, &mut fan_out, &mut kept.order)
            }
            What::Frames => self.frames(&session, &mut fan_out, &mut kept),
        };
        let Kept { order, encoding } = kept;
        // The failure of each consumer is reported separately.
        let outcome = outcome.or_else(|error| match NobodyLeft::is_cause_of(&error) {
            true => Ok(()),
            false => Err(error),
        });
        let (report, unstopped) = session.finish();
        let signalled = Cell::new(None);
        let goes_on = || match (stop.is_signalled(), signalled.get()) {
            (false, _) => true,
            (true, None) => {
                signalled.set(Some(Instant::now()));
                true
            }
            (true, Some(since)) => since.elapsed() < HURRY,
        };
        let consumers = fan_out.finish(GRACE, &goes_on, outcome.is_ok());
        warn_of_losses(&report);
        warn_of_runs(&report.device, &order);
        let mut failed = Vec::new();
        for (consumer, to) in consumers.iter().zip(&self.to) {
            match trouble(consumer, to) {
                Some((line, true)) if outcome.is_ok() => failed.push(line),
                Some((line, _)) => warn(&line),
                None => {}
            }
        }
        let has_order = self.what == What::Frames && (outcome.is_ok() || order.runs > 0);
        let summary = Summary {
            session: report,
            runs: has_order.then_some(order.runs),
            events_late: has_order.then_some(order.events_late),
            encoding,
            consumers,
        };
        // If standard output is a consumer, a summary there would be part of its stream.
        let place = Place::unless_taken(
            self.to.iter().any(is_on_stdout) || self.device.place().is_on_stdout(),
        );
        place.tell(self.stream.json, &summary, || summary.table(&order))?;
        outcome?;
        ensure!(failed.is_empty(), "{}", failed.join("; "));
        refuse_late(&summary.session.device, &order, self.limits.order)?;
        unstopped.map_or(Ok(()), Err)
    }

    /// Refuses unusable consumers before any work is done.
    fn check(&self) -> Result<()> {
        let kind = match self.what {
            What::Frames => Kind::Frames,
            What::Raw => Kind::Stream,
        };
        let place = self.device.place();
        let inputs: Vec<&Path> = self.codec.files().chain(place.files()).collect();
        let mut files: Vec<&Path> = Vec::new();
        for (i, to) in self.to.iter().enumerate() {
            ensure!(!self.to[..i].contains(to), "--to {to}: given twice");
            let path = match to {
                Address::File(path) => path.as_path(),
                Address::Stdout => {
                    files.push(Path::new("-"));
                    continue;
                }
                Address::Tcp(_) | Address::Udp(_) | Address::Unix(_) => continue,
            };
            output::check(path, kind, self.overwrite, &inputs)?;
            ensure!(
                self.what == What::Frames || path.extension().is_none_or(|end| end != "stream"),
                "{to}: a .stream file is written by capture and holds no packets: give the file \
                 another extension"
            );
            if let Some(other) = files.iter().find(|other| is_one_place(other, path)) {
                bail!("{to}: the same file as {}", other.display());
            }
            files.push(path);
        }
        let read: Vec<&Path> = self.codec.files().collect();
        place.check_trace(self.overwrite, &files, &read)
    }

    fn frames(&self, session: &Session, fan_out: &mut FanOut, kept: &mut Kept) -> Result<()> {
        let reader: Box<dyn EventReader> = Box::new(session.reader_of_sensor()?);
        let config = self.codec.config(reader.sensor())?;
        let (reader, config) = self.codec.look(reader, config);
        let hot = self.codec.hot_pixels(reader.sensor())?;
        let codec = Codec {
            hot: &hot,
            max_nmse: self.codec.max_nmse(),
            ..Codec::from(config)
        };
        record::encode_live(reader, codec, self.limits.limits(), fan_out, kept)
    }
}

/// Sends the device's words in packets.
fn raw(session: &Session, fan_out: &mut FanOut) -> Result<()> {
    let encoding = format!("{}/{}", session.model.name(), session.info.stream);
    let mut packetiser = Packetiser::new(encoding, session.follower());
    let mut events: Vec<Event> = Vec::new();
    while !fan_out.is_over() {
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

/// Returns a line about a consumer that did not get everything, and whether that fails the command. A consumer that
/// is slow or leaves is only reported; one that was never reached, or an incomplete file, fails the command.
fn trouble(consumer: &ConsumerReport, to: &Address) -> Option<(String, bool)> {
    // Over UDP it is unknown whether anyone listens until a datagram was sent.
    let is_unknown = matches!(to, Address::Udp(_)) && consumer.lost.messages == 0;
    let is_absent = !consumer.reached && !is_unknown;
    let has_trouble = consumer.lost.messages > 0 || consumer.failure.is_some() || is_absent;
    if !has_trouble || consumer.is_closed {
        return None;
    }
    let mut line = format!(
        "{to}: lost {} messages of {} events",
        consumer.lost.messages, consumer.lost.events
    );
    if is_absent {
        line += ": was never reached";
    }
    if let Some(failure) = &consumer.failure {
        line += &format!(": {failure}");
    }
    let is_output = matches!(to, Address::File(_) | Address::Stdout);
    Some((line, is_output || is_absent))
}

fn is_on_stdout(to: &Address) -> bool {
    match to {
        Address::Stdout => true,
        Address::File(path) => is_stdout(path),
        Address::Tcp(_) | Address::Udp(_) | Address::Unix(_) => false,
    }
}

impl Summary {
    fn table(&self, order: &Order) -> String {
        let mut table = self.session.table();
        if self.runs.is_some() {
            table += &order_rows(order);
        }
        for consumer in &self.consumers {
            table += &rows([
                ("to", consumer.to.clone()),
                ("  messages sent", consumer.sent.messages.to_string()),
                ("  messages lost", consumer.lost.messages.to_string()),
                ("  events sent", consumer.sent.events.to_string()),
                ("  events lost", consumer.lost.events.to_string()),
                ("  bytes sent", consumer.sent.bytes.to_string()),
                (
                    "  reached",
                    if consumer.reached { "yes" } else { "never" }.to_owned(),
                ),
                ("  reconnects", consumer.reconnects.to_string()),
                ("  queue peak, bytes", consumer.queue_peak_bytes.to_string()),
            ]);
        }
        table
    }
}
