//! The guest's side of cameras: runs `eecvs-usb capture` and checks the file that it leaves.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, bail, ensure};
use eecvs_nostd::Event;
use serde_json::{Map, Value};
use usb_bridge::link::usb::{Attached, Bus};

use super::APPEARS;
use super::digest::Digest;
use super::recordings::keeps_order;

/// Path of the program under test, where `boot.sh` puts it.
const PROGRAM: &str = "/eecvs-usb";
/// Number of captures that run at a time.
const AT_ONCE: usize = 3;
/// Time after which a capture without its last event ends, in seconds.
const ENOUGH_S: &str = "120";

/// Builds a call of the program under test.
pub fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(PROGRAM);
    command.args(arguments);
    command
}

/// Returns the program's JSON output if it succeeded.
pub fn said(output: &Output) -> Result<Value> {
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}: {errors}", output.status);
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Passes the events of a file to `take`, batch by batch.
pub fn read(path: &Path, take: &mut dyn FnMut(&[Event])) -> Result<()> {
    let mut reader = event_files::open(path, None)?;
    let mut events = Vec::new();
    while reader.read(&mut events)? > 0 {
        take(&events);
        events.clear();
    }
    Ok(())
}

/// Captures from each camera of `PORT MODEL NAME DIGEST` what it sends. Several captures run at a time, because
/// they wait most of the time.
pub fn all(wanted: &[&str]) -> Result<()> {
    let wanted = Mutex::new(wanted.chunks(4));
    let work = || -> Result<()> {
        loop {
            let next = wanted.lock().unwrap_or_else(PoisonError::into_inner).next();
            match next {
                Some(&[port, model, name, digest]) => {
                    let port = port.parse().context("PORT")?;
                    let sent = digest.parse().context("DIGEST")?;
                    let told =
                        attached(port).and_then(|camera| capture(&camera.id(), model, &sent));
                    println!(
                        "ok: {model}, {name}: {}",
                        told.with_context(|| format!("{model}, {name}"))?
                    );
                }
                Some(other) => bail!("{other:?}: expected PORT MODEL NAME DIGEST"),
                None => return Ok(()),
            }
        }
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..AT_ONCE).map(|_| scope.spawn(work)).collect();
        let ends = workers
            .into_iter()
            .map(|one| one.join().expect("a capture's thread"));
        ends.fold(Ok(()), Result::and)
    })
}

/// Captures from the camera at a port and compares its events with `sent`.
pub fn capture(id: &str, model: &str, sent: &Digest) -> Result<String> {
    let started = Instant::now();
    let path = PathBuf::from(format!("/tmp/{id}.aedat4"));
    let mut command = program(&["capture", "--json", "--duration-s", ENOUGH_S]);
    command.args(["--device", id, "--events", &sent.events.to_string()]);
    let said = said(&command.arg("-o").arg(&path).output().context(PROGRAM)?)?;
    let mut found = Digest::default();
    read(&path, &mut |events| found.take(events))?;
    std::fs::remove_file(&path)?;
    let lost = &said["losses"];
    ensure!(lost.as_object().is_some_and(Map::is_empty), "lost: {lost}");
    found.require(sent, keeps_order(model))?;
    let order = if keeps_order(model) {
        "in order"
    } else {
        "by time"
    };
    Ok(format!(
        "{} events, {order}, {} bytes, {:.1} s of streaming, {:.1} s in all",
        found.events,
        said["bytes"],
        said["seconds"].as_f64().unwrap_or(f64::NAN),
        started.elapsed().as_secs_f64()
    ))
}

/// Waits for the device at a port and returns it.
fn attached(port: u8) -> Result<Attached> {
    let until = Instant::now() + APPEARS;
    loop {
        let devices = Bus::new()?.devices()?;
        if let Some(found) = devices.into_iter().find(|one| one.ports == [port]) {
            return Ok(found);
        }
        ensure!(Instant::now() < until, "no device appears at port {port}");
        thread::sleep(Duration::from_millis(100));
    }
}
