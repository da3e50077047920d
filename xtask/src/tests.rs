//! Tests, with the features of `./test.sh`, so that nothing is built a second time.

use std::process::ExitCode;

use anyhow::Result;

use crate::tree;

/// Every test but those of documentation. With fewer, `--test NAME` say, the dependencies have other features, and are
/// built again.
const ALL: [&str; 4] = ["--workspace", "--features", "host-harness/onnx", "--tests"];

/// Every test of the workspace whose name contains one of the filters.
pub fn run(filters: &[String]) -> Result<ExitCode> {
    let mut test = tree::cargo();
    test.args(["test", "--quiet"]).args(ALL);
    tree::status(test.arg("--").args(filters))
}

/// The campaign over every place at which an output can fail, of all commands or of those whose line has this word.
pub fn faults(word: Option<&str>) -> Result<ExitCode> {
    // Commands that run an image build it first, which may take longer than the campaign waits for one of them.
    tree::run(&mut tree::command("firmware/build.sh"))?;
    let mut test = tree::cargo();
    test.args(["test", "--quiet"]).args(ALL);
    let filter = ["--", "every_output_is_old_or_whole", "--nocapture"];
    tree::status(
        test.args(filter)
            .env("EECVS_FAULTS_ALL", word.unwrap_or("1")),
    )
}

/// The golden vectors, written again.
pub fn bless() -> Result<ExitCode> {
    let mut test = tree::cargo();
    test.args(["test", "--quiet"]).args(ALL);
    tree::status(test.arg("golden::").env("EECVS_BLESS", "1"))
}
