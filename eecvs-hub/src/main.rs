//! The `eecvs-hub` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    eecvs_hub::run()
}
