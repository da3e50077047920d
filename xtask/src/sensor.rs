//! A simulated sensor on a microcontroller's port, at rising rates: how many events are lost, are they those that the
//! resources predict, and is every one counted?

use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use eecvs_bench::marks::Marks;
use eecvs_nostd::{Coder, Config, Event, Fidelity, Hybrid, Mode, Sensor, Thresholds, WindowConfig};
use event_emulator::{Preset, SceneConfig, emulate};
use event_files::EventReader;
use mcu_link::Outcome;
use mcu_link::image;
use mcu_link::qemu::Machine;
use mcu_link::sensor::{Resources, Scene, Seen};

use crate::tree;

const MARKS: Marks = Marks {
    name: "sensor",
    command: "cargo xtask sensor --save",
};
const DOCUMENT: &str = "docs/boards.md";

/// A GENX320.
const SENSOR: Sensor = Sensor {
    width: 320,
    height: 320,
};
const WINDOW_US: u32 = 32_768;
/// For transforms alone.
const THRESHOLDS: Thresholds = Thresholds::new(0, 0).unwrap();
const EVENTS: usize = 300_000;
/// Rates at which a processor of a thousand million instructions a second loses nothing, and nearly everything if its link
/// is stuck.
const SLOW: f64 = 2.0;
const QUICK: f64 = 10.0;
/// Largest difference between the shares of events that are lost and that are predicted to be.
const TOLERANCE: f64 = 0.02;
/// Rounds of a prediction.
const ROUNDS: usize = 4;
const PATIENCE: Duration = Duration::from_secs(300);

/// A processor, and the link behind it.
#[derive(Debug, Clone, Copy)]
pub struct Board {
    name: &'static str,
    /// An instruction takes 2^this ns.
    pub shift: u8,
    link_bytes_per_second: u32,
    /// The sensor's rates, in events per microsecond.
    rates: &'static [f64],
}

/// Counts of instructions hardly differ between a Cortex-M4 and an M7: one machine stands for both.
pub const MACHINE: Machine = Machine::Mps2An500;

const BOARDS: [Board; 3] = [
    Board {
        name: "500 million instructions a second (a Cortex-M7 of 480 MHz), USB HS of 12.8 MB/s",
        shift: 1,
        link_bytes_per_second: 12_800_000,
        rates: &[1.0, 2.0, 5.0, 10.0],
    },
    Board {
        name: "500 million instructions a second, a link that is never full",
        shift: 1,
        link_bytes_per_second: u32::MAX,
        rates: &[2.0, 5.0, 10.0],
    },
    Board {
        name: "125 million instructions a second (a Cortex-M4 of 168 MHz), USB FS of 1 MB/s",
        shift: 3,
        link_bytes_per_second: 1_000_000,
        rates: &[0.2, 0.5, 1.0, 5.0],
    },
];

/// Plays a scene at every rate; prints the table, and writes it into the document if it is to be saved. Fails if an event is
/// unaccounted for, or if others are lost than the resources predict.
pub fn run(save: bool) -> Result<ExitCode> {
    let image = image::build(MACHINE, "sensor")?;
    let scene = scene(EVENTS)?;
    let costs = Costs::count(&image, &scene)?;
    let mut text = format!(
        "An event takes {:.0} instructions to receive, {:.0} to encode, {:.0} to drop.\n\n\
         | processor, link | events a second | lost | predicted | by |\n|---|---|---|---|---|\n",
        costs.receive, costs.encode, costs.drop
    );
    for board in BOARDS {
        for rate in board.rates {
            let row = board
                .row(&image, &costs, &at_rate(&scene, *rate)?)
                .with_context(|| format!("{}, {rate} Mev/s", board.name))?;
            let _ = writeln!(text, "| {} | {rate} million | {row} |", board.name);
        }
    }
    print!("{text}");
    if save {
        MARKS.write(&tree::path(DOCUMENT), &text)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The first events of a scene.
pub fn scene(count: usize) -> Result<Vec<Event>> {
    let mut emulator = emulate(SceneConfig {
        sensor: SENSOR,
        ..SceneConfig::model_1(Preset::OutdoorWellLitBlur, 1)
    })?;
    let mut events = Vec::new();
    while events.len() < count && emulator.read(&mut events)? > 0 {}
    ensure!(
        events.len() >= count,
        "the scene has {} events",
        events.len()
    );
    events.truncate(count);
    Ok(events)
}

/// The scene in another time, in which so many events come in a microsecond on average.
pub fn at_rate(scene: &[Event], rate: f64) -> Result<Vec<Event>> {
    let (first, last) = scene.first().zip(scene.last()).context("no events")?;
    let slower = scene.len() as f64 / rate / (last.t_us - first.t_us) as f64;
    let time = |event: &Event| ((event.t_us - first.t_us) as f64 * slower) as u64;
    let events = scene.iter().map(|event| Event {
        t_us: time(event),
        ..*event
    });
    Ok(events.collect())
}

impl Board {
    /// A processor and a link that nothing is too quick for.
    pub const QUICK: Self = Self {
        name: "",
        shift: 0,
        link_bytes_per_second: u32::MAX,
        rates: &[],
    };

    pub fn scene<'s>(&self, events: &'s [Event]) -> Scene<'s> {
        let mode = Mode::Hybrid(Hybrid {
            coder: Coder::Fast,
            fidelity: Fidelity::Lossless,
        });
        let window = WindowConfig::new(SENSOR, WINDOW_US);
        Scene {
            events,
            config: Config::new(window, THRESHOLDS, mode),
            link_bytes_per_second: self.link_bytes_per_second,
        }
    }

    /// Plays a scene, of which every event has to be in a frame or to be counted as lost; also those in blocks that were
    /// overwritten before the interrupt had them.
    fn play(&self, image: &Path, scene: &Scene<'_>) -> Result<Seen> {
        let seen = scene.play(MACHINE, image, self.shift, PATIENCE)?;
        seen.outcome.verdict()?;
        Ok(seen)
    }

    /// Plays a scene; returns the shares of its events that are lost and that the resources predict, and what is scarce.
    fn row(&self, image: &Path, costs: &Costs, events: &[Event]) -> Result<String> {
        let scene = self.scene(events);
        let seen = self.play(image, &scene)?;
        let (left, resources) = costs.predict(self, &scene)?;
        let all = events.len() as f64;
        let lost = seen.outcome.events_lost as f64 / all;
        let predicted = 1.0 - left as f64 / all;
        ensure!(
            (lost - predicted).abs() <= TOLERANCE,
            "{lost:.3} of the events are lost, {predicted:.3} were predicted"
        );
        let percent = [lost, predicted].map(|share| format!("{:.1} %", 100.0 * share));
        let scarce = resources.scarce(lost > 0.0);
        Ok(format!("{} | {scarce}", percent.join(" | ")))
    }
}

/// Instructions that an event takes.
struct Costs {
    receive: f64,
    drop: f64,
    encode: f64,
    /// The run without losses.
    kept: Outcome,
}

impl Costs {
    /// Counts what an event takes on a processor and a link that nothing is too quick for, and to drop one where hardly any
    /// finds room.
    fn count(image: &Path, scene: &[Event]) -> Result<Self> {
        let quick = Board::QUICK;
        let kept = quick
            .play(image, &quick.scene(&at_rate(scene, SLOW)?))?
            .outcome;
        ensure!(
            kept.events_lost == 0,
            "{} events are lost",
            kept.events_lost
        );
        let [receive, encode, _] = kept.ns_per_event();
        let stuck = Board {
            link_bytes_per_second: 100_000,
            ..quick
        };
        let stuck = stuck
            .play(image, &stuck.scene(&at_rate(scene, QUICK)?))?
            .outcome;
        let received = f64::from(stuck.status.events);
        let dropped = stuck.events_lost as f64;
        Ok(Self {
            receive,
            drop: (stuck.status.receive_ns as f64 - received * receive) / dropped,
            encode,
            kept,
        })
    }

    /// Returns what the resources leave of a scene's events, and the resources.
    ///
    /// How many bytes an event takes depends on what is left: the prediction is repeated with the frames that the host makes
    /// of that.
    fn predict(&self, board: &Board, scene: &Scene<'_>) -> Result<(usize, Resources)> {
        let blocks = scene.blocks()?;
        let mut left = scene.events.to_vec();
        let mut resources = self.resources(board, scene, &left)?;
        for _ in 0..ROUNDS {
            let mut events = scene.events.iter();
            left.clear();
            for (block, is_dropped) in blocks.iter().zip(resources.dropped(&blocks)) {
                let block = events.by_ref().take(block.events());
                match is_dropped {
                    true => block.for_each(drop),
                    false => left.extend(block),
                }
            }
            resources = self.resources(board, scene, &left)?;
        }
        Ok((left.len(), resources))
    }

    fn resources(&self, board: &Board, scene: &Scene<'_>, events: &[Event]) -> Result<Resources> {
        let left = Scene { events, ..*scene };
        let frames = left.host_frames(&self.kept)?;
        let bytes: usize = frames.iter().map(Vec::len).sum();
        let bytes_per_event = bytes as f64 / events.len() as f64;
        let ns = f64::from(1 << board.shift);
        let status = &self.kept.status;
        Ok(Resources {
            receive_ns: self.receive * ns,
            drop_ns: self.drop * ns,
            encode_ns: self.encode * ns,
            link_ns: bytes_per_event * 1e9 / f64::from(board.link_bytes_per_second),
            window_events: status.window_events as usize,
            frame_events: f64::from(status.frame_bytes) / bytes_per_event,
        })
    }
}
