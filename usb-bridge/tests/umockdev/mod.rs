//! A device on a mocked USB: the real libusb in a process of its own, any [`Peripheral`] in this one.
//!
//! ```text
//! program under test: libusb -> usbfs ioctls -> libumockdev's preloaded library
//!                                                  | its own socket
//! testbed.c: sysfs and device nodes, through libumockdev's C interface
//!                                                  | a socket, see there
//! this process: usbfs as the kernel answers it -> Peripheral
//! ```

pub mod usbfs;

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::JoinHandle;

use usb_bridge::peripheral::{Peripheral, Speed};

use usbfs::Usbfs;

/// The preloaded library's name, as `umockdev-wrapper` has it.
const PRELOAD: &str = "libumockdev-preload.so.0";

/// A mocked USB with one device.
pub struct Mocked {
    testbed: Child,
    commands: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
    root: String,
    server: Option<JoinHandle<()>>,
    usbfs: Arc<Mutex<Usbfs>>,
    _folder: tempfile::TempDir,
}

/// The testbed's program, compiled once; `None`, and a line that says so, where libumockdev is absent.
fn testbed() -> Option<&'static Path> {
    static PROGRAM: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        let run = |command: &mut Command| {
            let told = format!("{:?}", command.get_program());
            match command.output() {
                Ok(output) if output.status.success() => Ok(output.stdout),
                Ok(output) => Err(String::from_utf8_lossy(&output.stderr).into_owned()),
                Err(error) => Err(format!("{told}: {error}")),
            }
        };
        run(Command::new("umockdev-wrapper").arg("true"))?;
        let flags = run(Command::new("pkg-config").args(["--cflags", "--libs", "umockdev-1.0"]))?;
        let flags = String::from_utf8_lossy(&flags).into_owned();
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        // Several test programs may compile it at the same time.
        let made = folder.join(format!("umockdev_testbed_{}", std::process::id()));
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/umockdev/testbed.c");
        let compiled = Command::new("cc")
            .args(["-Wall", "-Wextra", "-Werror", "-O1", "-o"])
            .arg(&made)
            .arg(source)
            .args(flags.split_whitespace())
            .output()
            .map_err(|error| format!("cc: {error}"))?;
        // With everything there, a program that does not compile is an error and no reason to skip.
        let errors = String::from_utf8_lossy(&compiled.stderr);
        assert!(compiled.status.success(), "testbed.c: {errors}");
        Ok(made)
    });
    match program {
        Ok(program) => Some(program),
        Err(why) => {
            eprintln!(
                "skipped: no libumockdev (packages umockdev and libumockdev-dev): {}",
                why.trim()
            );
            None
        }
    }
}

impl Mocked {
    /// A USB with `peripheral` at port 4 of bus 1, address 7; `None` where libumockdev is absent.
    pub fn new(peripheral: Box<dyn Peripheral>) -> Option<Self> {
        let program = testbed()?;
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("usbfs");
        let listener = UnixListener::bind(&socket).unwrap();
        let mut testbed = Command::new("umockdev-wrapper")
            .arg(program)
            .arg(&socket)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (connection, _) = listener.accept().unwrap();
        let description = description(&*peripheral);
        let usbfs = Arc::new(Mutex::new(Usbfs::new(peripheral)));
        let served = Arc::clone(&usbfs);
        let server = std::thread::spawn(move || serve(connection, &served));
        let mut mocked = Self {
            commands: testbed.stdin.take(),
            answers: BufReader::new(testbed.stdout.take().unwrap()),
            root: String::new(),
            server: Some(server),
            usbfs,
            testbed,
            _folder: folder,
        };
        mocked.root = mocked.answer();
        mocked.command(&format!(
            "add {SYSPATH} {NODE} {}\n{description}",
            description.len()
        ));
        Some(mocked)
    }

    fn answer(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).unwrap();
        line.trim().to_owned()
    }

    fn command(&mut self, text: &str) {
        let commands = self.commands.as_mut().unwrap();
        commands.write_all(text.as_bytes()).unwrap();
        commands.flush().unwrap();
        assert_eq!(self.answer(), "done", "{text}");
    }

    /// The device is gone from the bus, and everything that is asked of it fails.
    pub fn unplug(&mut self) {
        self.with_usbfs(Usbfs::unplug);
        self.command(&format!("remove /sys{SYSPATH}\n"));
    }

    fn set_mode(&self, path: &str, mode: u32) {
        use std::os::unix::fs::PermissionsExt;
        let path = Path::new(&self.root).join(path);
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    }

    /// Nobody but root may open the device; the rest can be seen by everybody.
    pub fn forbid(&self) {
        // The preloaded library makes its sockets there.
        self.set_mode("", 0o777);
        self.set_mode(&format!("ioctl{NODE}"), 0o777);
        self.set_mode(&NODE[1..], 0o600);
    }

    /// Everybody may open the device.
    pub fn permit(&self) {
        self.set_mode(&NODE[1..], 0o666);
    }

    /// The kernel's side of the device.
    pub fn with_usbfs<T>(&self, use_it: impl FnOnce(&mut Usbfs) -> T) -> T {
        use_it(&mut self.usbfs.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// A program that sees this USB and no other.
    pub fn command_for(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new(program);
        command
            .env("LD_PRELOAD", PRELOAD)
            .env("UMOCKDEV_DIR", &self.root);
        command
    }

    /// As [`Mocked::command_for`], for a user who may do nothing in particular: root may open everything.
    /// [`output_of_nobody`] says whether the system has a way to be that.
    pub fn command_for_nobody(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = self.command_for("setpriv");
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
        command.arg(program);
        command
    }

    /// Runs the same test again in a process that sees this USB; there `under_umockdev` is true.
    /// `EECVS_TEST_RUNNER` may name a program that runs it: `valgrind --error-exitcode=9 -q`.
    pub fn run_test(&self, name: &str) {
        let program = std::env::current_exe().unwrap();
        let runner = std::env::var("EECVS_TEST_RUNNER").unwrap_or_default();
        let mut words = runner.split_whitespace();
        let mut command = self.command_for(words.next().map_or(program.as_os_str(), AsRef::as_ref));
        if !runner.is_empty() {
            command.args(words).arg(&program);
        }
        let output = command
            .args([name, "--exact", "--nocapture", "--test-threads=1"])
            .env(UNDER, "1")
            .output()
            .unwrap();
        let (stdout, stderr) = (
            String::from_utf8_lossy(&output.stdout),
            String::from_utf8_lossy(&output.stderr),
        );
        assert!(output.status.success(), "{stdout}\n{stderr}");
        assert!(stdout.contains("1 passed"), "no test {name}: {stdout}");
    }
}

impl Drop for Mocked {
    fn drop(&mut self) {
        // The end of its commands ends the testbed, and the testbed's end the server.
        drop(self.commands.take());
        let _ = self.testbed.wait();
        if let Some(server) = self.server.take() {
            let _ = server.join();
        }
    }
}

/// What a [`Mocked::command_for_nobody`] says; `None`, and a line, where it cannot be run.
pub fn output_of_nobody(command: &mut Command) -> Option<std::process::Output> {
    match command.output() {
        Err(error) => {
            eprintln!("skipped: setpriv: {error}");
            None
        }
        Ok(output) => {
            let told = String::from_utf8_lossy(&output.stderr);
            if told.contains("setpriv: ") {
                eprintln!("skipped: {}", told.trim());
                return None;
            }
            Some(output)
        }
    }
}

pub const UNDER: &str = "EECVS_TEST_UNDER_UMOCKDEV";
const HUB: &str = "/devices/pci0000:00/0000:00:14.0/usb1";
const SYSPATH: &str = "/devices/pci0000:00/0000:00:14.0/usb1/1-4";
const NODE: &str = "/dev/bus/usb/001/007";

/// Whether this process is the one that uses the mocked USB.
pub fn under_umockdev() -> bool {
    std::env::var_os(UNDER).is_some()
}

/// The device in sysfs, as libumockdev reads it.
fn description(peripheral: &dyn Peripheral) -> String {
    let descriptors = peripheral.descriptors();
    let device = &descriptors.device;
    let word = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
    let string = |at: usize| {
        let number = usize::from(device[at]);
        number
            .checked_sub(1)
            .and_then(|index| descriptors.strings.get(index))
    };
    let speed = match descriptors.speed {
        Speed::Full => 12,
        Speed::High => 480,
        Speed::Super => 5000,
    };
    let mut text = format!(
        "P: {SYSPATH}\nN: {}\nE: DEVNAME={NODE}\nE: DEVTYPE=usb_device\nE: SUBSYSTEM=usb\n\
         E: BUSNUM=001\nE: DEVNUM=007\nA: busnum=1\\n\nA: devnum=7\\n\nA: speed={speed}\\n\n\
         A: bConfigurationValue=1\\n\nA: idVendor={:04x}\\n\nA: idProduct={:04x}\\n\n",
        &NODE[5..],
        word(8),
        word(10)
    );
    for (name, at) in [("manufacturer", 14), ("product", 15), ("serial", 16)] {
        if let Some(string) = string(at) {
            writeln!(text, "A: {name}={string}\\n").unwrap();
        }
    }
    text.push_str("H: descriptors=");
    for byte in device.iter().chain(&descriptors.configuration) {
        write!(text, "{byte:02X}").unwrap();
    }
    text.push_str("\n\n");
    text.push_str(&root_hub());
    text
}

/// The hub that the device is at: without one there is no USB at all when the device has gone.
fn root_hub() -> String {
    let device = "12010002090001406B1D0200000601010001";
    let configuration = "09021900010100E0000904000001090000000705810304000C";
    format!(
        "P: {HUB}\nN: bus/usb/001/001\nE: DEVNAME=/dev/bus/usb/001/001\nE: DEVTYPE=usb_device\n\
         E: SUBSYSTEM=usb\nA: busnum=1\\n\nA: devnum=1\\n\nA: speed=480\\n\n\
         A: bConfigurationValue=1\\n\nA: idVendor=1d6b\\n\nA: idProduct=0002\\n\n\
         H: descriptors={device}{configuration}\n\n"
    )
}

/// Answers the testbed until it ends.
fn serve(mut connection: UnixStream, usbfs: &Mutex<Usbfs>) {
    let mut question = [0; 8];
    let mut bytes = Vec::new();
    while connection.read_exact(&mut question).is_ok() {
        let [what, length] =
            [0, 4].map(|at| u32::from_ne_bytes(question[at..at + 4].try_into().unwrap()));
        bytes.resize(length as usize, 0);
        if connection.read_exact(&mut bytes).is_err() {
            return;
        }
        let (result, answer) = usbfs
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .ioctl(what, &bytes);
        let mut message = Vec::with_capacity(8 + answer.len());
        message.extend(result.to_ne_bytes());
        message.extend((answer.len() as u32).to_ne_bytes());
        message.extend(answer);
        if connection.write_all(&message).is_err() {
            return;
        }
    }
}
