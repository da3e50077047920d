//! `decode`: turns frames into messages of events, volumes and pictures.

use std::time::{Duration, Instant};

use anyhow::Result;
use clap::{Args, ValueEnum};
use eecvs::decode::FrameCounts;
use eecvs::reconstruct::DecodedWindow;
use eecvs::reconstruct::events::{EventDecoder, Finder};
use eecvs::reconstruct::recover::Confidences;
use eecvs::reconstruct::volume::{Channels, Maker, Weights};
use eecvs_cli::options::{WindowLimitOptions, WorkLimitOptions};
use eecvs_cli::values::finder;
use eecvs_cli::volume::VolumeOptions;
use eecvs_nostd::{Event, Polarity};

use super::emulate::PacketOptions;
use super::frame_reader::{Account, FrameReader};
use super::{Context, LossOptions, QosOptions, Sender, refuse_losses};
use crate::message::{DATA_BYTES, EventPacket, Header, Image, Time, Volume};
use crate::operator::{Decoded, Operators};

/// Topics that the node publishes.
pub const PUBLISHES: &[&str] = &["decoded/events", "volume", "image"];

/// Parameters that can be set while the node runs.
pub const CHANGEABLE: &[&str] = &["image", "image_hz"];

/// Decode frames: events on `decoded/events`, volumes on `volume`, pictures on `image`; nothing is computed for topics
/// without subscribers
#[derive(Debug, Clone, Args)]
pub struct Decode {
    /// How event times are found in the coefficients of the DCT and the DTFT (mode transform)
    #[arg(long, value_parser = finder(), value_name = "HOW", default_value = "exact")]
    events: Finder,

    #[command(flatten)]
    form: VolumeOptions,

    /// Maximum bytes of values per message: larger volumes are split into several; 0: never split
    #[arg(long, value_name = "BYTES", default_value_t = DATA_BYTES)]
    volume_bytes: u32,

    /// Pixel format of the pictures
    #[arg(long, value_enum, default_value = "mono8")]
    image: Look,

    /// Maximum pictures per second
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = hertz)]
    image_hz: f32,

    /// End after this many seconds without frames, once one has arrived
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    window_limit: WindowLimitOptions,

    #[command(flatten)]
    work_limit: WorkLimitOptions,

    #[command(flatten)]
    packets: PacketOptions,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

fn hertz(text: &str) -> Result<f32, String> {
    let hertz: f32 = text.parse().map_err(|_| "not a number".to_owned())?;
    let is_inside = (0.001..=1000.0).contains(&hertz);
    is_inside
        .then_some(hertz)
        .ok_or_else(|| format!("{hertz} is not in 0.001..=1000"))
}

/// Pixel format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Look {
    /// One byte per pixel: ON white, OFF black
    Mono8,
    /// Three bytes per pixel: ON red, OFF blue
    Rgb8,
}

/// Counts of decoded windows and events.
#[derive(Debug, Default)]
struct Totals {
    windows: u64,
    events: u64,
}

/// The publishers of the node.
struct Outputs {
    events: Sender<EventPacket>,
    volume: Sender<Volume>,
    image: Sender<Image>,
}

impl Decode {
    /// Decodes until a stop is requested, or until no frames arrive for the idle time.
    ///
    /// # Errors
    /// The transport fails, a volume cannot be computed, or something was lost and the options do not allow it.
    pub fn run(self, mut context: Context, operators: &Operators) -> Result<()> {
        let qos = self.qos.qos();
        let limit = self.window_limit.limit();
        let mut frames = FrameReader::new(&mut context, operators, qos, limit, self.idle_s)?;
        let mut outputs = Outputs {
            events: context.publisher("decoded/events", qos)?,
            volume: context.publisher("volume", qos)?,
            image: context.publisher("image", qos)?,
        };
        let mut making = Making::new(&self);
        let mut totals = Totals::default();
        let mut ready: Vec<Decoded> = Vec::new();
        let mut latest = Header::default();
        let mut is_warned = false;
        loop {
            let frame = frames.next_frame(&context, &mut ready)?;
            if let Some(now) = context.changed::<Self>() {
                making.show(now.image, now.image_hz);
            }
            let is_over = frame.is_none();
            match frame {
                Some(frame) => latest = frame.header,
                // The window whose last part has not come.
                None => frames.end(&mut ready),
            }
            for decoded in ready.drain(..) {
                totals.windows += 1;
                totals.events += making.window(decoded, &latest, &mut outputs)?;
                if !is_warned && let Some(warning) = making.confidences.warning() {
                    context.say(&warning);
                    is_warned = true;
                }
            }
            if is_over {
                break;
            }
        }
        if let Some(warning) = making.confidences.warning() {
            context.say(&warning);
        }
        context.say(&totals.line(frames.account(), &frames.counts(), &outputs));
        refuse_losses(self.losses.allow_loss, &frames.account().losses())
    }
}

impl Totals {
    fn line(&self, account: &Account, counts: &FrameCounts, outputs: &Outputs) -> String {
        format!(
            "{} events in {} windows of {} frames ({} lost, {} left out, {} of another publisher); \
             at the encoder {} late, {} filtered, {} dropped, {} thinned; sent {} event messages, \
             {} volume messages, {} pictures",
            self.events,
            self.windows,
            account.frames,
            account.sequence.lost,
            account.refused,
            account.others,
            counts.events_late,
            counts.events_filtered,
            counts.events_dropped,
            counts.events_thinned,
            outputs.events.sent().messages,
            outputs.volume.sent().messages,
            outputs.image.sent().messages
        )
    }
}

/// Turns windows into messages.
struct Making<'o> {
    options: &'o Decode,
    finder: EventDecoder,
    confidences: Confidences,
    packer: Option<((u32, u32), crate::packing::Packer)>,
    volumes: Maker,
    volume_seq: u64,
    picture: Picture,
}

impl<'o> Making<'o> {
    fn new(options: &'o Decode) -> Self {
        let limit = options.work_limit.limit();
        let events = || EventDecoder::new(options.events).with_work_limit(limit);
        Self {
            options,
            finder: events(),
            confidences: Confidences::default(),
            packer: None,
            volumes: Maker::new(options.form.form(), events()),
            volume_seq: 0,
            picture: Picture::new(options.image, options.image_hz),
        }
    }

    /// Draws pictures in another format, or at another rate, from here on.
    fn show(&mut self, look: Look, hertz: f32) {
        let sent = self.picture.sent;
        self.picture = Picture {
            sent,
            ..Picture::new(look, hertz)
        };
    }

    /// Publishes a window, completed by the frame with this header; returns the number of its events.
    fn window(&mut self, decoded: Decoded, header: &Header, outputs: &mut Outputs) -> Result<u64> {
        let (sensor, events) = match decoded {
            Decoded::Window(mut window) => {
                if outputs.volume.subscribers() > 0 {
                    self.volume(&window, header, &mut outputs.volume)?;
                }
                self.confidences.add(self.finder.fill(&mut window));
                (window.header.sensor, window.events)
            }
            Decoded::Events(span, events) => (span.sensor, events),
        };
        if outputs.image.subscribers() > 0 {
            self.picture.add(sensor, &events);
            if let Some(image) = self.picture.take(header) {
                outputs.image.send(&image)?;
            }
        }
        if outputs.events.subscribers() > 0 {
            let size = (u32::from(sensor.width), u32::from(sensor.height));
            let packer = match &mut self.packer {
                Some((of, packer)) if *of == size => packer,
                other => &mut other.insert((size, self.options.packets.packer(sensor))).1,
            };
            let sender = &mut outputs.events;
            packer.push(&events, |packet, _| sender.send(packet))?;
            packer.flush(&mut |packet: &EventPacket, _| sender.send(packet))?;
        }
        Ok(events.len() as u64)
    }

    /// Publishes a window's volume, in several messages if it exceeds the size limit.
    fn volume(
        &mut self,
        window: &DecodedWindow,
        header: &Header,
        sender: &mut Sender<Volume>,
    ) -> Result<()> {
        let volume = self.volumes.volume(window)?;
        let [channels, height, width] = volume.shape();
        let area = height * width;
        let mut message = Volume {
            header: header.clone(),
            t0_us: window.header.t0_us,
            duration_us: window.header.duration_us,
            channels: channels as u32,
            height: height as u32,
            width: width as u32,
            layout: match self.options.form.form().channels {
                Channels::Coefficients => window.header.transform.name(),
                Channels::Bins {
                    weights: Weights::Nearest,
                    ..
                } => "bins",
                Channels::Bins {
                    weights: Weights::Bilinear,
                    ..
                } => "bilinear",
            }
            .to_owned(),
            ..Volume::default()
        };
        let most = match self.options.volume_bytes as usize / size_of::<f32>() {
            0 => channels * area,
            values => values,
        };
        let mut plane = vec![0.0; area];
        let mut send = |message: &mut Volume| {
            message.seq = self.volume_seq;
            self.volume_seq += 1;
            let sent = sender.send(message);
            message.offset += message.values.len() as u64;
            message.values.clear();
            sent
        };
        for channel in 0..channels {
            volume.plane(channel, &mut plane);
            let mut rest = plane.as_slice();
            while !rest.is_empty() {
                let room = most - message.values.len();
                let (now, later) = rest.split_at(room.min(rest.len()));
                message.values.extend_from_slice(now);
                if message.values.len() == most {
                    send(&mut message)?;
                }
                rest = later;
            }
        }
        if !message.values.is_empty() {
            send(&mut message)?;
        }
        Ok(())
    }
}

/// The picture being drawn.
struct Picture {
    look: Look,
    every: Duration,
    sent: Option<Instant>,
    image: Image,
}

impl Picture {
    fn new(look: Look, hertz: f32) -> Self {
        let every = Duration::try_from_secs_f32(1.0 / hertz);
        Self {
            look,
            every: every.unwrap_or_default(),
            sent: None,
            image: Image::default(),
        }
    }

    fn add(&mut self, sensor: eecvs_nostd::Sensor, events: &[Event]) {
        let (height, width) = (u32::from(sensor.height), u32::from(sensor.width));
        let (encoding, bytes) = match self.look {
            Look::Mono8 => ("mono8", 1),
            Look::Rgb8 => ("rgb8", 3),
        };
        if (self.image.height, self.image.width) != (height, width) {
            self.image = Image {
                height,
                width,
                encoding: encoding.to_owned(),
                step: width * bytes,
                data: vec![self.blank(); (height * width * bytes) as usize],
                ..Image::default()
            };
        }
        for event in events {
            let at = (u32::from(event.y) * width + u32::from(event.x)) * bytes;
            let is_on = event.polarity == Polarity::On;
            let colour: &[u8] = match (self.look, is_on) {
                (Look::Mono8, true) => &[255],
                (Look::Mono8, false) => &[0],
                (Look::Rgb8, true) => &[220, 40, 40],
                (Look::Rgb8, false) => &[40, 80, 220],
            };
            let at = at as usize;
            if let Some(pixel) = self.image.data.get_mut(at..at + colour.len()) {
                pixel.copy_from_slice(colour);
            }
        }
    }

    const fn blank(&self) -> u8 {
        match self.look {
            Look::Mono8 => 128,
            Look::Rgb8 => 255,
        }
    }

    /// Returns the picture if one is due, and starts the next one.
    fn take(&mut self, header: &Header) -> Option<Image> {
        if self.sent.is_some_and(|sent| sent.elapsed() < self.every) {
            return None;
        }
        self.sent = Some(Instant::now());
        let mut image = self.image.clone();
        let blank = self.blank();
        self.image.data.fill(blank);
        image.header = Header {
            stamp: if header.stamp == Time::default() {
                Time::now()
            } else {
                header.stamp
            },
            frame_id: header.frame_id.clone(),
        };
        Some(image)
    }
}
