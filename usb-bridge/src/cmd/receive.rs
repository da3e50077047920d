//! `eecvs-usb receive`: what `forward` sends, to a file.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use host_harness::cmd::output::{print, print_json, rows};
use host_harness::output::{Output, keep_or_mark};

use super::options::StreamOptions;
use crate::forward::address::Address;
use crate::forward::receive::{self, Received};
use crate::link::listen::Listening;
use crate::record::{self, Kind};
use crate::stop::Stop;

/// Receive frames or raw packets and write them to a file
#[derive(Debug, Args)]
pub struct Receive {
    /// Where to wait for a sender: tcp://ADDRESS:PORT, udp://ADDRESS:PORT, unix:PATH
    #[arg(value_name = "URL")]
    from: Address,

    /// File to write: .eecvs keeps frames as they are; a format of recordings gets their events
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Write over a file that is there
    #[arg(long)]
    overwrite: bool,

    /// End when the first sender has gone
    #[arg(long)]
    once: bool,

    #[command(flatten)]
    stream: StreamOptions,
}

impl Receive {
    /// Receives until Ctrl-C, a limit, or the end of the sender.
    ///
    /// # Errors
    /// An address that cannot be waited at, a file that cannot be written.
    pub fn run(self) -> Result<()> {
        let kind = record::kind_of(&self.output)?;
        kind.check(&self.output, self.overwrite, &[])?;
        let stop = Stop::on_signals()?;
        let mut link = Listening::open(&self.from)?;
        let limits = receive::Limits {
            once: self.once,
            limits: self.stream.limits(),
        };
        let output = Output::begin_live(&self.output, self.overwrite)?;
        let (received, outcome) = receive::receive(&mut link, output.path(), kind, limits, &stop);
        let outcome = if outcome.is_ok() && kind == Kind::Events && received.events == 0 {
            // A recording is created with its first event, whose sensor it has.
            let _ = output.leave();
            Ok(())
        } else {
            keep_or_mark(output, outcome)
        };
        if let Some(warning) = received.warning() {
            eprintln!("eecvs-usb: {}: {warning}", self.from);
        }
        if self.stream.json {
            print_json(&received)?;
        } else {
            print(&table(&received))?;
        }
        outcome
    }
}

fn table(received: &Received) -> String {
    rows([
        ("messages", received.messages.to_string()),
        ("bytes", received.bytes.to_string()),
        ("events", received.events.to_string()),
        ("messages lost", received.lost_messages.to_string()),
        ("damaged bytes", received.damaged_bytes.to_string()),
        ("late datagrams", received.late_datagrams.to_string()),
    ])
}
