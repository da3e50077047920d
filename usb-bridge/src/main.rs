//! The command-line program `eecvs-usb`.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use eecvs_cli::output::{end, parse};
use usb_bridge::cmd;

/// Event cameras and the encoder's microcontroller on USB: capture, forward, simulate
#[derive(Debug, Parser)]
#[command(name = "eecvs-usb", version, arg_required_else_help = true)]
struct EecvsUsb {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    List(cmd::list::List),
    Capture(cmd::capture::Capture),
    Forward(cmd::forward::Forward),
    Receive(cmd::receive::Receive),
    Mcu(cmd::mcu::Mcu),
    Simulate(cmd::simulate::Simulate),
}

fn main() -> ExitCode {
    // Wrong usage ends the process here, with exit status 2.
    let result = match parse::<EecvsUsb>().command {
        Command::List(command) => command.run(),
        Command::Capture(command) => command.run(),
        Command::Forward(command) => command.run(),
        Command::Receive(command) => command.run(),
        Command::Mcu(command) => command.run(),
        Command::Simulate(command) => command.run(),
    };
    end("eecvs-usb", result)
}
