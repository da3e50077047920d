//! A recording through an encoder on a microcontroller, compared with the host's own encoder.
//!
//! | file | what |
//! |---|---|
//! | `connection.rs` | a stream of bytes, both ways at once; a serial port would be another |
//! | `link.rs` | the packets and frames on it |
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

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use eecvs_nostd::event_link::{Kind, PACKET_BYTES_MAX, Setup, Status};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::window::EVENTS_MAX;
use eecvs_nostd::{Config, FRAME_BYTES_MAX, OUTPUT_BYTES_MIN, Scan, scan};

use crate::encode::{Limits, all_cores, encode};
use crate::formats::EventReader;
use account::Account;
use connection::Sender;
pub use connection::{Connection, Link};
use link::{EventPackets, Message, packet};

/// How long nothing may move before an encoder is taken for dead.
pub const PATIENCE: Duration = Duration::from_secs(20);
/// Time between two setups: a UART that is not ready yet loses the first.
const RETRY: Duration = Duration::from_secs(1);
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
    let limits = Limits {
        window_events: status.window_events as usize,
        frame_bytes: status.frame_bytes as usize,
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

/// Sets an encoder up, and again until it answers; everything that comes before is left over from
/// another run and is thrown away.
///
/// # Errors
/// No answer for as long as the connection's patience, a refusal, an answer that makes no sense.
pub fn set_up(connection: &mut Connection, setup: &Setup) -> Result<Status> {
    let mut body = [0; 96];
    let Ok(length) = setup.write(&mut body) else {
        bail!("the setup does not fit its packet");
    };
    let setup_packet = packet(Kind::Setup, 0, &body[..length])?;
    let patience = connection.patience();
    let mut answer = None;
    let greeted = AtomicBool::new(false);
    connection.exchange(
        |sender| {
            sender.send(&setup_packet)?;
            let started = Instant::now();
            while started.elapsed() < patience {
                sender.pause(RETRY.min(patience), || {
                    greeted.swap(false, Ordering::Relaxed)
                });
                if sender.is_stopped() {
                    return Ok(());
                }
                // Ends a packet that an earlier connection left unfinished.
                sender.send(&[0; PACKET_BYTES_MAX])?;
                sender.send(&setup_packet)?;
            }
            bail!(
                "no answer to the setup for {} s: is this the encoder's image?",
                patience.as_secs_f32()
            )
        },
        |message, _| {
            match status_of(&message)? {
                Some(status) if status.answers == Kind::Setup as u8 => {
                    answer = Some(status);
                    return Ok(ControlFlow::Break(()));
                }
                // It has just started: the first setup may have come too early.
                Some(Status { answers: 0, .. }) => greeted.store(true, Ordering::Relaxed),
                _ => {}
            }
            Ok(ControlFlow::Continue(()))
        },
    )?;
    let status = answer.context("the encoder did not answer the setup")?;
    ensure!(
        status.running,
        "the encoder refuses the setup: it has no memory for a sensor of {} x {} pixels, or for \
         this M and grid",
        setup.width,
        setup.height
    );
    let frame_bytes = status.frame_bytes as usize;
    ensure!(
        (1..=EVENTS_MAX).contains(&(status.window_events as usize))
            && (OUTPUT_BYTES_MIN..=FRAME_BYTES_MAX).contains(&frame_bytes),
        "the encoder claims windows of {} events and frames of {frame_bytes} bytes",
        status.window_events
    );
    connection.incoming().limit_frames(frame_bytes);
    Ok(status)
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
        job.config,
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
