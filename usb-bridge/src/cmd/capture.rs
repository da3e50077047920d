//! `eecvs-usb capture`: records a device's stream to a file.

use std::path::{Path, PathBuf};
use std::sync::PoisonError;
use std::thread;
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use eecvs::encode::{Codec, EncodeSummary, REORDER_LIVE_US};
use eecvs_cli::codec::{CodecOptions, LimitOptions};
use eecvs_cli::output::{Place, is_closed_pipe, keep_or_mark};
use event_files::EventReader;
use event_files::output::{Output, is_stdout};
use indicatif::{ProgressBar, ProgressDrawTarget};
use serde::Serialize;

use super::options::{
    DeviceOptions, StreamOptions, order_rows, refuse_late, warn_of_losses, warn_of_runs,
};
use crate::record::{self, Kept, Kind, Order};
use crate::session::{Report, Session};
use crate::stop::Stop;

/// Record a device's stream
#[derive(Debug, Args)]
pub struct Capture {
    /// File to write. The extension sets its content: .stream (the device's own bytes, with arrival times), .eecvs
    /// (frames), or events in a recording format: .raw, .aedat4, .csv, ...; - is standard output, which gets frames
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Encode into frames while capturing; .eecvs implies it
    #[arg(long, conflicts_with = "set_up")]
    encode: bool,

    /// Overwrite an existing file
    #[arg(long)]
    overwrite: bool,

    #[command(flatten)]
    device: DeviceOptions,

    #[command(flatten)]
    stream: StreamOptions,

    #[command(flatten)]
    codec: CodecOptions,

    #[command(flatten)]
    limits: LimitOptions,
}

/// Summary of a capture.
#[derive(Debug, Serialize)]
struct Summary {
    file: PathBuf,
    #[serde(flatten)]
    session: Report,
    /// Runs of the clock in the file; `None` for a .stream.
    #[serde(skip_serializing_if = "Option::is_none")]
    runs: Option<u64>,
    /// Events that came too late and are in no frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    events_late: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoding: Option<EncodeSummary>,
}

impl Capture {
    /// Captures until Ctrl-C, a limit, or the end of the device's stream.
    ///
    /// # Errors
    /// The device cannot be used, the link fails, or the file cannot be written. What arrived before is in
    /// `incomplete-FILE` beside the file.
    pub fn run(self) -> Result<()> {
        let kind = record::kind_of(&self.output)?;
        ensure!(
            kind == Kind::Frames || !self.encode,
            "{}: --encode writes frames: give the file the extension .eecvs",
            self.output.display()
        );
        kind.check(&self.output, self.overwrite, &self.inputs())?;
        let files: Vec<&Path> = self.codec.files().collect();
        let place = self.device.place();
        place.check_trace(self.overwrite, &[&self.output], &files)?;
        let stop = Stop::on_signals()?;
        let source = self.device.open(&self.codec, &stop)?;
        let session = Session::start(
            source,
            self.stream.queue_bytes(),
            &stop,
            self.stream.limits(),
        )?;
        let over = Stop::default();
        let mut kept = Kept::default();
        let outcome = thread::scope(|scope| {
            scope.spawn(|| show(&session, &over));
            let outcome = self.keep(kind, &session, &mut kept);
            over.ask();
            outcome
        });
        let Kept { order, encoding } = kept;
        let (report, unstopped) = session.finish();
        warn_of_losses(&report);
        warn_of_runs(&report.device, &order);
        let place =
            Place::unless_taken(is_stdout(&self.output) || self.device.place().is_on_stdout());
        let has_order = kind != Kind::Stream && (outcome.is_ok() || order.runs > 0);
        let summary = Summary {
            file: self.output,
            session: report,
            runs: has_order.then_some(order.runs),
            events_late: has_order.then_some(order.events_late),
            encoding,
        };
        place.tell(self.stream.json, &summary, || summary.table(&order))?;
        match outcome {
            Err(error) if place == Place::Stderr && is_closed_pipe(&error) => {}
            outcome => outcome?,
        }
        refuse_late(&summary.session.device, &order, self.limits.order)?;
        unstopped.map_or(Ok(()), Err)
    }

    /// Returns the files that the command reads.
    fn inputs(&self) -> Vec<&Path> {
        self.codec
            .files()
            .chain(self.device.place().files())
            .collect()
    }

    /// Records into a temporary file, which gets its own name if the stream ended as it should.
    fn keep(&self, kind: Kind, session: &Session, kept: &mut Kept) -> Result<()> {
        let output = Output::begin_live(&self.output, self.overwrite)?;
        let outcome = self.record(kind, session, output.path(), kept);
        keep_or_mark(output, outcome)
    }

    fn record(&self, kind: Kind, session: &Session, path: &Path, kept: &mut Kept) -> Result<()> {
        match kind {
            Kind::Stream => record::stream(session, path),
            Kind::Events => {
                let mut reader = session.reader_of_sensor()?;
                let reorder_us = self.limits.limits().reorder_us.unwrap_or(REORDER_LIVE_US);
                record::events(&mut reader, path, reorder_us, &mut kept.order)
            }
            Kind::Frames if self.device.sets_up() => {
                let mut out = record::create_frames(path)?;
                let written = record::encoders_frames(session, &mut out, &mut kept.order);
                written.and(record::finish(out, path))
            }
            Kind::Frames => {
                let reader: Box<dyn EventReader> = Box::new(session.reader_of_sensor()?);
                let config = self.codec.config_of_file(reader.sensor())?;
                let (reader, config) = self.codec.look(reader, config);
                let hot = self.codec.hot_pixels(reader.sensor())?;
                let codec = Codec {
                    hot: &hot,
                    max_nmse: self.codec.max_nmse(),
                    ..Codec::from(config)
                };
                let limits = self.limits.limits();
                record::frames(reader, codec, limits, path, kept)
            }
        }
    }
}

impl Summary {
    fn table(&self, order: &Order) -> String {
        let mut table = self.session.table();
        if self.runs.is_some() {
            table += &order_rows(order);
        }
        table
    }
}

/// Shows the progress of the capture on a terminal.
fn show(session: &Session, over: &Stop) {
    let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
    let progress = session.progress();
    let (mut before, tick) = (0, Duration::from_millis(250));
    let mut rate = 0.0;
    while !over.is_asked() {
        let (events, parsed_losses) = {
            let progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
            (
                progress.events,
                progress.losses.iter().map(|(_, n)| n).sum::<u64>(),
            )
        };
        let losses: u64 = session.pumped.account.losses().map(|(_, n)| n).sum();
        let now = (events - before) as f64 / tick.as_secs_f64();
        rate = if rate == 0.0 {
            now
        } else {
            0.7 * rate + 0.3 * now
        };
        before = events;
        bar.set_message(format!(
            "{events} events, {:.2} million/s, {} losses",
            rate / 1e6,
            losses + parsed_losses
        ));
        bar.tick();
        thread::sleep(tick);
    }
    bar.finish_and_clear();
}
