//! Encodes events into the frames that an encoder sends: lossless, with the fast coder, in windows of 32,768 us.
//!
//! The core's encoder runs in its own thread, which owns its memory. Events are first put in order of time within
//! 20 ms, because an encoder drops those that are too late for their window.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use anyhow::{Context, Result, bail, ensure};
use eecvs::encode::HostStorage;
use eecvs_nostd::{
    Coder, Config, Encoder, Event, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Push, Quantiser,
    Sensor, Thresholds, WindowConfig,
};

use crate::device::WriteStream;

const ZERO: Thresholds = Thresholds::new(0, 0).unwrap();
/// Window length T, in microseconds.
const WINDOW_US: u32 = 32_768;
/// Events per window: as many as fit a microcontroller's memory.
pub(super) const WINDOW_EVENTS: usize = 4096;
/// Size of the buffer for a frame.
pub(super) const FRAME_BYTES: usize = 1 << 14;
/// Span within which events may be out of order, in microseconds.
const ORDER_US: u64 = 20_000;

/// A request to the encoder's thread.
enum Work {
    Events(Vec<Event>),
    Flush,
}

type Answer = Result<Vec<u8>>;

/// Writer of frames.
pub struct McuStream {
    sensor: Sensor,
    work: Option<SyncSender<Work>>,
    answers: Receiver<Answer>,
    thread: Option<JoinHandle<()>>,
    /// Events that may still be preceded by ones that arrive later.
    held: Vec<Event>,
    events: u64,
}

impl McuStream {
    /// Starts a stream of an encoder with this sensor.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        let (work, to_do) = sync_channel(1);
        let (done, answers) = sync_channel(1);
        let thread = std::thread::spawn(move || run(sensor, &to_do, &done));
        Self {
            sensor,
            work: Some(work),
            answers,
            thread: Some(thread),
            held: Vec::new(),
            events: 0,
        }
    }

    fn ask(&mut self, work: Work, bytes: &mut Vec<u8>) -> Result<()> {
        const GONE: &str = "the encoder's thread has ended: please report this";
        let sent = self.work.as_ref().map(|to| to.send(work).is_ok());
        ensure!(sent == Some(true), GONE);
        bytes.extend(self.answers.recv().context(GONE)??);
        Ok(())
    }
}

impl WriteStream for McuStream {
    fn write(&mut self, events: &[Event], bytes: &mut Vec<u8>) -> Result<()> {
        for (event, index) in events.iter().zip(self.events..) {
            ensure!(
                self.sensor.contains(event.x, event.y),
                "event {index} at x = {}, y = {} is outside the sensor ({}x{})",
                event.x,
                event.y,
                self.sensor.width,
                self.sensor.height
            );
        }
        self.events += events.len() as u64;
        self.held.extend_from_slice(events);
        // The sort is stable, so events of equal times keep their order.
        self.held.sort_by_key(|event| event.t_us);
        let newest_us = self.held.last().map_or(0, |event| event.t_us);
        let settled_us = newest_us.saturating_sub(ORDER_US);
        let settled = self.held.partition_point(|event| event.t_us <= settled_us);
        let later = self.held.split_off(settled);
        let now = std::mem::replace(&mut self.held, later);
        self.ask(Work::Events(now), bytes)
    }

    /// An encoder sends frames of windows with events, and nothing in a silence.
    fn advance(&mut self, _: u64, _: &mut Vec<u8>) {}

    fn reset_time(&mut self, _: &mut Vec<u8>) -> bool {
        false
    }

    fn restart(&mut self) {
        *self = Self::new(self.sensor);
    }

    fn finish(&mut self, bytes: &mut Vec<u8>) -> Result<()> {
        let rest = std::mem::take(&mut self.held);
        self.ask(Work::Events(rest), bytes)?;
        self.ask(Work::Flush, bytes)
    }
}

impl Drop for McuStream {
    fn drop(&mut self) {
        // The thread ends when its work channel is closed.
        self.work = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Returns the configuration with which the frames are encoded.
pub(super) const fn config(sensor: Sensor) -> Config {
    Config {
        window: WindowConfig::new(sensor, WINDOW_US),
        thresholds: ZERO,
        transform: None,
        m: 16,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        few_as_times: false,
        max_emd_us: None,
        mode: Mode::Hybrid(Hybrid {
            coder: Coder::Fast,
            fidelity: Fidelity::Lossless,
        }),
        key_windows: KEY_WINDOWS,
        readout: None,
        filter: Filter::NONE,
        bytes_per_second: None,
        keep_order: false,
    }
}

fn run(sensor: Sensor, work: &Receiver<Work>, done: &SyncSender<Answer>) {
    let mut storage = HostStorage::new(sensor, WINDOW_EVENTS);
    let mut encoder = storage.encoder(config(sensor));
    let mut frame = vec![0; FRAME_BYTES];
    for work in work {
        let answer = match &mut encoder {
            Ok(encoder) => encode(encoder, work, &mut frame),
            Err(error) => Err(anyhow::anyhow!("{error:#}")),
        };
        if done.send(answer).is_err() {
            break;
        }
    }
}

fn encode(encoder: &mut Encoder<'_>, work: Work, frame: &mut [u8]) -> Answer {
    let mut bytes = Vec::new();
    match work {
        Work::Events(events) => {
            for event in events {
                // A window that is full or over is sent first; the event is then pushed again.
                while encoder.push(event) == Push::Closed {
                    frames(encoder, frame, &mut bytes)?;
                }
            }
        }
        Work::Flush => {
            encoder.flush();
            frames(encoder, frame, &mut bytes)?;
        }
    }
    Ok(bytes)
}

fn frames(encoder: &mut Encoder<'_>, frame: &mut [u8], bytes: &mut Vec<u8>) -> Result<()> {
    loop {
        match encoder.next_frame(frame) {
            Ok(Some(encoded)) => bytes.extend_from_slice(&frame[encoded.range]),
            Ok(None) => return Ok(()),
            Err(_) => bail!("a pixel does not fit in a frame: please report this"),
        }
    }
}
