//! Writes frames and packets received over a link to a file.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use eecvs::frame_file::FrameSink;
use eecvs_nostd::{Event, Order, Sensor, Sequence};
use event_files::EventWriter;
use serde::Serialize;

use super::demux::Message;
use super::packet::Packet;
use super::senders::{DATAGRAMS_BYTES, Found, Judge, Senders};
use crate::device::{self, Parse};
use crate::record::{self, FrameFile, Kind};
use crate::session;
use crate::stop::Stop;

/// Longest wait for one receive.
const WAIT: Duration = Duration::from_millis(50);
/// Encoding of frames, as packets would name it.
const FRAMES: &str = "eecvs/frames";

/// When receiving ends.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits {
    /// When the first sender of a message that the file can hold has disconnected.
    pub once: bool,
    /// After a time, or a number of events.
    pub limits: session::Limits,
}

/// Counts of what was received and lost.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Received {
    /// Frames and packets.
    pub messages: u64,
    /// Their bytes: of a frame all, of a packet its words.
    pub bytes: u64,
    /// Their events.
    pub events: u64,
    /// Messages that did not arrive, according to the sequence numbers of the others.
    pub lost_messages: u64,
    /// Duplicate messages, which were dropped.
    pub repeated_messages: u64,
    /// Messages that the file cannot hold: packets of an encoding that this version does not know, in a
    /// recording, messages of another sensor than its first; packets of raw events where the file holds frames.
    pub skipped_messages: u64,
    /// Bytes of senders that belong to no whole message.
    pub damaged_bytes: u64,
    /// Bytes of the message in transit when receiving was stopped on request.
    pub unfinished_bytes: u64,
    /// Datagrams that did not arrive, or arrived too late.
    pub lost_datagrams: u64,
    /// Datagrams dropped because they were duplicates or late.
    pub late_datagrams: u64,
    /// Datagrams that are not of the sender: of others, or not of this protocol.
    pub alien_datagrams: u64,
    /// Connections that were closed, by whatever end, without a message that the file can hold.
    pub alien_connections: u64,
    /// Connections that were closed because there was a sender.
    pub refused_connections: u64,
    /// Bytes of alien datagrams and of alien and refused connections, as far as they were read.
    pub alien_bytes: u64,
    /// Datagrams for which the system had no room, if the system reports it.
    pub overflown_datagrams: Option<u64>,
    /// Size of the system's receive buffer for datagrams, in bytes.
    pub receive_buffer_bytes: Option<usize>,
    /// Number of senders, one after the other.
    pub senders: u64,
    /// What the recording lacks although its messages arrived, by cause: reported by the frames themselves, or
    /// words that could not be used.
    pub left_out: BTreeMap<&'static str, u64>,
}

impl Received {
    /// Returns whether anything that was sent is missing.
    #[must_use]
    pub const fn has_losses(&self) -> bool {
        self.lost_messages > 0
            || self.lost_datagrams > 0
            || self.damaged_bytes > 0
            || self.skipped_messages > 0
            || self.has_nothing_of_use()
    }

    /// Returns whether something came, and nothing of it could be used: it may have been meant for this file.
    const fn has_nothing_of_use(&self) -> bool {
        self.senders == 0 && self.alien_bytes > 0
    }

    /// Returns one line about what was lost or left out; `None` if nothing was.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let met: Vec<String> = [
            (self.lost_messages, "messages lost"),
            (self.lost_datagrams, "datagrams lost"),
            (self.repeated_messages, "messages that arrived twice"),
            (self.skipped_messages, "messages that the file cannot hold"),
            (self.damaged_bytes, "bytes that belong to no message"),
            (self.late_datagrams, "datagrams that arrived late"),
            (self.alien_datagrams, "datagrams of others"),
            (
                self.alien_connections,
                "connections without a message that the file can hold",
            ),
            (
                self.refused_connections,
                "connections refused while there was a sender",
            ),
        ]
        .into_iter()
        .filter(|(n, _)| *n > 0)
        .chain(self.left_out.iter().map(|(what, n)| (*n, *what)))
        .map(|(n, what)| format!("{what}: {n}"))
        .collect();
        if met.is_empty() {
            return None;
        }
        let mut warning = met.join("; ");
        if self.has_nothing_of_use() {
            warning = format!("nothing that the file can hold arrived; {warning}");
        }
        match self.overflown_datagrams {
            Some(n) if n > 0 => warning += &format!("; the system had no room for {n} datagrams"),
            _ => {}
        }
        match self.receive_buffer_bytes {
            Some(bytes) if self.lost_datagrams > 0 && bytes < DATAGRAMS_BYTES => {
                warning += &format!(
                    "; the receive buffer has {bytes} bytes instead of the {DATAGRAMS_BYTES} \
                     requested: raise net.core.rmem_max"
                );
            }
            _ => {}
        }
        Some(warning)
    }
}

/// Follows the sequence numbers of messages.
#[derive(Default)]
struct Numbers {
    sequence: Sequence,
    lost: u64,
    repeated: u64,
}

impl Numbers {
    /// Takes a sequence number. Returns whether the message does not directly follow the previous one; `None` for a
    /// duplicate.
    fn follow(&mut self, number: u32) -> Option<bool> {
        match self.sequence.follow(number) {
            Order::InOrder => Some(false),
            Order::Lost(frames) => {
                self.lost += u64::from(frames);
                Some(true)
            }
            Order::Reordered => {
                self.lost = self.lost.saturating_sub(1);
                Some(true)
            }
            Order::Repeated => {
                self.repeated += 1;
                None
            }
        }
    }
}

/// Output for the messages.
enum Output {
    /// A file of frames, written unchanged.
    Frames(Box<FrameFile>),
    /// A recording of one sensor; its writer is created with the first message.
    Events(Option<(Sensor, Box<dyn EventWriter>)>),
}

struct Receiver<'p> {
    path: &'p Path,
    /// Takes a line about the first message of a sender that the file cannot hold.
    notice: &'p mut dyn FnMut(&str),
    /// Whether that was said of the current sender.
    is_said: bool,
    output: Output,
    numbers: Numbers,
    /// The parser of the current stream, with the encoding and the sensor it was made for.
    parser: Option<(String, Sensor, Box<dyn Parse>)>,
    events: Vec<Event>,
    received: Received,
}

/// Receives messages into a file until a stop request, a limit or the end. Returns the counts with the outcome:
/// what was received before an error is in the file. Messages that the file cannot hold are counted and skipped;
/// `notice` takes a line about the first of each sender.
pub fn receive(
    senders: &mut Senders,
    path: &Path,
    kind: Kind,
    limits: Limits,
    stop: &Stop,
    notice: &mut dyn FnMut(&str),
) -> (Received, Result<()>) {
    let output = match kind {
        Kind::Events => Output::Events(None),
        Kind::Frames => match record::create_frames(path) {
            Ok(file) => Output::Frames(Box::new(file)),
            Err(error) => return (Received::default(), Err(error)),
        },
        Kind::Stream => {
            let error = anyhow::anyhow!(
                "{}: receive cannot write .stream files: give the extension .eecvs or that of a \
                 recording format",
                path.display()
            );
            return (Received::default(), Err(error));
        }
    };
    let mut receiver = Receiver {
        path,
        notice,
        is_said: false,
        output,
        numbers: Numbers::default(),
        parser: None,
        events: Vec::new(),
        received: Received::default(),
    };
    let outcome = receiver.run(senders, limits, stop);
    let finished = receiver.finish();
    let mut received = receiver.received;
    let tally = senders.tally();
    received.senders = tally.senders;
    received.damaged_bytes = tally.damaged_bytes;
    received.alien_datagrams = tally.alien_datagrams;
    received.alien_connections = tally.alien_connections;
    received.refused_connections = tally.refused_connections;
    received.alien_bytes = tally.alien_bytes;
    received.lost_messages = receiver.numbers.lost;
    received.repeated_messages = receiver.numbers.repeated;
    if let Some(datagrams) = senders.datagrams() {
        received.lost_messages += datagrams.lost_messages;
        received.damaged_bytes += datagrams.cut_bytes;
        received.lost_datagrams = datagrams.lost;
        received.late_datagrams = datagrams.late;
        received.overflown_datagrams = datagrams.overflown;
        received.receive_buffer_bytes = Some(datagrams.granted_bytes);
    }
    (received, outcome.and(finished))
}

impl Receiver<'_> {
    fn run(&mut self, senders: &mut Senders, limits: Limits, stop: &Stop) -> Result<()> {
        let started = Instant::now();
        let mut sender = 0;
        loop {
            let session::Limits { duration, events } = limits.limits;
            let is_over = stop.is_asked()
                || duration.is_some_and(|duration| started.elapsed() >= duration)
                || events.is_some_and(|events| self.received.events >= events);
            if is_over {
                // The rest of the message would have arrived.
                self.received.unfinished_bytes = senders.forgive();
                return Ok(());
            }
            let Some(found) = senders.next(WAIT, self)? else {
                if limits.once && sender > 0 && !senders.has_sender() {
                    return Ok(());
                }
                continue;
            };
            if found.sender != sender {
                sender = found.sender;
                // A new sender counts from 0.
                self.numbers.sequence = Sequence::new();
                self.is_said = false;
                self.let_go();
            }
            self.take(&found)?;
        }
    }

    fn take(&mut self, found: &Found<'_>) -> Result<()> {
        let frame = match found.message {
            Message::Packet(packet) => return self.packet(&packet),
            Message::Frame(frame) => frame,
        };
        let header = frame.header;
        if self.numbers.follow(header.sequence).is_none() {
            return Ok(());
        }
        match &mut self.output {
            Output::Frames(file) => {
                file.frame(&header, found.bytes)
                    .with_context(|| format!("{}: cannot be written", self.path.display()))?;
                self.count(found.bytes.len(), header.events);
            }
            Output::Events(_) => {
                if self.follow(FRAMES, header.sensor).is_some() {
                    self.count(found.bytes.len(), header.events);
                    self.parse(found.bytes)?;
                }
            }
        }
        Ok(())
    }

    const fn count(&mut self, bytes: usize, events: u32) {
        self.received.messages += 1;
        self.received.bytes += bytes as u64;
        self.received.events += events as u64;
    }

    fn packet(&mut self, packet: &Packet<'_>) -> Result<()> {
        let Some(after_gap) = self.numbers.follow(packet.sequence) else {
            return Ok(());
        };
        let Some(is_new) = self.follow(packet.encoding, packet.sensor) else {
            return Ok(());
        };
        self.count(packet.words.len(), packet.events);
        if (after_gap || is_new || packet.after_loss)
            && let Some((_, _, parser)) = &mut self.parser
        {
            // A packet without a time base is at the beginning of its stream, whose words start with a time.
            if packet.time_base_us.is_some() {
                parser.resume(packet.time_base_us);
            }
        }
        self.parse(packet.words)
    }

    /// Counts a message that the file cannot hold, and says so of the first.
    fn skip(&mut self, why: &str) {
        self.received.skipped_messages += 1;
        if !std::mem::replace(&mut self.is_said, true) {
            (self.notice)(why);
        }
    }

    /// Returns why the file cannot hold messages of this encoding and sensor, if it cannot.
    fn obstacle(&self, encoding: &str, sensor: Sensor) -> Option<String> {
        let path = self.path.display();
        match &self.output {
            Output::Frames(_) if encoding == FRAMES => return None,
            Output::Frames(_) => {
                return Some(format!(
                    "{path}: the sender sends raw packets, not frames: give the file the extension of a recording \
                     format"
                ));
            }
            Output::Events(Some((of_file, _))) if *of_file != sensor => {
                return Some(format!(
                    "{path}: holds events of {} x {} pixels: messages of a sensor of {} x {} are skipped",
                    of_file.width, of_file.height, sensor.width, sensor.height
                ));
            }
            Output::Events(_) => {}
        }
        // A name from elsewhere may hold any characters.
        parser(encoding, sensor).is_none().then(|| {
            format!(
                "this version does not know packets of {encoding:?}, which are skipped: use a newer version"
            )
        })
    }

    /// Ensures that there is a parser for this encoding and sensor. Returns whether it is a new one; `None` for a
    /// message that is skipped.
    fn follow(&mut self, encoding: &str, sensor: Sensor) -> Option<bool> {
        if let Some((of, size, _)) = &self.parser
            && (of.as_str(), *size) == (encoding, sensor)
        {
            return Some(false);
        }
        if let Some(obstacle) = self.obstacle(encoding, sensor) {
            self.skip(&obstacle);
            return None;
        }
        self.let_go();
        self.parser = Some((encoding.to_owned(), sensor, parser(encoding, sensor)?));
        Some(true)
    }

    fn parse(&mut self, bytes: &[u8]) -> Result<()> {
        let (Some((_, sensor, parser)), Output::Events(writer)) =
            (&mut self.parser, &mut self.output)
        else {
            return Ok(());
        };
        self.events.clear();
        parser.parse(bytes, &mut self.events);
        let (_, writer) = match writer {
            Some(writer) => writer,
            None => writer.insert((*sensor, event_files::create_in_place(self.path, *sensor)?)),
        };
        Ok(writer.write(&self.events)?)
    }

    /// Drops the parser and keeps its loss counts.
    fn let_go(&mut self) {
        if let Some((_, _, parser)) = self.parser.take() {
            for (cause, n) in parser.losses().iter() {
                *self.received.left_out.entry(cause).or_default() += n;
            }
        }
    }

    fn finish(&mut self) -> Result<()> {
        self.let_go();
        match std::mem::replace(&mut self.output, Output::Events(None)) {
            Output::Frames(file) => record::finish(*file, self.path),
            Output::Events(Some((_, writer))) => Ok(writer.finish()?),
            Output::Events(None) => Ok(()),
        }
    }
}

impl Judge for Receiver<'_> {
    fn is_of_use(&mut self, message: &Message<'_>) -> bool {
        let obstacle = match message {
            Message::Packet(packet) => self.obstacle(packet.encoding, packet.sensor),
            Message::Frame(frame) => self.obstacle(FRAMES, frame.header.sensor),
        };
        let Some(obstacle) = obstacle else {
            return true;
        };
        self.skip(&obstacle);
        false
    }

    fn tell(&mut self, line: &str) {
        (self.notice)(line);
    }
}

/// Returns a parser of an encoding, if this version knows it.
fn parser(encoding: &str, sensor: Sensor) -> Option<Box<dyn Parse>> {
    let (model, stream) = encoding.split_once('/').unwrap_or((encoding, ""));
    let model = device::find(model)?;
    let info = model.describe(sensor, stream)?;
    Some(model.parser(&info))
}
