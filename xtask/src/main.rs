//! What people do with this project, one command each: `cargo xtask` lists them.

mod cores;
mod flips;
mod fuzz;
mod host_instructions;
mod image_recordings;
mod instructions;
mod kernels;
mod pipelines;
mod read_speed;
mod record;
mod saved;
mod seek;
mod sensor;
mod stream;
mod tests;
mod tree;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};

use saved::Action;

#[derive(Debug, Parser)]
#[command(
    name = "cargo xtask",
    bin_name = "cargo xtask",
    version,
    about = "Tasks of this project"
)]
struct Arguments {
    #[command(subcommand)]
    task: Option<Task>,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Run every check, or the stages named: ./test.sh
    Check {
        /// Stages, as the head of test.sh lists them
        stages: Vec<String>,
    },
    /// Run the tests whose names contain one of the filters, with the features of ./test.sh
    Test {
        /// Parts of test names, such as `text::` or `golden`
        #[arg(required = true)]
        filters: Vec<String>,
    },
    /// Write the golden vectors again: review the diff
    Bless,
    /// Measure the records of tables again, and write the tables into the documents
    Record {
        /// Parts to measure; all unless some are named
        #[arg(value_enum)]
        parts: Vec<record::Part>,
    },
    /// Count the instructions of every stage on a Cortex-M4 in QEMU
    Instructions {
        #[command(flatten)]
        action: Action,
    },
    /// Count the instructions of every kernel on a Cortex-M4 and a Cortex-M7 in QEMU
    Kernels {
        #[command(flatten)]
        action: Action,
    },
    /// Count the instructions of the host's encoder, decoder and readers in Valgrind
    HostInstructions {
        #[command(flatten)]
        action: Action,
    },
    /// Run the cases that `host-instructions` counts
    #[command(hide = true)]
    HostCases {
        /// Folder of the inputs
        folder: PathBuf,
    },
    /// Compare the encoder's images with the host's encoder, on a scene and recordings, in every mode
    ImageRecordings {
        /// Take only this many events from the start of each recording; all of them take 20 minutes
        #[arg(long)]
        events: Option<u64>,
        /// The eecvs command to use [default: it is built]
        #[arg(long)]
        eecvs: Option<PathBuf>,
    },
    /// Run the encoder's image on every core that QEMU emulates, and compare its frames with the host's
    Cores {
        /// Write the table of instructions into docs/boards.md
        #[arg(long)]
        save: bool,
        /// The eecvs command to use [default: it is built]
        #[arg(long)]
        eecvs: Option<PathBuf>,
    },
    /// Play a simulated sensor to the encoder on a microcontroller, at rising rates: what is lost, and is it counted?
    Sensor {
        /// Write the table into docs/boards.md
        #[arg(long)]
        save: bool,
    },
    /// Flip bits of a microcontroller's memory and registers, stop its peripherals: what becomes of the events?
    Flips {
        /// Number of faults, each in a run of its own: four a second on two cores
        #[arg(default_value_t = flips::FAULTS)]
        count: u64,
        /// Go on with the record, firmware/flips.json, and write the table into docs/boards.md
        #[arg(long)]
        save: bool,
    },
    /// Measure how fast recordings are read, here and by other libraries
    ReadSpeed {
        /// Also write the rows as a record
        #[arg(long)]
        record: Option<PathBuf>,
        /// Number of rounds, of which the best counts
        #[arg(long, default_value_t = 5)]
        rounds: u32,
    },
    /// Measure how fast recordings are converted, here and by other libraries
    Pipelines {
        /// Also write the rows as a record
        #[arg(long)]
        record: Option<PathBuf>,
        /// Number of rounds, of which the best counts
        #[arg(long, default_value_t = 3)]
        rounds: u32,
    },
    /// Take long streams of events through each coder and back: do rate and memory stay, is every event the same?
    Stream {
        /// Number of events; the quicker coders take five times as many
        #[arg(default_value_t = stream::EVENTS, value_parser = clap::value_parser!(u64).range(1..))]
        events: u64,
    },
    /// Read single milliseconds of a long file of each coder: how many bytes and how much time does it take?
    Seek {
        /// Number of events; the slower coder takes a tenth of them
        #[arg(default_value_t = seek::EVENTS, value_parser = clap::value_parser!(u64).range(1..))]
        events: u64,
    },
    /// Run fuzz targets, and fail on a crash
    Fuzz {
        /// Seconds for each target
        #[arg(default_value_t = 5)]
        seconds: u32,
        /// Targets; all unless some are named. Those of readers are read_FORMAT
        targets: Vec<String>,
        /// Only list the targets
        #[arg(long)]
        list: bool,
    },
    /// Let every call by which a command writes a file fail, one at a time; kill every command at every such call and at
    /// random moments
    Faults {
        /// Only commands whose line has this word
        word: Option<String>,
    },
    /// Build the images of a microcontroller: firmware/build.sh
    BuildImage {
        /// Machine, program, `portable`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Put sensors, a hub and receivers under load: eecvs-hub/load.sh
    HubLoad {
        /// Arguments of the script
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Kill a hub again and again under load: eecvs-hub/kills.sh
    HubKills {
        /// Seconds
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Measure the delay of frames on ROS 2: eecvs-ros/delay.sh
    RosDelay {
        /// Arguments of the script
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Watch the memory of ROS nodes beside a subscriber that hangs: eecvs-ros/stopped.sh
    RosStopped {
        /// Transport, seconds
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Offer every shared recording, as every camera, to a kernel's USB: usb-bridge/guest/recordings.sh
    UsbRecordings {
        /// MODEL or MODEL:RECORDING
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
}

fn main() -> Result<ExitCode> {
    let Some(task) = Arguments::parse().task else {
        Arguments::command().print_help()?;
        return Ok(ExitCode::SUCCESS);
    };
    match task {
        Task::Check { stages } => tree::script("test.sh", &stages),
        Task::Test { filters } => tests::run(&filters),
        Task::Bless => tests::bless(),
        Task::Record { parts } => record::run(&parts),
        Task::Instructions { action } => instructions::run(action),
        Task::Kernels { action } => kernels::run(action),
        Task::HostInstructions { action } => host_instructions::run(action),
        Task::HostCases { folder } => host_instructions::run_cases(&folder),
        Task::ImageRecordings { events, eecvs } => image_recordings::run(events, eecvs),
        Task::Cores { save, eecvs } => cores::run(save, eecvs),
        Task::Sensor { save } => sensor::run(save),
        Task::Flips { count, save } => flips::run(count, save),
        Task::Pipelines { record, rounds } => pipelines::run(record.as_deref(), rounds),
        Task::ReadSpeed { record, rounds } => read_speed::run(record.as_deref(), rounds),
        Task::Stream { events } => stream::run(events, None),
        Task::Seek { events } => seek::run(events, None),
        Task::Fuzz { list: true, .. } => fuzz::list(),
        Task::Fuzz {
            seconds, targets, ..
        } => fuzz::run(seconds, &targets),
        Task::Faults { word } => tests::faults(word.as_deref()),
        Task::BuildImage { arguments } => tree::script("firmware/build.sh", &arguments),
        Task::HubLoad { arguments } => tree::script("eecvs-hub/load.sh", &arguments),
        Task::HubKills { arguments } => tree::script("eecvs-hub/kills.sh", &arguments),
        Task::RosDelay { arguments } => tree::script("eecvs-ros/delay.sh", &arguments),
        Task::RosStopped { arguments } => tree::script("eecvs-ros/stopped.sh", &arguments),
        Task::UsbRecordings { arguments } => {
            tree::script("usb-bridge/guest/recordings.sh", &arguments)
        }
    }
}
