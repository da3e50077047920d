//! Runs the `eecvs` binary in a temporary folder and looks at what it leaves.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use eecvs::frame_file::FrameReader;
use eecvs_nostd::{Event, Polarity, Sensor};
use serde_json::Value;

/// Commands that write files.
const WRITING: [&str; 11] = [
    "bench",
    "calibrate",
    "convert",
    "decode",
    "demo",
    "emulate",
    "encode",
    "mcu",
    "monitor",
    "split",
    "view",
];

/// A folder in which commands run; gone with the test.
pub struct Folder(tempfile::TempDir);

/// What a command left.
pub struct Outcome {
    pub status: Option<i32>,
    pub stdout: String,
    pub stderr: String,
    /// The command line, for messages.
    pub line: String,
}

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), bytes).expect("a file that can be written");
    }

    /// The program, to be run in this folder.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs"));
        command
            .args(arguments)
            .current_dir(self.0.path())
            .stdin(Stdio::null());
        command
    }

    /// Runs `eecvs` with arguments split at spaces; what writes a file may replace one, since many tests
    /// write under one name again and again.
    pub fn eecvs(&self, line: &str) -> Outcome {
        let command = line.split_whitespace().next().unwrap_or_default();
        match WRITING.contains(&command) && !line.contains(" --overwrite") {
            true => self.as_is(&format!("{line} --overwrite")),
            false => self.as_is(line),
        }
    }

    /// Runs `eecvs` with no other arguments than these, split at spaces.
    pub fn as_is(&self, line: &str) -> Outcome {
        let arguments: Vec<&str> = line.split_whitespace().collect();
        let output = self
            .command(&arguments)
            .output()
            .expect("the program starts");
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        let outcome = Outcome {
            status: output.status.code(),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
            line: line.to_owned(),
        };
        assert!(!outcome.stderr.contains("panicked"), "{outcome}");
        outcome
    }

    /// Emulates a scene of three regimes' worth of activity into `name`.
    pub fn scene(&self, name: &str) {
        self.eecvs(&format!(
            "emulate motorcycle -o {name} --model 1 --width 40 --height 30 --duration-us 200000 --start-us 7000"
        ))
        .ok();
    }

    /// Events and sensor of a recording.
    pub fn events(&self, name: &str) -> (Sensor, Vec<Event>) {
        let mut reader = event_files::open(&self.path(name), None).expect("a recording");
        let mut events = Vec::new();
        while reader.read(&mut events).expect("a whole recording") > 0 {}
        (reader.sensor(), events)
    }

    /// (y, x, polarity) of every event of a recording, sorted: what decoding keeps exactly.
    pub fn pixels(&self, name: &str) -> Vec<(u16, u16, Polarity)> {
        let events = self.events(name).1;
        let mut pixels: Vec<_> = events.iter().map(|e| (e.y, e.x, e.polarity)).collect();
        pixels.sort_unstable();
        pixels
    }

    /// Shape and values of a float32 `.npy` file.
    pub fn npy(&self, name: &str) -> ([usize; 3], Vec<f32>) {
        let bytes = self.bytes(name);
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        let header = std::str::from_utf8(&bytes[10..data]).expect("an ASCII header");
        for part in ["'descr': '<f4'", "'fortran_order': False"] {
            assert!(header.contains(part), "{header}");
        }
        let shape = header.split(['(', ')']).nth(1).expect("a shape");
        let shape: Vec<usize> = shape
            .split(',')
            .map(|side| side.trim().parse().expect("a number"))
            .collect();
        let values: Vec<f32> = bytes[data..]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        assert_eq!(bytes.len() - data, 4 * shape.iter().product::<usize>());
        (shape.try_into().expect("three dimensions"), values)
    }

    /// The frames of a file, cut apart by what `inspect` says of their sizes.
    pub fn frames(&self, name: &str) -> Vec<Vec<u8>> {
        self.places(name).1
    }

    /// Where the frames of a file begin, and the frames.
    pub fn places(&self, name: &str) -> (Vec<usize>, Vec<Vec<u8>>) {
        let bytes = self.bytes(name);
        let mut reader = FrameReader::new(&bytes[..]);
        let (mut places, mut frames) = (Vec::new(), Vec::new());
        while let Some(located) = reader.next_frame().expect("memory") {
            places.push(located.offset as usize);
            frames.push(located.bytes.to_vec());
        }
        assert!(reader.report().is_clean(), "{:?}", reader.report());
        (places, frames)
    }
}

impl Outcome {
    /// Status 0 and nothing on stderr.
    #[track_caller]
    pub fn ok(self) -> Self {
        assert_eq!(self.status, Some(0), "{self}");
        assert!(self.stderr.is_empty(), "{self}");
        self
    }

    /// Status 0 and one line on stderr that holds every part.
    #[track_caller]
    pub fn warns(self, parts: &[&str]) -> Self {
        assert_eq!(self.status, Some(0), "{self}");
        self.said(parts);
        self
    }

    /// Status 1, one line on stderr that holds every part, and on stdout what was done nevertheless, which is
    /// looked at as if the status were 0.
    #[track_caller]
    pub fn loses(self, parts: &[&str]) -> Self {
        assert_eq!(self.status, Some(1), "{self}");
        assert!(!self.stdout.is_empty(), "{self}");
        self.said(parts);
        Self {
            status: Some(0),
            ..self
        }
    }

    /// Status 1, nothing on stdout, one line on stderr that holds every part.
    #[track_caller]
    pub fn fails(self, parts: &[&str]) {
        assert_eq!(self.status, Some(1), "{self}");
        assert!(self.stdout.is_empty(), "{self}");
        self.said(parts);
    }

    /// Asserts that the flags together are wrong, as one line on stderr says.
    #[track_caller]
    pub fn misused(self, parts: &[&str]) {
        assert_eq!(self.status, Some(2), "{self}");
        assert!(self.stdout.is_empty(), "{self}");
        self.said(parts);
    }

    #[track_caller]
    fn said(&self, parts: &[&str]) {
        assert!(self.stderr.starts_with("eecvs: "), "{self}");
        assert_eq!(self.stderr.lines().count(), 1, "one line: {self}");
        for part in parts {
            assert!(self.stderr.contains(part), "{part}: {self}");
        }
    }

    /// The one JSON object on stdout.
    #[track_caller]
    pub fn object(&self) -> Value {
        assert_eq!(self.status, Some(0), "{self}");
        let value: Value = serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("not one JSON value ({error}): {self}"));
        assert!(value.is_object(), "{self}");
        value
    }

    /// The one JSON array on stdout.
    #[track_caller]
    pub fn array(&self) -> Vec<Value> {
        assert_eq!(self.status, Some(0), "{self}");
        serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("not one JSON array ({error}): {self}"))
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "`eecvs {}`: status {:?}\nstdout: {:.600}\nstderr: {:.600}",
            self.line, self.status, self.stdout, self.stderr
        )
    }
}

/// A key's value as an unsigned integer.
#[track_caller]
pub fn count(object: &Value, key: &str) -> u64 {
    object[key]
        .as_u64()
        .unwrap_or_else(|| panic!("{key} is no count: {object}"))
}

/// A key's value as a number.
#[track_caller]
pub fn number(object: &Value, key: &str) -> f64 {
    object[key]
        .as_f64()
        .unwrap_or_else(|| panic!("{key} is no number: {object}"))
}

/// A key's value as text.
#[track_caller]
pub fn text<'v>(object: &'v Value, key: &str) -> &'v str {
    object[key]
        .as_str()
        .unwrap_or_else(|| panic!("{key} is no text: {object}"))
}

/// Events of an `.eecvs` row or summary summed over rows.
pub fn total(rows: &[Value], key: &str) -> u64 {
    rows.iter().map(|row| count(row, key)).sum()
}

/// Whether a file is there.
pub fn exists(path: &Path) -> bool {
    path.try_exists().expect("a folder that can be read")
}
