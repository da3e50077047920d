//! Peers that are programs of others, measured where they are installed: zpaq, and HDF5 with Blosc by Python's h5py.

use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use eecvs_bench::source::Source;
use eecvs_nostd::{Event, Polarity};

use super::columns;
use super::lossless::RoundTrip;

/// Writes the columns of its folder to an HDF5 file, or those of the file to its folder, and prints how long that took.
const BLOSC: &str = include_str!("blosc.py");
/// The columns, with the bytes of each value.
const COLUMNS: [(&str, usize); 4] = [("t", 8), ("x", 2), ("y", 2), ("p", 1)];

/// A program of others that stores events, or bytes, without loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// `zpaq -m5` on records of 8 bytes, which it makes smaller than columns.
    Zpaq,
    /// A dataset for each column in HDF5 files, shuffled and compressed by Blosc with Zstandard, as the data set DSEC has
    /// it: by Python's h5py and hdf5plugin. `EECVS_PYTHON` names a Python other than `python3`.
    Blosc,
}

impl Program {
    const ALL: [Self; 2] = [Self::Zpaq, Self::Blosc];

    /// Returns those that are installed, and those that are not. They are looked for once.
    #[must_use]
    pub fn installed() -> &'static (Vec<Self>, Vec<Self>) {
        static INSTALLED: LazyLock<(Vec<Program>, Vec<Program>)> = LazyLock::new(|| {
            Program::ALL
                .into_iter()
                .partition(|program| program.is_there())
        });
        &INSTALLED
    }

    /// Returns the name used in the rows of results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Zpaq => "zpaq-5",
            Self::Blosc => "hdf5-blosc",
        }
    }

    /// Returns what must be installed for it.
    #[must_use]
    pub const fn needs(self) -> &'static str {
        match self {
            Self::Zpaq => "the program zpaq",
            Self::Blosc => "Python's h5py and hdf5plugin",
        }
    }

    fn is_there(self) -> bool {
        let mut command = match self {
            Self::Zpaq => Command::new("zpaq"),
            Self::Blosc => {
                let mut command = Command::new(python());
                // Not from the folder in which the command happens to run.
                let script = "import sys; sys.path.remove(''); import h5py, hdf5plugin, numpy";
                command.args(["-c", script]).env_remove("PYTHONSAFEPATH");
                command
            }
        };
        let silent = command.stdin(Stdio::null()).stdout(Stdio::null());
        let status = silent.stderr(Stdio::null()).status();
        // Without arguments zpaq explains itself, with a status of its own.
        status.is_ok_and(|status| status.success() || self == Self::Zpaq)
    }

    /// Stores and restores a recording.
    ///
    /// # Errors
    /// Fails on I/O errors, if the program fails, or if it gives other bytes back.
    pub fn round_trip(self, source: &Source) -> Result<RoundTrip> {
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        match self {
            Self::Zpaq => zpaq(source, folder.path()),
            Self::Blosc => blosc(source, folder.path()),
        }
    }
}

fn zpaq(source: &Source, folder: &Path) -> Result<RoundTrip> {
    let (plain, archive) = (folder.join("events"), folder.join("events.zpaq"));
    let run = |arguments: &[&str]| run(Command::new("zpaq").args(arguments).current_dir(folder));
    let started = Instant::now();
    write(&plain, &records(&source.events)?)?;
    run(&["add", "events.zpaq", "events", "-m5", "-t1"])?;
    let seconds = started.elapsed().as_secs_f64();
    let bytes = read(&archive)?.len();
    fs::remove_file(&plain).with_context(|| plain.display().to_string())?;
    let started = Instant::now();
    run(&["extract", "events.zpaq", "-t1"])?;
    let events = events_of(&read(&plain)?)?;
    Ok(RoundTrip {
        bytes,
        seconds,
        decode_seconds: started.elapsed().as_secs_f64(),
        events,
    })
}

/// Returns records, little-endian: y (u16), x with the polarity as bit 15 (u16), us since the event before (u32). The
/// first one's time stands before them (u64).
fn records(events: &[Event]) -> Result<Vec<u8>> {
    let first_us = events.first().map_or(0, |event| event.t_us);
    let mut bytes = first_us.to_le_bytes().to_vec();
    for (event, step) in events.iter().zip(columns::steps(events)?) {
        let on = u16::from(event.polarity == Polarity::On) << 15;
        bytes.extend(event.y.to_le_bytes());
        bytes.extend((event.x | on).to_le_bytes());
        bytes.extend(step.to_le_bytes());
    }
    Ok(bytes)
}

/// Returns the events of [`records`].
fn events_of(bytes: &[u8]) -> Result<Vec<Event>> {
    let (first_us, records) = bytes.split_first_chunk().context("no records")?;
    let (records, rest) = records.as_chunks::<8>();
    ensure!(rest.is_empty(), "a record that is not whole");
    let mut t_us = u64::from_le_bytes(*first_us);
    let event = |record: &[u8; 8]| {
        let [y0, y1, x0, x1, step @ ..] = *record;
        let x = u16::from_le_bytes([x0, x1]);
        t_us += u64::from(u32::from_le_bytes(step));
        Event {
            t_us,
            x: x & 0x7FFF,
            y: u16::from_le_bytes([y0, y1]),
            polarity: Polarity::from_bool(x >> 15 == 1),
        }
    };
    Ok(records.iter().map(event).collect())
}

fn blosc(source: &Source, folder: &Path) -> Result<RoundTrip> {
    let values = |event: &Event| {
        [
            event.t_us,
            event.x.into(),
            event.y.into(),
            (event.polarity == Polarity::On).into(),
        ]
    };
    for (k, (name, width)) in COLUMNS.into_iter().enumerate() {
        let events = source.events.iter();
        let bytes = events.flat_map(|event| values(event)[k].to_le_bytes().into_iter().take(width));
        write(&folder.join(name), &bytes.collect::<Vec<u8>>())?;
    }
    let python = |direction: &str| -> Result<f64> {
        let mut command = Command::new(python());
        let said = run(command.args(["-c", BLOSC, direction]).current_dir(folder))?;
        said.trim()
            .parse()
            .with_context(|| format!("Python printed {said:?} in place of the time it took"))
    };
    let seconds = python("write")?;
    let bytes = read(&folder.join("events.h5"))?.len();
    for (name, _) in COLUMNS {
        fs::remove_file(folder.join(name)).context(name)?;
    }
    let decode_seconds = python("read")?;
    let mut columns = Vec::new();
    for (name, width) in COLUMNS {
        let bytes = read(&folder.join(name))?;
        ensure!(
            bytes.len() == width * source.events.len(),
            "{name} is not whole"
        );
        let value = |bytes: &[u8]| {
            let bytes = bytes.iter().rev();
            bytes.fold(0, |value, byte| value << 8 | u64::from(*byte))
        };
        columns.push(bytes.chunks_exact(width).map(value).collect::<Vec<u64>>());
    }
    let event = |i: usize| Event {
        t_us: columns[0][i],
        x: columns[1][i] as u16,
        y: columns[2][i] as u16,
        polarity: Polarity::from_bool(columns[3][i] == 1),
    };
    let events = (0..source.events.len()).map(event).collect();
    Ok(RoundTrip {
        bytes,
        seconds,
        decode_seconds,
        events,
    })
}

fn python() -> OsString {
    std::env::var_os("EECVS_PYTHON").unwrap_or_else(|| "python3".into())
}

/// Runs a program to its end, and returns what it printed.
fn run(command: &mut Command) -> Result<String> {
    let name = command.get_program().display().to_string();
    let output = command.stdin(Stdio::null()).output();
    let output = output.with_context(|| format!("{name}: cannot be run"))?;
    ensure!(
        output.status.success(),
        "{name}: {}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr).trim()
    );
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).with_context(|| path.display().to_string())
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    fs::write(path, bytes).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use event_types::test_events::event;

    use super::*;

    #[test]
    fn records_are_the_events() {
        let events = [
            event(7, 4095, 3, true),
            event(7, 0, 4095, false),
            event(7 + u64::from(u32::MAX), 5, 0, true),
        ];
        for events in [&events[..], &[]] {
            let bytes = records(events).unwrap();
            assert_eq!(bytes.len(), 8 + 8 * events.len());
            assert_eq!(events_of(&bytes).unwrap(), events);
        }
        assert!(records(&[events[2], events[0]]).is_err());
        let bytes = records(&events).unwrap();
        assert!(events_of(&bytes[..7]).is_err());
        assert!(events_of(&bytes[..bytes.len() - 1]).is_err());
    }
}
