//! The encoder's images against the host's encoder, frame by frame, on an emulated scene and on recordings, in every
//! mode that they have.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::{fs, thread};

use anyhow::{Context, Result};
use mcu_link::image;
use mcu_link::qemu::Machine;

use crate::tree;

/// Recordings, from the folder of shared ones.
const RECORDINGS: [&str; 3] = [
    "davis346_building_dense/davis.aedat4",
    "dvs128_walking_moderate/alex_walking_for_10secs.aedat",
    "gen3_vga_dense_evt2/evt2.raw",
];

/// Of a sensor that scans, which concerns the dense coder alone.
const SCANS: &str = "dvxl_person_moderate/data_sample.aedat4";

/// Pixels that the dense coder leaves out.
const HOT: &str = "64,48\n65,48\n90,60\n";

/// How many images run at once.
const AT_ONCE: usize = 2;

/// The events; the same by the dense coder without some pixels; the same filtered and under a budget that does not take
/// them all; the regime's transform; each transform at both M.
const MODES: [(&str, &[&str]); 10] = [
    (FAST, &["--mode", "hybrid", "--coder", "fast"]),
    (
        DENSE,
        &[
            "--mode",
            "hybrid",
            "--coder",
            "dense",
            "--hot-pixels",
            "hot.txt",
        ],
    ),
    (
        BUDGET,
        &[
            "--mode",
            "hybrid",
            "--isolated",
            "--bytes-per-second",
            "60000",
        ],
    ),
    ("auto", &["--mode", "transform", "--transform", "auto"]),
    (
        "dct 8",
        &["--mode", "transform", "--transform", "dct", "-m", "8"],
    ),
    (
        "dct 16",
        &["--mode", "transform", "--transform", "dct", "-m", "16"],
    ),
    (
        "dtft 8",
        &["--mode", "transform", "--transform", "dtft", "-m", "8"],
    ),
    (
        "dtft 16",
        &["--mode", "transform", "--transform", "dtft", "-m", "16"],
    ),
    (
        "dwt 8",
        &["--mode", "transform", "--transform", "dwt", "-m", "8"],
    ),
    (
        "dwt 16",
        &["--mode", "transform", "--transform", "dwt", "-m", "16"],
    ),
];
const DENSE: &str = "dense";

/// Those of them that the small image has.
const OF_SMALL: [&str; 2] = [FAST, BUDGET];
const FAST: &str = "fast";
const BUDGET: &str = "budget";

/// An input in a mode on a machine.
struct Job<'a> {
    name: String,
    machine: Machine,
    image: &'a Path,
    recording: Option<&'a Path>,
    mode: &'a [&'a str],
}

/// Runs every input in every mode, of each recording its first `events` events, by a command `eecvs`, which is built
/// unless it is given.
pub fn run(events: Option<u64>, eecvs: Option<PathBuf>) -> Result<ExitCode> {
    let data = tree::shared_data();
    let mut recordings: Vec<PathBuf> = Vec::new();
    for name in RECORDINGS.into_iter().chain([SCANS]) {
        let recording = data.join(name);
        if recording.exists() {
            recordings.push(recording);
        } else {
            println!("skipped: there is no {}", recording.display());
        }
    }
    let inputs = [None]
        .into_iter()
        .chain(recordings.iter().map(|recording| Some(recording.as_path())));
    let images = [Machine::NetduinoPlus2, Machine::Small]
        .map(|machine| Ok((machine, image::build(machine, "encoder")?)))
        .into_iter()
        .collect::<Result<Vec<_>>>()?;
    let mut jobs = Vec::new();
    for recording in inputs {
        for ((name, mode), (machine, image)) in MODES
            .into_iter()
            .flat_map(|mode| images.iter().map(move |image| (mode, image)))
        {
            let (machine, image) = (*machine, image.as_path());
            if machine == Machine::Small && !OF_SMALL.contains(&name) {
                continue;
            }
            if recording.is_some_and(|recording| recording.ends_with(SCANS)) && name != DENSE {
                continue;
            }
            let folder = recording.and_then(Path::parent).and_then(Path::file_name);
            let input = folder.map_or("scene".into(), |folder| folder.to_string_lossy());
            let name = match machine {
                Machine::Small => format!("{input} {name}, small"),
                _ => format!("{input} {name}"),
            };
            jobs.push(Job {
                name,
                machine,
                image,
                recording,
                mode,
            });
        }
    }
    let eecvs = match eecvs {
        Some(eecvs) => eecvs
            .canonicalize()
            .with_context(|| eecvs.display().to_string())?,
        None => tree::eecvs(&[])?,
    };
    let folder =
        tempfile::tempdir().context("cannot create a folder for the list of hot pixels")?;
    fs::write(folder.path().join("hot.txt"), HOT).context("hot.txt")?;
    let (next, has_failed, line) = (AtomicUsize::new(0), AtomicBool::new(false), Mutex::new(()));
    thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let result = compare(job, &eecvs, folder.path(), events);
                    let _line = line.lock();
                    match result {
                        Ok(json) => println!("{:32} {json}", job.name),
                        Err(error) => {
                            has_failed.store(true, Ordering::Relaxed);
                            println!("FAILED {}: {error:#}", job.name);
                        }
                    }
                }
            });
        }
    });
    Ok(if has_failed.into_inner() {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

/// What `eecvs mcu --json` prints.
fn compare(job: &Job<'_>, eecvs: &Path, folder: &Path, events: Option<u64>) -> Result<String> {
    let mut command = tree::command(eecvs);
    command.current_dir(folder).arg("mcu").args(job.mode);
    if let Some(recording) = job.recording {
        command.arg(recording);
        if let Some(events) = events {
            command.args(["--events", &events.to_string()]);
        }
    }
    command.args(["--machine", job.machine.name()]);
    let output = command
        .arg("--image")
        .arg(job.image)
        .arg("--json")
        .output()?;
    let said = String::from_utf8_lossy(&output.stdout);
    let json: String = said.split_whitespace().collect();
    anyhow::ensure!(
        output.status.success(),
        "{}: {}{json}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(json)
}
