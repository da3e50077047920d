//! A recording through an encoder on a microcontroller, compared with the host's own encoder.
//!
//! | file | what |
//! |---|---|
//! | `connection.rs` | a stream of bytes, both ways at once; a serial port would be another |
//! | `link.rs` | the packets and frames on it |
//! | `setting_up.rs` | the setup and the hot pixels, until the encoder answers |
//! | `account.rs` | what came back, frame by frame |
//! | `qemu.rs` | the emulated machine at the other end |
//! | `image.rs` | the firmware image: building it, its sizes |
//! | `log.rs` | the image's log |
//!
//! [`run`] needs only a [`Connection`], whatever is behind it.

mod account;
pub mod connection;
pub mod image;
pub mod link;
pub mod log;
pub mod qemu;
mod setting_up;

use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use eecvs::encode::{Codec, Limits, all_cores, encode};
use eecvs_nostd::event_link::{Kind, Setup, Status};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::{Config, Scan, scan};
use event_files::EventReader;

use account::Account;
use connection::Sender;
pub use connection::{Connection, Link};
use link::{EventPackets, Message};
pub use setting_up::{keep_out, set_up};

/// How long nothing may move before an encoder is taken for dead.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// Events that are put into packets at a time.
const CHUNK_EVENTS: usize = 1 << 10;
/// Period of the time in EVT 2.0 words.
const WORDS_PERIOD_US: u64 = 1 << 34;

/// A recording, and what an encoder is to do with it.
pub struct Job<'j> {
    /// Opens the recording, each time from its first event.
    pub open: &'j (dyn Fn() -> Result<Box<dyn EventReader>> + Sync),
    /// How to encode it.
    pub config: Config,
    /// Pixels that are never sent, each once, in raster order: column and row.
    pub hot: &'j [(u16, u16)],
    /// Whether the encoder drops events while it has no room, rather than hold the link.
    pub drop_when_full: bool,
}

/// What became of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Events sent.
    pub events: u64,
    /// Windows with events that came back.
    pub windows: u64,
    /// Frames that came back.
    pub frames: u64,
    /// Whether there were frames of the host's to compare with.
    pub compared: bool,
    /// Frames with the bytes of the host's.
    pub frames_identical: u64,
    /// Frames that differ, have not come, or should not have.
    pub frames_different: u64,
    /// Events in frames.
    pub events_encoded: u64,
    /// Events that frames count as late.
    pub events_late: u64,
    /// Events that frames count as kept out by a filter.
    pub events_filtered: u64,
    /// Left out by the rate control.
    pub events_thinned: u64,
    /// Events that frames count as lost.
    pub events_lost: u64,
    /// The encoder's own account since its setup.
    pub status: Status,
    /// The frames that came back, one after the other.
    pub bytes: Vec<u8>,
    /// What is wrong, a line each; empty for a good run.
    pub problems: Vec<String>,
}

impl Outcome {
    /// Nanoseconds of the encoder's clock for an event: received, encoded, sent. 0 without events.
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

    /// Whether all is well.
    ///
    /// # Errors
    /// Everything that is not, in one line.
    pub fn verdict(&self) -> Result<()> {
        ensure!(self.problems.is_empty(), "{}", self.problems.join("; "));
        Ok(())
    }
}

/// Sends a recording to an encoder and compares what comes back with the host's frames; `progress`
/// gets the events sent so far.
///
/// With [`Job::drop_when_full`] there is nothing to compare with: every frame is unpacked and every
/// event accounted for instead.
///
/// # Errors
/// A recording that cannot be read or sent, an encoder that refuses it, a link that fails or
/// stalls. Frames that differ and events that are lost are no errors but [`Outcome::problems`].
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
    let limits = Limits {
        window_events: status.window_events as usize,
        frame_bytes: status.frame_bytes as usize,
        // As the image does, which has no memory to hold events.
        reorder_us: Some(0),
        dense_words: status.dense_words as usize,
    };
    let expected = if job.drop_when_full {
        None
    } else {
        Some(host_frames(job, limits)?)
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

/// What a first look at the recording tells.
struct Plan {
    events: u64,
    time_base_us: u64,
}

impl Plan {
    /// Reads the recording once, so that nothing is sent of one that cannot be sent whole.
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
                    // A whole number of periods: the words are those of a camera with this clock.
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
                "event {index}: its time {t_us} us lies before {} us or after a gap that EVT 2.0 \
                 words cannot show (4.7 hours), as do {} further events: cut the recording there",
                plan.time_base_us,
                refusals - 1
            );
        }
        Ok(plan)
    }
}

/// The status that a message is.
fn status_of(message: &Message) -> Result<Option<Status>> {
    match message {
        Message::Packet(Kind::Status, body) => Status::parse(body).map(Some).context(
            "the encoder's status has another layout: build its image from the same sources",
        ),
        _ => Ok(None),
    }
}

/// Sends the whole recording and what ends it.
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

/// The frames of the host's own encoder.
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
            bail!("the host's encoder made bytes that are no frame: please report this");
        };
        let (frame, after) = rest.split_at(frame.bytes);
        frames.push(frame.to_vec());
        rest = after;
    }
    Ok(frames)
}
