//! The `eecvs-hub` command: its command line, and the choice of subcommand.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use eecvs_cli::output::{end, parse};
use eecvs_cli::variable::have_zenoh_threads;
use usb_bridge::stop::Stop;

use crate::cmd::{hub, keys, receive, sensor, simulate};

/// Send frames from many sensors to many machines, over Zenoh: sensors send to hubs, and receivers take frames from
/// them
#[derive(Debug, Parser)]
#[command(name = "eecvs-hub", version, arg_required_else_help = true)]
struct EecvsHub {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Hub(hub::Hub),
    Sensor(Box<sensor::Sensor>),
    Receive(receive::Receive),
    Keys(keys::Keys),
    Simulate(simulate::Simulate),
}

/// Runs the command. A program must call this before it does anything else, since the process may replace itself in
/// order to set an environment variable.
#[must_use]
pub fn run() -> ExitCode {
    have_zenoh_threads();
    let line = parse::<EecvsHub>();
    let stop = match Stop::on_signals() {
        Ok(stop) => stop,
        Err(error) => return end("eecvs-hub", Err(error)),
    };
    let result = match line.command {
        Command::Hub(hub) => hub.run(&stop),
        Command::Sensor(sensor) => sensor.run(&stop),
        Command::Receive(receive) => receive.run(&stop),
        Command::Keys(keys) => keys.run(),
        Command::Simulate(simulate) => simulate.run(&stop),
    };
    end("eecvs-hub", result)
}
