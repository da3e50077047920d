//! Programs that run beside a test, in domains of their own.

use std::net::TcpListener;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use eecvs_ros::transport::Qos;

/// Enough for everything that a test sends.
pub const QOS: Qos = Qos {
    depth: 10_000,
    reliable: false,
};

/// How long programs may take to find each other and to end.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A TCP port of this computer at which nobody listens.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

/// A program that ends with the test.
pub struct Program {
    name: String,
    child: Child,
}

impl Program {
    /// `eecvs-ros` with arguments, in a domain, on this computer alone.
    pub fn eecvs_ros(domain: u16, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_eecvs-ros"));
        command.args(arguments);
        Self::start(arguments[0], domain, command)
    }

    /// Any program, in a domain, on this computer alone.
    pub fn start(name: &str, domain: u16, mut command: Command) -> Self {
        command
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let child = command.spawn().unwrap();
        Self {
            name: name.to_owned(),
            child,
        }
    }

    /// Asks it to end, by the signal of `kill`.
    pub fn terminate(&self) {
        self.signal("-TERM");
    }

    /// Stops it, as if its computer hung.
    pub fn stop(&self) {
        self.signal("-STOP");
    }

    fn signal(&self, signal: &str) {
        let id = self.child.id().to_string();
        let status = Command::new("kill").args([signal, &id]).status();
        assert!(status.unwrap().success());
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Waits for its end; its output and errors, where it ended well and in time.
    pub fn finish(self, most: Duration) -> (String, String) {
        self.ends_with(0, most)
    }

    /// Waits for its end; its output and errors, where it ended with this status and in time.
    pub fn ends_with(mut self, wanted: i32, most: Duration) -> (String, String) {
        let until = Instant::now() + most;
        let status: Option<ExitStatus> = loop {
            match self.child.try_wait().unwrap() {
                None if Instant::now() < until => std::thread::sleep(Duration::from_millis(20)),
                status => break status,
            }
        };
        let _ = self.child.kill();
        let mut texts = [String::new(), String::new()];
        let [out, errors] = &mut texts;
        use std::io::Read;
        self.child
            .stdout
            .take()
            .unwrap()
            .read_to_string(out)
            .unwrap();
        self.child
            .stderr
            .take()
            .unwrap()
            .read_to_string(errors)
            .unwrap();
        assert!(
            status.is_some_and(|status| status.code() == Some(wanted)),
            "{}: {status:?}, not {wanted}\n{out}\n{errors}",
            self.name
        );
        let [out, errors] = texts;
        (out, errors)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
