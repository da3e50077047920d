//! An emulated microcontroller: QEMU, its UART and its log.

use std::io::{ErrorKind, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use tempfile::TempDir;

use super::log::{LogDecoder, LogLines};

const PROGRAM: &str = "qemu-system-arm";
/// The UART's socket, in a folder of its own.
const SOCKET: &str = "uart";
/// How long QEMU may take until the socket is there.
const START: Duration = Duration::from_secs(20);
/// Bytes kept of what QEMU itself says.
const MESSAGE_BYTES: u64 = 1 << 12;

/// A machine that QEMU emulates and that there are images for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Machine {
    /// An STM32F405: Cortex-M4F, 168 MHz.
    NetduinoPlus2,
    /// The MPS2+ board with a Cortex-M4.
    Mps2An386,
    /// The MPS2+ board with a Cortex-M7.
    Mps2An500,
}

impl Machine {
    /// Every machine.
    pub const ALL: [Self; 3] = [Self::NetduinoPlus2, Self::Mps2An386, Self::Mps2An500];

    /// The machine of a name, `None` where there is none.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|machine| machine.name() == name)
    }

    /// One line about it.
    #[must_use]
    pub const fn about(self) -> &'static str {
        match self {
            Self::NetduinoPlus2 => "STM32F405, Cortex-M4F, 168 MHz",
            Self::Mps2An386 => "MPS2+ board with a Cortex-M4",
            Self::Mps2An500 => "MPS2+ board with a Cortex-M7",
        }
    }

    /// Its name, here and in QEMU.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NetduinoPlus2 => "netduinoplus2",
            Self::Mps2An386 => "mps2-an386",
            Self::Mps2An500 => "mps2-an500",
        }
    }
}

/// What was started, or how to get it.
fn installed<T>(started: std::io::Result<T>) -> Result<T> {
    match started {
        Err(error) if error.kind() == ErrorKind::NotFound => bail!(
            "{PROGRAM} is not installed: get it with `apt-get install qemu-system-arm` (Debian, \
             Ubuntu), `dnf install qemu-system-arm` (Fedora) or `brew install qemu` (macOS)"
        ),
        other => other.with_context(|| format!("starting {PROGRAM}")),
    }
}

/// Whether QEMU is there.
///
/// # Errors
/// It is not.
pub fn find() -> Result<()> {
    let version = Command::new(PROGRAM).arg("--version").output();
    installed(version).map(|_| ())
}

/// Runs an image, which may read the files of `folder`, to its end and returns what it printed. One
/// instruction takes 1 ns of the machine's time; nothing is at its UART.
///
/// # Errors
/// QEMU is not installed, the image fails or takes longer than `patience`.
pub fn run(machine: Machine, image: &Path, folder: &Path, patience: Duration) -> Result<String> {
    let name = image.display();
    let image = image
        .canonicalize()
        .with_context(|| format!("{name}: no such image"))?;
    let started = Command::new(PROGRAM)
        .args(["-M", machine.name()])
        .args(["-display", "none", "-monitor", "none", "-serial", "null"])
        .args(["-icount", "shift=0"])
        .args(["-semihosting-config", "enable=on,target=native"])
        .arg("-kernel")
        .arg(&image)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let mut child = installed(started)?;
    let readers = [
        child.stdout.take().map(|stream| follow(Box::new(stream))),
        child.stderr.take().map(|stream| follow(Box::new(stream))),
    ];
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().context(PROGRAM)? {
            break Some(status);
        }
        if started.elapsed() > patience {
            // Fails only where it has ended already.
            let _ = child.kill();
            let _ = child.wait();
            break None;
        }
        thread::sleep(Duration::from_millis(10));
    };
    let [stdout, stderr] = readers.map(|reader| {
        reader
            .and_then(|reader| reader.join().ok())
            .unwrap_or_default()
    });
    match status {
        Some(status) if status.success() => Ok(stdout),
        Some(status) => {
            let said = [&stderr, &stdout].map(|text| text.lines().last().unwrap_or_default());
            bail!("{name}: the image failed ({status}): {}", said.join(" "))
        }
        None => bail!("{name}: the image has not ended after {patience:?}"),
    }
}

/// Reads a stream to its end, in a thread of its own.
fn follow(mut stream: Box<dyn Read + Send>) -> JoinHandle<String> {
    thread::spawn(move || {
        let mut text = Vec::new();
        // Whatever could be read is what there is to tell.
        let _ = stream.read_to_end(&mut text);
        String::from_utf8_lossy(&text).into_owned()
    })
}

/// A running emulator; killed when dropped.
pub struct Qemu {
    child: Child,
    folder: TempDir,
    lines: LogLines,
    /// The readers of its stdout and stderr; the second returns what it read.
    log: Option<JoinHandle<()>>,
    messages: Option<JoinHandle<String>>,
}

impl Qemu {
    /// Starts an image. One instruction takes 1 ns of the machine's time.
    ///
    /// Prints the image's log to stderr: all of it, or warnings and errors only.
    ///
    /// # Errors
    /// QEMU is not installed, the image cannot be read.
    pub fn start(machine: Machine, image: &Path, log_all: bool) -> Result<Self> {
        let name = image.display();
        let image_path = image
            .canonicalize()
            .with_context(|| format!("{name}: no such image"))?;
        let bytes =
            std::fs::read(&image_path).with_context(|| format!("{name}: cannot be read"))?;
        let decoder = LogDecoder::new(&bytes).with_context(|| format!("{name}"))?;
        let folder = tempfile::tempdir().context("a folder for the emulator's socket")?;
        let started = Command::new(PROGRAM)
            .args(["-M", machine.name()])
            .args(["-display", "none", "-monitor", "none"])
            // In the current folder: no path that a socket or an option could not hold.
            .args(["-serial", &format!("unix:{SOCKET},server=on,wait=off")])
            .args(["-icount", "shift=0"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .arg("-kernel")
            .arg(&image_path)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = installed(started)?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let lines = LogLines::default();
        let log = stdout.map(|mut stdout| {
            let lines = lines.clone();
            thread::spawn(move || decoder.follow(&mut stdout, log_all, &lines))
        });
        let messages = stderr.map(|mut stderr| {
            thread::spawn(move || {
                let mut text = Vec::new();
                // Whatever could be read is what there is to tell.
                let _ = stderr.by_ref().take(MESSAGE_BYTES).read_to_end(&mut text);
                let _ = std::io::copy(&mut stderr, &mut std::io::sink());
                String::from_utf8_lossy(&text).into_owned()
            })
        });
        Ok(Self {
            child,
            folder,
            lines,
            log,
            messages,
        })
    }

    /// Connects to the machine's UART. After the connection was dropped, it can be made anew.
    ///
    /// # Errors
    /// QEMU has ended, or does not listen.
    pub fn connect(&mut self) -> Result<UnixStream> {
        let path: PathBuf = self.folder.path().join(SOCKET);
        let started = Instant::now();
        loop {
            match UnixStream::connect(&path) {
                Ok(stream) => return Ok(stream),
                Err(error) => {
                    if let Some(end) = self.end() {
                        bail!("{end}");
                    }
                    if started.elapsed() > START {
                        bail!("{}: no connection to the emulator: {error}", path.display());
                    }
                }
            }
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// The latest lines of the image's log.
    #[must_use]
    pub const fn log(&self) -> &LogLines {
        &self.lines
    }

    /// What QEMU said when it ended; `None` while it runs. Its log is complete then.
    pub fn end(&mut self) -> Option<String> {
        let status = self.child.try_wait().ok().flatten()?;
        if let Some(log) = self.log.take() {
            let _ = log.join();
        }
        let said = self
            .messages
            .take()
            .and_then(|messages| messages.join().ok())
            .unwrap_or_default();
        // What follows the first line are registers.
        let said = said.lines().next().unwrap_or("no message");
        Some(format!("{PROGRAM} ended ({status}, {said})"))
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        // Fails only where it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
        // With the emulator their sources have ended.
        if let Some(log) = self.log.take() {
            let _ = log.join();
        }
        if let Some(messages) = self.messages.take() {
            let _ = messages.join();
        }
    }
}
