//! `eecvs-usb receive`: writes what `forward` sends to a file.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail};
use clap::Args;
use eecvs_cli::output::{Place, keep_or_mark, rows};
use event_files::output::Output;

use super::options::{StreamOptions, seconds};
use super::warn;
use crate::forward::address::Address;
use crate::forward::receive::{self, Received};
use crate::forward::senders::{Deadlines, Senders};
use crate::record;
use crate::stop::Stop;

/// Receive frames or raw packets and write them to a file
#[derive(Debug, Args)]
pub struct Receive {
    /// Where to wait for a sender: tcp://ADDRESS:PORT, udp://ADDRESS:PORT, unix:PATH
    #[arg(value_name = "URL")]
    from: Address,

    /// File to write: .eecvs keeps frames unchanged; a recording format gets their events; - is standard output,
    /// which gets frames
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Overwrite an existing file
    #[arg(long)]
    overwrite: bool,

    /// End when the first sender has disconnected; a sender of no message that the file can hold does not count
    #[arg(long)]
    once: bool,

    /// Close a connection that has sent nothing for this many seconds
    #[arg(long, value_name = "S", default_value = "60", value_parser = seconds)]
    first_byte_s: Duration,

    /// Close a connection, or forget a sender of datagrams, whose first message that the file can hold is not whole this
    /// many seconds after its first byte
    #[arg(long, value_name = "S", default_value = "10", value_parser = seconds)]
    first_message_s: Duration,

    /// Let another sender take the place of one from which no whole message has come for this many seconds [default:
    /// 10; over UDP 1]
    #[arg(long, value_name = "S", value_parser = seconds)]
    idle_s: Option<Duration>,

    #[command(flatten)]
    stream: StreamOptions,
}

impl Receive {
    /// Receives until Ctrl-C, a limit, or the end of the sender.
    ///
    /// # Errors
    /// The address cannot be listened at, the file cannot be written, or something that was sent did not arrive. In the
    /// last case the file is still complete as received.
    pub fn run(self) -> Result<()> {
        let kind = record::kind_of(&self.output)?;
        kind.check(&self.output, self.overwrite, &[])?;
        let stop = Stop::on_signals()?;
        let mut senders = Senders::open(&self.from, self.deadlines(), &stop)?;
        let limits = receive::Limits {
            once: self.once,
            limits: self.stream.limits(),
        };
        let output = Output::begin_live(&self.output, self.overwrite)?;
        let (received, outcome) =
            receive::receive(&mut senders, output.path(), kind, limits, &stop, &mut warn);
        let outcome = keep_or_mark(output, outcome);
        let place = Place::beside([self.output.as_path()]);
        place.tell(self.stream.json, &received, || table(&received))?;
        let Some(warning) = received.warning() else {
            return outcome;
        };
        if outcome.is_ok() && received.has_losses() {
            bail!("{}: {warning}", self.from);
        }
        warn(&format!("{}: {warning}", self.from));
        outcome
    }
}

impl Receive {
    const fn deadlines(&self) -> Deadlines {
        Deadlines {
            first_byte: self.first_byte_s,
            first_message: self.first_message_s,
            idle: self.idle_s,
        }
    }
}

fn table(received: &Received) -> String {
    let mut lines = vec![
        ("messages", received.messages.to_string()),
        ("bytes", received.bytes.to_string()),
        ("events", received.events.to_string()),
        ("messages lost", received.lost_messages.to_string()),
        ("messages repeated", received.repeated_messages.to_string()),
        ("messages skipped", received.skipped_messages.to_string()),
        ("damaged bytes", received.damaged_bytes.to_string()),
        ("unfinished bytes", received.unfinished_bytes.to_string()),
        ("senders", received.senders.to_string()),
        ("bytes of others", received.alien_bytes.to_string()),
    ];
    if let Some(bytes) = received.receive_buffer_bytes {
        let overflown = received.overflown_datagrams;
        let overflown = overflown.map_or("unknown".to_owned(), |n| n.to_string());
        lines.extend([
            ("datagrams lost", received.lost_datagrams.to_string()),
            ("  for lack of room", overflown),
            ("datagrams late", received.late_datagrams.to_string()),
            ("datagrams of others", received.alien_datagrams.to_string()),
            ("receive buffer, bytes", bytes.to_string()),
        ]);
    } else {
        lines.extend([
            (
                "connections without a message",
                received.alien_connections.to_string(),
            ),
            (
                "connections refused",
                received.refused_connections.to_string(),
            ),
        ]);
    }
    let mut table = rows(lines);
    if !received.left_out.is_empty() {
        let counts = received.left_out.iter();
        let counts = counts.map(|(cause, n)| (*cause, n.to_string()));
        table += "left out\n";
        for line in rows(counts).lines() {
            table += &format!("  {line}\n");
        }
    }
    table
}
