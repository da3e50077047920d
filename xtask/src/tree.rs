//! The project's folder, and programs that run there.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, Result, bail};

/// The project's folder.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A path from the project's folder on.
pub fn path(name: impl AsRef<Path>) -> PathBuf {
    root().join(name)
}

/// The folder of shared recordings, which may be absent.
pub fn shared_data() -> PathBuf {
    path("../shared/data")
}

/// The folder of what cargo builds.
pub fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| path("target"), PathBuf::from)
}

/// A program, to be run in the project's folder.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// The cargo that runs this.
pub fn cargo() -> Command {
    let mut cargo = command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // Of this package: build scripts that watch them would run again, and all that depends on them.
    for (name, _) in std::env::vars_os() {
        let of_package = [
            "CARGO_PKG_",
            "CARGO_MANIFEST_",
            "CARGO_BIN_",
            "CARGO_CRATE_",
        ];
        let name = name.to_string_lossy();
        if of_package.iter().any(|begin| name.starts_with(begin)) {
            cargo.env_remove(&*name);
        }
    }
    cargo
}

/// Runs a command to its end.
///
/// # Errors
/// It cannot be run, or its exit status is not 0.
pub fn run(command: &mut Command) -> Result<()> {
    let name = format!("{command:?}");
    let status = command
        .status()
        .with_context(|| format!("{name}: cannot be run"))?;
    if !status.success() {
        bail!("{name}: {status}");
    }
    Ok(())
}

/// Runs a script of the project, and returns its exit status.
///
/// # Errors
/// It cannot be run.
pub fn script(name: &str, arguments: &[String]) -> Result<ExitCode> {
    status(command(path(name)).args(arguments))
}

/// Runs a command, and returns its exit status.
///
/// # Errors
/// It cannot be run, or a signal ended it.
pub fn status(command: &mut Command) -> Result<ExitCode> {
    let name = format!("{command:?}");
    let status = command
        .status()
        .with_context(|| format!("{name}: cannot be run"))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    code.map(ExitCode::from)
        .with_context(|| format!("{name}: {status}"))
}

/// Builds the command `eecvs`, and returns its path.
///
/// # Errors
/// It cannot be built.
pub fn eecvs(features: &[&str]) -> Result<PathBuf> {
    let mut build = cargo();
    build.args(["build", "--release", "--quiet"]);
    for feature in features {
        build.args(["--features", feature]);
    }
    run(&mut build)?;
    Ok(target().join("release/eecvs"))
}
