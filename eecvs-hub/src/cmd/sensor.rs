//! `eecvs-hub sensor`: encodes events, and sends the frames to a hub.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use eecvs::encode::{Codec, EncodeSummary, Limits, encode};
use eecvs_cli::codec::CodecOptions;
use eecvs_cli::options::ReadingOptions;
use eecvs_cli::order::OrderOptions;
use eecvs_cli::output::{print, print_json, rows};
use eecvs_cli::values::preset;
use eecvs_nostd::Sensor as Size;
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use serde::Serialize;
use usb_bridge::cmd::options::{PlaceOptions, refuse_late, warn_of_losses, warn_of_runs};
use usb_bridge::device::mcu;
use usb_bridge::peripheral::stream::Pace;
use usb_bridge::record::{Order, encoders_frames};
use usb_bridge::session::{self, Session};
use usb_bridge::stop::Stop;

use super::options::ClientOptions;
use crate::clock::Clock;
use crate::frames::UplinkSink;
use crate::key::Name;
use crate::source::Live;
use crate::store::disk::Settings;
use crate::uplink::{Options, Summary, Uplink};

/// Encode the events of a camera, a recording or a scene, and send them to a hub; while there is no link, frames
/// are kept
#[derive(Debug, Clone, Args)]
pub struct Sensor {
    /// Name of the sensor: door, or hall-1/door
    name: Name,

    #[command(flatten)]
    client: ClientOptions,

    #[command(flatten)]
    device: PlaceOptions,

    /// Recording to send instead of a device's events
    #[arg(long, value_name = "FILE", conflicts_with = "device")]
    recording: Option<PathBuf>,

    /// Scene to send instead of a device's events, one of those that `eecvs emulate --list` shows [default:
    /// indoor-flying, if there is no device and no recording]
    #[arg(long, value_parser = preset(), conflicts_with_all = ["device", "recording"])]
    scene: Option<Preset>,

    /// The same seed gives the same scene on every machine
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Duration of the scene in microseconds [default: 1000000]
    #[arg(long, value_name = "D")]
    duration_us: Option<u64>,

    #[command(flatten)]
    reading: ReadingOptions,

    /// Pace of a recording or a scene: real (as recorded), max (as fast as possible), N events per second, or Fx (F
    /// times as fast as recorded)
    #[arg(long, value_name = "real|max|N|Fx", default_value = "real")]
    rate: Pace,

    /// Start again at the end, with times that continue
    #[arg(long)]
    repeat: bool,

    /// End after this many seconds
    #[arg(long, value_name = "S")]
    seconds: Option<u32>,

    /// Memory for the newest frames, in MiB
    #[arg(long, value_name = "MIB", default_value_t = 64,
          value_parser = clap::value_parser!(u16).range(1..=16_384))]
    memory_mib: u16,

    /// Folder for frames that no longer fit in memory, if they were made while there was no link or just before
    #[arg(long, value_name = "FOLDER")]
    store: Option<PathBuf>,

    /// Size limit of this folder, in MiB; beyond it, the oldest frames are deleted and counted
    #[arg(long, value_name = "MIB", default_value_t = 1024, requires = "store",
          value_parser = clap::value_parser!(u32).range(1..))]
    store_mib: u32,

    /// Milliseconds between syncs of this folder: a power cut costs the frames that were written to it since the last;
    /// 0 syncs every frame, at the disk's speed
    #[arg(long, value_name = "MS", default_value_t = 1000, requires = "store",
          value_parser = clap::value_parser!(u32).range(..=3_600_000))]
    sync_ms: u32,

    /// Maximum bytes of a frame: larger windows are split into several frames
    #[arg(long, value_name = "BYTES", default_value_t = 98_000,
          value_parser = clap::value_parser!(u32)
              .range(eecvs_nostd::OUTPUT_BYTES_MIN as i64..=eecvs_nostd::FRAME_BYTES_MAX as i64))]
    frame_bytes: u32,

    /// At the end, wait at most this many seconds for receivers that request frames again, or for a link; after a signal,
    /// such as Ctrl-C, not even one
    #[arg(long, value_name = "S", default_value_t = 10)]
    linger_s: u32,

    /// Seconds by which the times that are sent are ahead of this computer's clock: for a computer whose clock is known
    /// to be wrong and cannot be set, and for tests
    #[arg(
        long,
        value_name = "S",
        default_value_t = 0,
        hide = true,
        allow_negative_numbers = true
    )]
    clock_ahead_s: i32,

    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,

    #[command(flatten)]
    order: OrderOptions,

    #[command(flatten)]
    codec: CodecOptions,
}

/// Counts of what was sent; the fields are the JSON keys.
#[derive(Debug, Serialize)]
struct Sent {
    name: String,
    #[serde(flatten)]
    encoding: EncodeSummary,
    frames_unsent: u64,
    frames_again: u64,
    frames_let_go: u64,
    frames_on_disk: u64,
    disk_failures: u64,
    disk_damaged_frames: u64,
    disk_damaged_bytes: u64,
    outages: u64,
    outages_s: f64,
}

impl Sensor {
    /// Sends until the end, or until a stop is requested.
    ///
    /// # Errors
    /// The source cannot be read, keys or a folder cannot be used, or the encoder's options are invalid; also if
    /// events came too late for any frame and the options make that an error.
    pub fn run(self, stop: &Stop) -> Result<()> {
        let (encoding, summary) = match (self.device.name(), &self.recording, self.scene) {
            (Some(_), ..) => self.device(stop)?,
            (None, Some(path), _) => {
                self.file(event_files::open(path, self.reading.reading())?, stop)?
            }
            (None, None, scene) => {
                let mut config =
                    SceneConfig::model_1(scene.unwrap_or(Preset::IndoorFlying), self.seed);
                config.sensor = self.reading.sensor().unwrap_or(config.sensor);
                config.duration_us = self.duration_us.unwrap_or(config.duration_us);
                self.file(Box::new(emulate(config)?), stop)?
            }
        };
        let status = &summary.status;
        let sent = Sent {
            name: self.name.to_string(),
            frames_unsent: summary.unsent,
            frames_again: status.again,
            frames_let_go: status.stored.let_go_frames,
            frames_on_disk: status.stored.disk_frames,
            disk_failures: status.stored.disk_failures,
            disk_damaged_frames: status.stored.disk_damaged_frames,
            disk_damaged_bytes: status.stored.disk_damaged_bytes,
            outages: status.outages,
            outages_s: status.outages_us as f64 * 1e-6,
            encoding,
        };
        match self.json {
            true => print_json(&sent)?,
            false => print(&sent.table())?,
        }
        let order = Order::from(&sent.encoding);
        warn_of_runs(&sent.name, &order);
        refuse_late(&sent.name, &order, self.order)
    }

    fn clock(&self) -> Clock {
        Clock::start_ahead(i64::from(self.clock_ahead_s) * 1_000_000)
    }

    fn uplink(&self, sensor: Size, clock: Clock) -> Result<Uplink> {
        let options = Options {
            name: self.name.clone(),
            sensor,
            memory_bytes: usize::from(self.memory_mib) << 20,
            disk: self.store.clone().map(|folder| (folder, self.settings())),
            bytes_per_second: self.codec.config(sensor)?.bytes_per_second.map(u32::from),
            clock,
        };
        Uplink::start(&options, &self.client.links())
    }

    fn settings(&self) -> Settings {
        Settings {
            bytes_max: u64::from(self.store_mib) << 20,
            sync_ms: self.sync_ms,
        }
    }

    fn finish(&self, uplink: Uplink, stop: &Stop) -> Summary {
        let linger = Duration::from_secs(self.linger_s.into());
        // Whoever sends a signal waits for the end.
        uplink.finish_while(linger, &|| !stop.is_signalled())
    }

    fn file(&self, reader: Box<dyn EventReader>, stop: &Stop) -> Result<(EncodeSummary, Summary)> {
        let stop = self.timed(stop);
        let clock = self.clock();
        let live = Live::new(reader, self.rate, self.repeat, clock, stop.clone())?;
        let due = live.due_times();
        let uplink = self.uplink(live.sensor(), clock)?;
        let encoding = self.encode(Box::new(live), &uplink, &|t_us| due.at(t_us));
        let summary = self.finish(uplink, &stop);
        Ok((encoding?, summary))
    }

    /// Returns the stop request, which is also triggered after the set time.
    fn timed(&self, stop: &Stop) -> Stop {
        if let Some(seconds) = self.seconds {
            let (stop, until) = (
                stop.clone(),
                Instant::now() + Duration::from_secs(seconds.into()),
            );
            std::thread::spawn(move || {
                while !stop.is_asked() && Instant::now() < until {
                    std::thread::sleep(Duration::from_millis(20));
                }
                stop.ask();
            });
        }
        stop.clone()
    }

    fn device(&self, stop: &Stop) -> Result<(EncodeSummary, Summary)> {
        let stop = self.timed(stop);
        let source = self.device.open(self.device.name(), self.rate, &stop)?;
        let sends_frames = source.model.name() == mcu::NAME;
        let session = Session::start(source, QUEUE_BYTES, &stop, session::Limits::default())?;
        let reader = session.reader();
        let clock = self.clock();
        let uplink = self.uplink(reader.sensor(), clock)?;
        let encoding = match sends_frames {
            true => {
                drop(reader);
                let end_us = |_| clock.now_us();
                let mut out = UplinkSink::new(&uplink, &end_us);
                let mut order = Order::default();
                let ended = encoders_frames(&session, &mut out, &mut order);
                out.finish(ended).map(|()| EncodeSummary {
                    events_in: order.events + order.events_late,
                    events_encoded: order.events,
                    events_late: order.events_late,
                    runs: order.runs,
                    ..EncodeSummary::default()
                })
            }
            // It is unknown when a camera's events were due: use the time of arrival.
            false => self.encode(Box::new(reader), &uplink, &|_| clock.now_us()),
        };
        let (report, unstopped) = session.finish();
        warn_of_losses(&report);
        let summary = self.finish(uplink, &stop);
        unstopped.map_or(Ok((encoding?, summary)), Err)
    }

    fn encode(
        &self,
        reader: Box<dyn EventReader>,
        uplink: &Uplink,
        end_us: &dyn Fn(u64) -> u64,
    ) -> Result<EncodeSummary> {
        let config = self.codec.config(reader.sensor())?;
        let (mut reader, config) = self.codec.look(reader, config);
        let hot = self.codec.hot_pixels(reader.sensor())?;
        let budget = uplink.budget();
        let codec = Codec {
            hot: &hot,
            budget: Some(&budget),
            max_nmse: self.codec.max_nmse(),
            ..Codec::from(config)
        };
        let limits = Limits {
            frame_bytes: self.frame_bytes as usize,
            reorder_us: self.order.reorder_us,
            ..Limits::default()
        };
        let mut out = UplinkSink::new(uplink, end_us);
        let encoded = encode(
            reader.as_mut(),
            codec,
            limits,
            NonZeroUsize::MIN,
            &mut out,
            &mut |_| {},
        );
        out.finish(encoded.map_err(Into::into))
    }
}

/// Bytes that may wait between a device and the encoder.
const QUEUE_BYTES: usize = 64 << 20;

impl Sent {
    fn table(&self) -> String {
        let encoding = &self.encoding;
        rows([
            ("sensor", self.name.clone()),
            ("events", encoding.events_in.to_string()),
            ("  runs of the clock", encoding.runs.to_string()),
            ("  encoded", encoding.events_encoded.to_string()),
            ("  late", encoding.events_late.to_string()),
            ("  filtered", encoding.events_filtered.to_string()),
            ("  dropped", encoding.events_dropped.to_string()),
            ("  thinned", encoding.events_thinned.to_string()),
            ("frames", encoding.frames.to_string()),
            ("  sent again", self.frames_again.to_string()),
            ("  not sent", self.frames_unsent.to_string()),
            ("  dropped by the store", self.frames_let_go.to_string()),
            ("  on disk", self.frames_on_disk.to_string()),
            ("  not written to disk", self.disk_failures.to_string()),
            ("  damaged on disk", self.disk_damaged_frames.to_string()),
            ("bytes", encoding.bytes_out.to_string()),
            ("bits per event", format!("{:.2}", encoding.bits_per_event)),
            (
                "without a link",
                format!("{} times, {:.1} s", self.outages, self.outages_s),
            ),
        ])
    }
}
