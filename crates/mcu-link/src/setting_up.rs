//! Sends an encoder the setup and the hot pixels before the first event, repeating each until it answers.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use eecvs_nostd::event_link::{
    BODY_BYTES_MAX, FIELDS_BYTES_MAX, HotNumbers, Kind, PACKET_BYTES_MAX, Refusal, Setup, Status,
};
use eecvs_nostd::window::EVENTS_MAX;
use eecvs_nostd::{FRAME_BYTES_MAX, OUTPUT_BYTES_MIN, Sensor};
use event_types::stream::{Context, Result};
use event_types::{bail, ensure};

use super::connection::Connection;
use super::link::packet;
use super::status_of;

/// Interval between repeated packets: a UART that is not ready yet loses the first.
const RETRY: Duration = Duration::from_secs(1);

/// Sets up an encoder, repeating the setup until the encoder answers, and returns its answer.
///
/// Anything received before the answer is left over from another run and is discarded.
///
/// # Errors
/// No answer within the connection's patience, a refusal, or an answer with impossible limits.
pub fn set_up(connection: &mut Connection, setup: &Setup) -> Result<Status> {
    let mut body = [0; FIELDS_BYTES_MAX];
    let Ok(length) = setup.write(&mut body) else {
        bail!(CannotHold, "the setup does not fit its packet");
    };
    let status = ask(connection, Kind::Setup, &body[..length])?;
    ensure!(
        status.running,
        Refused,
        "the encoder refuses the setup for {} x {} pixels: {}",
        setup.width,
        setup.height,
        status.refusal.map_or("it does not say why", reason)
    );
    let frame_bytes = status.frame_bytes as usize;
    ensure!(
        (1..=EVENTS_MAX).contains(&(status.window_events as usize))
            && (OUTPUT_BYTES_MIN..=FRAME_BYTES_MAX).contains(&frame_bytes),
        Damaged,
        "the encoder claims windows of {} events and frames of {frame_bytes} bytes",
        status.window_events
    );
    connection.incoming().limit_frames(frame_bytes);
    Ok(status)
}

/// Sends the hot pixels to an encoder that has been set up; it then ignores their events.
///
/// `pixels` holds (column, row), each once and in raster order. Returns the encoder's last answer, or `None` if
/// `pixels` is empty.
///
/// # Errors
/// As for [`set_up`]; pixels that are not in raster order, or for which the encoder has no memory.
pub fn keep_out(
    connection: &mut Connection,
    sensor: Sensor,
    pixels: &[(u16, u16)],
) -> Result<Option<Status>> {
    let mut rest = pixels;
    let (mut told, mut last) = (0, None);
    while !rest.is_empty() {
        let (mut body, mut numbers) = ([0; BODY_BYTES_MAX], HotNumbers::START);
        let fits = rest
            .iter()
            .take_while(|pixel| numbers.write(sensor.number(**pixel), &mut body))
            .count();
        ensure!(fits > 0, Refused, "hot pixels must be in raster order");
        rest = &rest[fits..];
        told += fits;
        let status = ask(connection, Kind::Hot, &body[..numbers.bytes()])?;
        let held = status.hot_pixels as usize;
        ensure!(
            status.refusal.is_none() && held == told,
            Refused,
            "the encoder leaves out {held} of {} hot pixels: {}",
            pixels.len(),
            status.refusal.map_or("some were lost", reason)
        );
        last = Some(status);
    }
    Ok(last)
}

/// Sends a packet repeatedly until it is answered; no events may have been sent before.
fn ask(connection: &mut Connection, kind: Kind, body: &[u8]) -> Result<Status> {
    let what = match kind {
        Kind::Hot => "hot pixels",
        _ => "setup",
    };
    let question = packet(kind, 0, body)?;
    // The zeros end a packet that an earlier connection left unfinished. Zeros and question are sent at once: if an
    // answer came in between, the zeros would be counted as damage, indistinguishable from damage of this run.
    let again = [&[0; PACKET_BYTES_MAX][..], &question].concat();
    let patience = connection.patience();
    let mut answer = None;
    let greeted = AtomicBool::new(false);
    connection.exchange(
        |sender| {
            sender.send(&question)?;
            let started = Instant::now();
            while started.elapsed() < patience {
                sender.pause(RETRY.min(patience), || {
                    greeted.swap(false, Ordering::Relaxed)
                });
                if sender.is_stopped() {
                    return Ok(());
                }
                sender.send(&again)?;
            }
            bail!(
                Other,
                "no answer to the {what} for {} s: is this the encoder's image?",
                patience.as_secs_f32()
            )
        },
        |message, _| {
            match status_of(&message)? {
                Some(status) if status.answers == kind as u8 => {
                    answer = Some(status);
                    return Ok(ControlFlow::Break(()));
                }
                // The encoder has just started: the first packet may have arrived too early.
                Some(Status { answers: 0, .. }) => greeted.store(true, Ordering::Relaxed),
                _ => {}
            }
            Ok(ControlFlow::Continue(()))
        },
    )?;
    answer.with_context(|| format!("the encoder did not answer the {what}"))
}

const fn reason(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::Sensor => {
            "a side of the sensor is out of range, or the encoder's own sensor has another size"
        }
        Refusal::Thresholds => "the thresholds are in the wrong order",
        Refusal::Transform => "it has no such transform",
        Refusal::Step => "the step is out of range",
        Refusal::Mode => "it has no such mode, coder or fidelity",
        Refusal::Readout => "no sensor has such a readout",
        Refusal::Flag => "a flag is neither 0 nor 1",
        Refusal::M => "M must be 1 to 64",
        Refusal::Grid => "the grid must be 1 to 1024",
        Refusal::Numbers => "it has no memory for this M and grid",
        Refusal::Dense => "it has no dense coder, or no memory for it on this sensor",
        Refusal::Bins => "bins must be 1 or more",
        Refusal::Rate => "the budget is too small, or the mode is not hybrid",
        Refusal::Windows => {
            "it has no memory for windows of this sensor, or their duration is 0 us"
        }
        Refusal::HotOutside => "one is not on the sensor",
        Refusal::HotRoom => "it has no memory for more",
        Refusal::HotUnset => "they came before a setup",
        Refusal::Order => "it cannot keep the order of events",
        Refusal::MeanError => "a largest mean error is for mode hybrid without another fidelity",
        Refusal::Coefficients => "it has no adaptive coder of coefficients: use --coder plain",
    }
}
