//! `log`: writes the contents of frames as tables, one of windows and one of coefficients.

mod csv;
mod file;
mod mcap;
mod parquet;
mod table;
mod window;

use anyhow::{Result, ensure};
use clap::Args;
use eecvs::decode::FrameCounts;
use eecvs_cli::options::WindowLimitOptions;

use super::frame_reader::{Account, FrameReader};
use super::{Context, LossOptions, QosOptions, refuse_losses};
use crate::message::{Frame, Time};
use crate::operator::{Decoded, Operators};
use file::{Files, LogFile};
use table::{COEFFICIENTS, FEATURES, Rows};
use window::{Told, Window};

/// Write the contents of frames as tables: a row per window, and a row per coefficient
///
/// A window sent as events (mode hybrid) has no coefficients, and no rows in their table. File names end in .csv,
/// .parquet or .mcap (JSON with a schema); unknown values are empty. Existing files are never overwritten.
#[derive(Debug, Clone, Args)]
pub struct Log {
    /// A row for each window: its time, density, regime, transform, coder, frames, bytes, losses. window_events
    /// counts the events in the encoder's window, events those in the frames received
    #[arg(long, value_name = "FILE", value_parser = LogFile::parse)]
    features: Option<LogFile>,

    /// A row for each coefficient: its window, pixel, transform, k and value: re, and for the DTFT also im. Both
    /// tables may share one .mcap
    #[arg(long, value_name = "FILE", value_parser = LogFile::parse)]
    coefficients: Option<LogFile>,

    /// End after this many seconds without frames, once one has arrived
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    window_limit: WindowLimitOptions,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Indices of the tables in [`Files`].
const FEATURES_TABLE: usize = 0;
const COEFFICIENTS_TABLE: usize = 1;

impl Log {
    /// Writes the tables until a stop is requested, or until no frames arrive for the idle time.
    ///
    /// # Errors
    /// No file is requested, a file exists or cannot be written, the transport fails, or something was lost and the
    /// options do not allow it.
    pub fn run(self, mut context: Context, operators: &Operators) -> Result<()> {
        ensure!(
            self.features.is_some() || self.coefficients.is_some(),
            "nothing to write: give --features FILE, --coefficients FILE, or both"
        );
        let (qos, limit) = (self.qos.qos(), self.window_limit.limit());
        let mut frames = FrameReader::new(&mut context, operators, qos, limit, self.idle_s)?;
        let topic = |name: &str| context.topic(name);
        let files = Files::create(&[
            (self.features.as_ref(), FEATURES, topic(FEATURES.name)?),
            (
                self.coefficients.as_ref(),
                COEFFICIENTS,
                topic(COEFFICIENTS.name)?,
            ),
        ])?;
        let mut writing = Writing {
            files,
            open: None,
            totals: Totals::default(),
        };
        let written = writing.all(&context, &mut frames, operators);
        let Writing { files, totals, .. } = writing;
        // Complete the files even after an error, so that what was written before it can be read.
        let finished = files.finish();
        written.and(finished)?;
        context.say(&totals.line(frames.account(), &frames.counts()));
        let coefficients = self
            .coefficients
            .filter(|file| self.features.as_ref() != Some(file));
        for file in self.features.iter().chain(&coefficients) {
            context.say(&format!("{}: written", file.name()));
        }
        refuse_losses(self.losses.allow_loss, &frames.account().losses())
    }
}

/// Counts of what was written.
#[derive(Debug, Default)]
struct Totals {
    windows: u64,
    events: u64,
    coefficients: u64,
    bytes: u64,
}

impl Totals {
    fn line(&self, account: &Account, counts: &FrameCounts) -> String {
        format!(
            "{} windows of {} events and {} coefficients in {} frames ({} lost, {} left out, {} of another publisher) of \
             {} bytes; at the encoder {} late, {} filtered, {} dropped, {} thinned",
            self.windows,
            self.events,
            self.coefficients,
            account.frames,
            account.sequence.lost,
            account.refused,
            account.others,
            self.bytes,
            counts.events_late,
            counts.events_filtered,
            counts.events_dropped,
            counts.events_thinned
        )
    }
}

/// Assembles rows as frames arrive.
struct Writing {
    files: Files,
    /// The window whose last frame has not arrived.
    open: Option<Window>,
    totals: Totals,
}

impl Writing {
    fn all(
        &mut self,
        context: &Context,
        frames: &mut FrameReader<'_>,
        operators: &Operators,
    ) -> Result<()> {
        let mut ready: Vec<Decoded> = Vec::new();
        while let Some(frame) = frames.next_frame(context, &mut ready)? {
            let operator = operators.find(&frame.operator_name);
            let told = Told::new(&frame, operator.map_or("", |operator| operator.name()));
            let lost = frames.account().sequence.lost;
            self.frame(&frame, &told, lost, ready.drain(..))?;
        }
        frames.end(&mut ready);
        self.close(frames.account().sequence.lost, &mut ready.into_iter())
    }

    /// Takes a frame, and the windows that end before or with it.
    fn frame(
        &mut self,
        frame: &Frame,
        told: &Told<'_>,
        lost: u64,
        mut ready: impl Iterator<Item = Decoded>,
    ) -> Result<()> {
        if self.open.as_ref().is_some_and(|open| !open.has_part(told)) {
            self.close(lost, &mut ready)?;
        }
        self.open.get_or_insert_with(|| Window::new(told)).add(told);
        if told.is_last() {
            self.close(lost, &mut ready)?;
        }
        // Windows of other operators may become ready with any frame.
        for decoded in ready {
            self.coefficients(&decoded, frame.seq, frame.header.stamp)?;
        }
        Ok(())
    }

    /// Ends the open window, whose contents are the next that are ready.
    fn close(&mut self, lost: u64, ready: &mut dyn Iterator<Item = Decoded>) -> Result<()> {
        let Some(open) = &self.open else {
            return Ok(());
        };
        let (seq, stamp) = (open.seq, open.stamp);
        if open.header.is_some()
            && open.events > 0
            && let Some(decoded) = ready.next()
        {
            self.coefficients(&decoded, seq, stamp)?;
        }
        if let Some(window) = self.open.take() {
            self.totals.windows += 1;
            self.totals.events += window.events;
            self.totals.bytes += window.bytes;
            let row = Rows::features(&window, lost);
            self.files.put(FEATURES_TABLE, &row)?;
        }
        Ok(())
    }

    /// Writes the coefficients of the open window, if its decoded contents have any.
    fn coefficients(&mut self, decoded: &Decoded, seq: u64, stamp: Time) -> Result<()> {
        let (Decoded::Window(decoded), Some(open)) = (decoded, &mut self.open) else {
            return Ok(());
        };
        let coefficients = open.add_decoded(decoded);
        if coefficients > 0 {
            self.totals.coefficients += coefficients;
            let rows = Rows::coefficients(seq, stamp, decoded);
            self.files.put(COEFFICIENTS_TABLE, &rows)?;
        }
        Ok(())
    }
}
