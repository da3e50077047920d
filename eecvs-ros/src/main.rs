//! The `eecvs-ros` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    eecvs_ros::run(Vec::new())
}
