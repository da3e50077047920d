//! The `eecvs` command.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use eecvs_cli::output::{end, parse};
use eecvs_cli::stop::end_on_signals;
use host_harness::cmd;

/// Encode event-camera recordings into frames of events or transform coefficients; decode and compare them
#[derive(Debug, Parser)]
#[command(name = "eecvs", version, arg_required_else_help = true)]
struct Eecvs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(cmd::demo::Demo),
    Info(cmd::info::Info),
    Emulate(cmd::emulate::Emulate),
    Convert(cmd::convert::Convert),
    Calibrate(cmd::calibrate::Calibrate),
    Monitor(cmd::monitor::Monitor),
    Encode(cmd::encode::Encode),
    Inspect(cmd::inspect::Inspect),
    Decode(cmd::decode::Decode),
    Compare(cmd::compare::Compare),
    Split(cmd::split::Split),
    Verify(cmd::verify::Verify),
    Index(cmd::index::Index),
    View(cmd::view::View),
    Mcu(cmd::mcu::Mcu),
    Bench(cmd::bench::Bench),
    Report(cmd::report::Report),
}

fn main() -> ExitCode {
    if let Err(error) = end_on_signals() {
        return end("eecvs", Err(error));
    }
    // Bad usage ends here, with exit status 2.
    let result = match parse::<Eecvs>().command {
        Command::Demo(command) => command.run(),
        Command::Info(command) => command.run(),
        Command::Emulate(command) => command.run(),
        Command::Convert(command) => command.run(),
        Command::Calibrate(command) => command.run(),
        Command::Monitor(command) => command.run(),
        Command::Encode(command) => command.run(),
        Command::Inspect(command) => command.run(),
        Command::Decode(command) => command.run(),
        Command::Compare(command) => command.run(),
        Command::Split(command) => command.run(),
        Command::Verify(command) => command.run(),
        Command::Index(command) => command.run(),
        Command::View(command) => command.run(),
        Command::Mcu(command) => command.run(),
        Command::Bench(command) => command.run(),
        Command::Report(command) => command.run(),
    };
    end("eecvs", result)
}
