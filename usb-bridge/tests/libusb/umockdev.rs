//! A device on a mocked USB, for the real libusb in a process of its own ([`usb_bridge::peripheral::usbfs`]).

use std::process::Command;

use usb_bridge::peripheral::Peripheral;
use usb_bridge::peripheral::usbfs::MockedUsb;
use usb_bridge::peripheral::usbfs::kernel::Usbfs;

/// A mocked USB with one device.
pub struct Mocked(MockedUsb);

impl Mocked {
    /// A USB with `peripheral` at port 4 of bus 1, address 7; `None`, and a line that says so, where umockdev's library
    /// is absent.
    pub fn new(peripheral: Box<dyn Peripheral>) -> Option<Self> {
        match MockedUsb::new(peripheral) {
            Ok(usb) => Some(Self(usb)),
            Err(error) => {
                eprintln!("skipped: {error:#}");
                None
            }
        }
    }

    /// The device is gone from the bus, and everything that is asked of it fails.
    pub fn unplug(&mut self) {
        self.0.unplug().unwrap();
    }

    /// Nobody but root may open the device; the rest can be seen by everybody.
    pub fn forbid(&self) {
        self.0.permit(false).unwrap();
    }

    /// Everybody may open the device.
    pub fn permit(&self) {
        self.0.permit(true).unwrap();
    }

    /// The kernel's side of the device.
    pub fn with_usbfs<T>(&self, use_it: impl FnOnce(&mut Usbfs) -> T) -> T {
        self.0.with_usbfs(use_it)
    }

    /// A program that sees this USB and no other.
    pub fn command_for(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        self.0.command(program)
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

/// Whether this process is the one that uses the mocked USB.
pub fn under_umockdev() -> bool {
    std::env::var_os(UNDER).is_some()
}
