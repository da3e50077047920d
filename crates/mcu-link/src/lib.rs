//! Sends a recording through an encoder on a microcontroller and compares the result with the host's own encoder.
//!
//! | file | contents |
//! |---|---|
//! | `connection.rs` | a byte stream used in both directions at once, such as a socket or a serial port |
//! | `link.rs` | the packets and frames on that stream |
//! | `setting_up.rs` | sends the setup and the hot pixels until the encoder answers |
//! | `account.rs` | checks the received frames one by one |
//! | `qemu.rs` | the emulated machine at the other end |
//! | `image.rs` | the firmware image: its build and its sizes |
//! | `debugger.rs` | that machine's debugger |
//! | `sensor/` | the image with a simulated sensor: its recording, and what came of it |
//! | `log.rs` | the log of the image |
//!
//! [`run`] needs only a [`Connection`], whatever encoder it leads to.

mod account;
pub mod connection;
pub mod debugger;
pub mod image;
pub mod link;
pub mod log;
pub mod qemu;
pub mod sensor;
mod setting_up;

use std::time::Duration;

use eecvs::encode::{Codec, Limits, all_cores, encode};
use eecvs_nostd::event_link::{Kind, Setup, Status};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::{Config, Scan, scan};
use event_files::EventReader;
use event_types::stream::{Context, Result};
use event_types::{bail, ensure};

use account::Account;
pub use account::restart;
use connection::Sender;
pub use connection::{Connection, Link};
use link::{EventPackets, Message};
pub use setting_up::{keep_out, set_up};

/// Time without any bytes moving after which an encoder is considered dead.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// Number of events put into packets at a time.
const CHUNK_EVENTS: usize = 1 << 10;
/// Period in us of the time in EVT 2.0 words.
const WORDS_PERIOD_US: u64 = 1 << 34;

/// A recording and how an encoder is to encode it.
pub struct Job<'j> {
    /// Opens the recording at its first event; called more than once.
    pub open: &'j (dyn Fn() -> Result<Box<dyn EventReader>> + Sync),
    /// Configuration of the encoder.
    pub config: Config,
    /// Hot pixels (column, row), whose events are never encoded; each once, in raster order.
    pub hot: &'j [(u16, u16)],
    /// Whether the encoder drops events while it has no room, instead of blocking the link.
    pub drop_when_full: bool,
}

/// Result of sending a recording through an encoder.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Number of events sent.
    pub events: u64,
    /// Number of windows with events received.
    pub windows: u64,
    /// Number of frames received.
    pub frames: u64,
    /// Whether the frames were compared with the host's.
    pub compared: bool,
    /// Number of frames identical to the host's, byte for byte.
    pub frames_identical: u64,
    /// Number of frames that differ from the host's, are missing, or are surplus.
    pub frames_different: u64,
    /// Number of events encoded in frames.
    pub events_encoded: u64,
    /// Number of events that frames report as late.
    pub events_late: u64,
    /// Number of events that frames report as removed by a filter.
    pub events_filtered: u64,
    /// Number of events that frames report as removed by the rate control.
    pub events_thinned: u64,
    /// Number of events that frames report as lost.
    pub events_lost: u64,
    /// The encoder's own counts since its setup.
    pub status: Status,
    /// The received frames, concatenated.
    pub bytes: Vec<u8>,
    /// Problems found, one line each; empty for a good run.
    pub problems: Vec<String>,
}

impl Outcome {
    /// Returns the encoder's time per event in ns for receiving, encoding and sending; 0 without events.
    #[must_use]
    pub fn ns_per_event(&self) -> [f64; 3] {
        let Status {
            receive_ns,
            encode_ns,
            send_ns,
            ..
        } = self.status;
        let events = self.status.events;
        [receive_ns, encode_ns, send_ns].map(|ns| match events {
            0 => 0.0,
            _ => ns as f64 / f64::from(events),
        })
    }

    /// Checks that the run had no problems.
    ///
    /// # Errors
    /// All [`Outcome::problems`], joined into one line.
    pub fn verdict(&self) -> Result<()> {
        ensure!(
            self.problems.is_empty(),
            Other,
            "{}",
            self.problems.join("; ")
        );
        Ok(())
    }
}

/// Sends a recording to an encoder and compares the received frames with the host's; calls `progress` with the number
/// of events sent so far.
///
/// With [`Job::drop_when_full`] the host's frames cannot serve as a reference. Every frame is then unpacked instead,
/// and every event accounted for.
///
/// # Errors
/// A recording that cannot be read or sent, an encoder that refuses it, or a link that fails or stalls. Frames that
/// differ and events that are lost are not errors: they are listed in [`Outcome::problems`].
pub fn run(
    connection: &mut Connection,
    job: &Job<'_>,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Outcome> {
    let plan = Plan::new(job)?;
    let mut setup = Setup::new(&job.config, plan.time_base_us);
    if job.drop_when_full {
        setup.when_full = Setup::DROP;
    }
    let status = set_up(connection, &setup)?;
    let told = keep_out(connection, job.config.window.sensor, job.hot)?;
    let status = told.unwrap_or(status);
    let expected = if job.drop_when_full {
        None
    } else {
        Some(host_frames(job, limits(&status))?)
    };
    let damaged_before = connection.incoming().damaged_bytes();
    let mut account = Account::new(status, damaged_before, expected);
    connection.exchange(
        |sender| send_events(sender, job, plan.time_base_us, progress),
        |message, incoming| account.take(message, incoming),
    )?;
    let damaged_bytes = connection.incoming().damaged_bytes();
    Ok(account.finish(plan.events, damaged_bytes))
}

/// Returns what bounds an image's frames.
const fn limits(status: &Status) -> Limits {
    Limits {
        window_events: status.window_events as usize,
        frame_bytes: status.frame_bytes as usize,
        // As the image does, which has no memory to hold events for reordering.
        reorder_us: Some(0),
        dense_words: status.dense_words as usize,
    }
}

/// Results of a first pass over the recording.
struct Plan {
    events: u64,
    time_base_us: u64,
}

impl Plan {
    /// Reads the whole recording once, so that nothing is sent if a part of it cannot be sent.
    fn new(job: &Job<'_>) -> Result<Self> {
        let mut reader = (job.open)()?;
        let mut events = Vec::new();
        let mut encoder = None;
        let mut plan = Self {
            events: 0,
            time_base_us: 0,
        };
        let mut refused: Option<(u64, u64)> = None;
        let mut refusals = 0_u64;
        while reader.read(&mut events)? > 0 {
            for event in events.drain(..) {
                let encoder = encoder.get_or_insert_with(|| {
                    // With a whole number of periods, the words are those of a camera with this clock.
                    plan.time_base_us = event.t_us - event.t_us % WORDS_PERIOD_US;
                    Evt2Encoder::new(plan.time_base_us)
                });
                if encoder.encode(event).is_none() {
                    refused.get_or_insert((plan.events, event.t_us));
                    refusals += 1;
                }
                plan.events += 1;
            }
        }
        if let Some((index, t_us)) = refused {
            bail!(
                CannotHold,
                "event {index}: its time {t_us} us lies before {} us or after a gap that EVT 2.0 \
                 words cannot encode (4.7 hours), as do the times of {} further events: cut the \
                 recording there",
                plan.time_base_us,
                refusals - 1
            );
        }
        Ok(plan)
    }
}

/// Returns the status that a message carries, `None` if it is another kind of message.
fn status_of(message: &Message) -> Result<Option<Status>> {
    match message {
        Message::Packet(Kind::Status, body) => Status::parse(body).map(Some).context(
            "the encoder's status has another layout: build its image from the same sources",
        ),
        _ => Ok(None),
    }
}

/// Sends the whole recording and the packet that ends it.
fn send_events(
    sender: &mut Sender<'_>,
    job: &Job<'_>,
    time_base_us: u64,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<()> {
    let mut reader = (job.open)()?;
    let mut packets = EventPackets::new(time_base_us);
    let (mut events, mut bytes) = (Vec::new(), Vec::new());
    let mut sent = 0;
    while reader.read(&mut events)? > 0 {
        for chunk in events.chunks(CHUNK_EVENTS) {
            for event in chunk {
                packets.push(*event, &mut bytes)?;
            }
            sender.send(&bytes)?;
            bytes.clear();
            sent += chunk.len() as u64;
            progress(sent);
        }
        events.clear();
    }
    packets.finish(&mut bytes)?;
    sender.send(&bytes)
}

/// Returns the frames that the host's own encoder produces.
fn host_frames(job: &Job<'_>, limits: Limits) -> Result<Vec<Vec<u8>>> {
    let mut bytes = Vec::new();
    encode(
        (job.open)()?.as_mut(),
        Codec {
            hot: job.hot,
            ..job.config.into()
        },
        limits,
        all_cores(),
        &mut bytes,
        &mut |_| (),
    )
    .context("the host's encoder")?;
    let mut frames = Vec::new();
    let mut rest = &bytes[..];
    while !rest.is_empty() {
        let Scan::Frame(frame) = scan(rest) else {
            bail!(
                Other,
                "the host's encoder made bytes that are not a frame: please report this"
            );
        };
        let (frame, after) = rest.split_at(frame.bytes);
        frames.push(frame.to_vec());
        rest = after;
    }
    Ok(frames)
}
