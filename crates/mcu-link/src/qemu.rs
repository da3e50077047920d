//! An emulated microcontroller: QEMU with its UART and its log.

use std::io::{ErrorKind, Read};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use event_types::bail;
use event_types::stream::{Context, Result, small_file};
use tempfile::TempDir;

use super::image::BYTES_MAX;
use super::log::{LogDecoder, LogLines};

const PROGRAM: &str = "qemu-system-arm";
/// Name of the UART's socket, which lies in a temporary folder.
const SOCKET: &str = "uart";
/// Time that QEMU may take to open the socket.
const START: Duration = Duration::from_secs(20);
/// Maximum number of bytes kept of QEMU's own messages.
const MESSAGE_BYTES: u64 = 1 << 12;

/// Lets the system end a child if this thread ends, so that no emulator runs on for ever after a command that is killed.
#[cfg(target_os = "linux")]
#[allow(unsafe_code)]
fn end_with_this_thread(command: &mut Command) {
    use std::os::unix::process::CommandExt;

    use rustix::process::{Signal, getpid, getppid, set_parent_process_death_signal};

    let own = getpid();
    let end = move || {
        set_parent_process_death_signal(Some(Signal::KILL))?;
        // This process may have ended before.
        if getppid() == Some(own) {
            Ok(())
        } else {
            Err(ErrorKind::BrokenPipe.into())
        }
    };
    // SAFETY: between fork and exec the closure makes two system calls, and neither allocates nor locks.
    unsafe { command.pre_exec(end) };
}

#[cfg(not(target_os = "linux"))]
fn end_with_this_thread(_: &mut Command) {}

/// A machine for which images exist and that QEMU emulates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Machine {
    /// An STM32F405: Cortex-M4F, 168 MHz.
    NetduinoPlus2,
    /// The same, of which the image takes at most 64 KiB of flash and 48 KiB of RAM: it has the fast coder alone.
    Small,
    /// The MPS2+ board with a Cortex-M3.
    Mps2An385,
    /// The same, with the instructions of a Cortex-M0+, all of which it has.
    Mps2An385M0,
    /// The MPS2+ board with a Cortex-M4.
    Mps2An386,
    /// The MPS2+ board with a Cortex-M7.
    Mps2An500,
    /// The MPS2+ board with a Cortex-M33.
    Mps2An505,
    /// The MPS3 board with a Cortex-M55.
    Mps3An547,
}

impl Machine {
    /// Every machine.
    pub const ALL: [Self; 8] = [
        Self::NetduinoPlus2,
        Self::Small,
        Self::Mps2An385,
        Self::Mps2An385M0,
        Self::Mps2An386,
        Self::Mps2An500,
        Self::Mps2An505,
        Self::Mps3An547,
    ];

    /// Returns the machine with the given name, or `None` if the name is unknown.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|machine| machine.name() == name)
    }

    /// Returns a one-line description of the machine.
    #[must_use]
    pub const fn about(self) -> &'static str {
        match self {
            Self::NetduinoPlus2 => "STM32F405, Cortex-M4F, 168 MHz",
            Self::Small => {
                "the same with an image of 64 KiB of flash and 48 KiB of RAM: the fast coder alone"
            }
            Self::Mps2An385 => "MPS2+ board with a Cortex-M3",
            Self::Mps2An385M0 => "the same by the instructions of a Cortex-M0+",
            Self::Mps2An386 => "MPS2+ board with a Cortex-M4",
            Self::Mps2An500 => "MPS2+ board with a Cortex-M7",
            Self::Mps2An505 => "MPS2+ board with a Cortex-M33",
            Self::Mps3An547 => "MPS3 board with a Cortex-M55",
        }
    }

    /// Returns the machine's name, as `firmware/build.sh` has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::NetduinoPlus2 => "netduinoplus2",
            Self::Small => "small",
            Self::Mps2An385 => "mps2-an385",
            Self::Mps2An385M0 => "mps2-an385-m0",
            Self::Mps2An386 => "mps2-an386",
            Self::Mps2An500 => "mps2-an500",
            Self::Mps2An505 => "mps2-an505",
            Self::Mps3An547 => "mps3-an547",
        }
    }

    /// Returns the machine's name in QEMU.
    const fn emulated(self) -> &'static str {
        match self {
            Self::Small => Self::NetduinoPlus2.name(),
            Self::Mps2An385M0 => Self::Mps2An385.name(),
            _ => self.name(),
        }
    }
}

/// Unwraps the result of starting QEMU; if QEMU is not installed, the error says how to install it.
fn installed<T>(started: std::io::Result<T>) -> Result<T> {
    match started {
        Err(error) if error.kind() == ErrorKind::NotFound => bail!(
            Unsupported,
            "{PROGRAM} is not installed: install it with `apt-get install qemu-system-arm` \
             (Debian, Ubuntu), `dnf install qemu-system-arm` (Fedora) or `brew install qemu` \
             (macOS)"
        ),
        other => other.with_context(|| format!("starting {PROGRAM}")),
    }
}

/// Checks that QEMU is installed.
///
/// # Errors
/// QEMU is not installed or cannot be started.
pub fn find() -> Result<()> {
    let version = Command::new(PROGRAM).arg("--version").output();
    installed(version).map(|_| ())
}

/// Runs an image to its end and returns what it printed to stdout.
///
/// The image may read the files of `folder`. One instruction takes 1 ns of the machine's time; the UART is not
/// connected.
///
/// # Errors
/// QEMU is not installed, or the image is missing, fails, or takes longer than `patience`.
pub fn run(machine: Machine, image: &Path, folder: &Path, patience: Duration) -> Result<String> {
    run_with(machine, image, folder, "shift=0", patience)
}

/// Runs an image as [`run`] does, at 2^`shift` ns for an instruction; time in which the processor sleeps is skipped.
///
/// # Errors
/// As those of [`run`].
pub(crate) fn play(
    machine: Machine,
    image: &Path,
    folder: &Path,
    shift: u8,
    patience: Duration,
) -> Result<String> {
    run_with(
        machine,
        image,
        folder,
        &format!("shift={shift},sleep=off"),
        patience,
    )
}

fn run_with(
    machine: Machine,
    image: &Path,
    folder: &Path,
    clock: &str,
    patience: Duration,
) -> Result<String> {
    let mut child = spawn(machine, image, folder, clock, &[])?;
    let name = image.display();
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
            // Fails only if the process has already ended.
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
            bail!(
                Other,
                "{name}: the image failed ({status}): {}",
                said.join(" ")
            )
        }
        None => bail!(Other, "{name}: the image did not end within {patience:?}"),
    }
}

/// Starts a machine that stands still until a debugger, on this socket in the folder, lets it go on. Its debugger's
/// connection must last as long as it; its stdout and stderr are short.
///
/// # Errors
/// QEMU is not installed, or the image is missing.
pub(crate) fn stopped(
    machine: Machine,
    image: &Path,
    folder: &Path,
    shift: u8,
    socket: &str,
) -> Result<Child> {
    let port = format!("unix:{socket},server=on,wait=off");
    let clock = format!("shift={shift},sleep=off");
    spawn(machine, image, folder, &clock, &["-S", "-gdb", &port])
}

/// Starts an image without a UART, in a folder whose files it may read and write.
fn spawn(
    machine: Machine,
    image: &Path,
    folder: &Path,
    clock: &str,
    options: &[&str],
) -> Result<Child> {
    let image = image
        .canonicalize()
        .with_context(|| format!("{}: no such image", image.display()))?;
    let mut command = Command::new(PROGRAM);
    command
        .args(["-M", machine.emulated()])
        .args(["-display", "none", "-monitor", "none", "-serial", "null"])
        .args(["-icount", clock])
        .args(["-semihosting-config", "enable=on,target=native"])
        .args(options)
        .arg("-kernel")
        .arg(&image)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    end_with_this_thread(&mut command);
    installed(command.spawn())
}

/// Reads a stream to its end in its own thread.
fn follow(mut stream: Box<dyn Read + Send>) -> JoinHandle<String> {
    thread::spawn(move || {
        let mut text = Vec::new();
        // On a read error, the text read so far is returned.
        let _ = stream.read_to_end(&mut text);
        String::from_utf8_lossy(&text).into_owned()
    })
}

/// A running emulator; killed when dropped.
pub struct Qemu {
    child: Child,
    folder: TempDir,
    lines: LogLines,
    /// Readers of its stdout and stderr; the second returns the text it read.
    log: Option<JoinHandle<()>>,
    messages: Option<JoinHandle<String>>,
}

impl Qemu {
    /// Starts an image. One instruction takes 1 ns of the machine's time.
    ///
    /// The image's log is printed to stderr: all of it, or warnings and errors only. On Linux the machine ends at the
    /// latest with the thread that starts it, even if the process is killed.
    ///
    /// # Errors
    /// QEMU is not installed, or the image cannot be read.
    pub fn start(machine: Machine, image: &Path, log_all: bool) -> Result<Self> {
        let name = image.display();
        let image_path = image
            .canonicalize()
            .with_context(|| format!("{name}: no such image"))?;
        let bytes = small_file::read(&image_path, BYTES_MAX)?;
        let decoder = LogDecoder::new(&bytes).with_context(|| format!("{name}"))?;
        let folder =
            tempfile::tempdir().context("cannot create a folder for the emulator's socket")?;
        let mut command = Command::new(PROGRAM);
        command
            .args(["-M", machine.emulated()])
            .args(["-display", "none", "-monitor", "none"])
            // A path relative to the current folder is neither too long for a socket nor needs quoting in an
            // option.
            .args(["-serial", &format!("unix:{SOCKET},server=on,wait=off")])
            .args(["-icount", "shift=0"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .arg("-kernel")
            .arg(&image_path)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        end_with_this_thread(&mut command);
        let mut child = installed(command.spawn())?;
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        let lines = LogLines::default();
        let log = stdout.map(|mut stdout| {
            let lines = lines.clone();
            thread::spawn(move || decoder.follow(&mut stdout, log_all, &lines))
        });
        let messages = stderr.map(|mut stderr| {
            thread::spawn(move || {
                let mut text = Vec::new();
                // On a read error, the text read so far is returned.
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

    /// Connects to the machine's UART. A new connection can be made after the previous one is dropped.
    ///
    /// # Errors
    /// QEMU has ended, or does not accept a connection in time.
    pub fn connect(&mut self) -> Result<UnixStream> {
        let path: PathBuf = self.folder.path().join(SOCKET);
        let started = Instant::now();
        loop {
            match UnixStream::connect(&path) {
                Ok(stream) => return Ok(stream),
                Err(error) => {
                    if let Some(end) = self.end() {
                        bail!(Other, "{end}");
                    }
                    if started.elapsed() > START {
                        bail!(
                            Other,
                            "{}: cannot connect to the emulator: {error}",
                            path.display()
                        );
                    }
                }
            }
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// Returns the latest lines of the image's log.
    #[must_use]
    pub const fn log(&self) -> &LogLines {
        &self.lines
    }

    /// Returns QEMU's exit status and its first message once it has ended, with the log then complete; `None` while
    /// it runs.
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
        // The lines after the first are register contents.
        let said = said.lines().next().unwrap_or("no message");
        Some(format!("{PROGRAM} ended ({status}, {said})"))
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        // Fails only if the process has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
        // Their sources ended with the emulator, so these joins return.
        if let Some(log) = self.log.take() {
            let _ = log.join();
        }
        if let Some(messages) = self.messages.take() {
            let _ = messages.join();
        }
    }
}
