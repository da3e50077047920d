//! Runs of a command in a folder of its own, with a plan of what fails.

use std::collections::BTreeMap;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::{Duration, Instant};

use crate::case::{Case, Cost, INPUTS, Kind};

/// No command takes longer, unless it hangs.
const LONGEST: Duration = Duration::from_secs(120);

/// Nor one that takes minutes.
const LONGEST_OF_MINUTES: Duration = Duration::from_secs(1800);

/// Files by their names in a folder.
pub type Files = BTreeMap<String, Vec<u8>>;

/// A folder with the inputs, one in which commands run, and the list of their calls.
pub struct Bench {
    root: tempfile::TempDir,
    /// A port that nobody had.
    port: u16,
    /// A domain of ROS 2 of its own: nodes hear all that another bench sends in theirs, and would never be idle.
    domain: u16,
}

/// The next bench's domain; the tests of what is outside of a bench have 93.
static DOMAIN: AtomicU16 = AtomicU16::new(94);

/// A command that runs, and the programs on its other end, which end with it.
pub struct Run {
    child: Child,
    beside: Vec<Beside>,
    longest: Duration,
    line: &'static str,
}

/// A program on the other end.
struct Beside {
    command: Command,
    child: Child,
}

impl Beside {
    fn start(mut command: Command) -> Self {
        let child = command.spawn().expect("a program that starts");
        Self { command, child }
    }

    /// Starts it again if it has failed: a sender gives up where the machine is so busy that nobody listens for seconds.
    fn go_on(&mut self) {
        let ended = self.child.try_wait().expect("a child");
        if ended.is_some_and(|status| !status.success()) {
            self.child = self.command.spawn().expect("a program that starts");
        }
    }
}

impl Run {
    pub fn kill(&mut self) {
        let _ = self.child.kill();
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        for Beside { child, .. } in &mut self.beside {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// How a command ended.
pub struct Outcome {
    pub status: ExitStatus,
    pub stderr: String,
    pub files: Files,
    /// The calls that could have failed, with their paths.
    pub calls: Vec<String>,
}

/// The folder of what cargo builds.
fn built() -> PathBuf {
    let own = std::env::current_exe().expect("the path of this test");
    own.ancestors().nth(2).expect("target/debug").to_owned()
}

pub fn program(name: &str) -> PathBuf {
    let path = built().join(name);
    assert!(
        path.exists(),
        "{} is not built: cargo build --workspace",
        path.display()
    );
    path
}

impl Bench {
    /// Makes the inputs.
    pub fn new() -> Self {
        let root = tempfile::tempdir().expect("a folder");
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let domain = DOMAIN.fetch_add(1, Ordering::Relaxed);
        let bench = Self { root, port, domain };
        for folder in ["in", "run"] {
            std::fs::create_dir(bench.at(folder)).expect("a folder");
        }
        for (name, line) in INPUTS {
            let mut command = Command::new(program(name));
            command
                .current_dir(bench.at("in"))
                .args(line.split_whitespace());
            let output = command.output().expect("a program that starts");
            assert!(output.status.success(), "{line}: {output:?}");
        }
        let of = |name: &str| std::fs::read(bench.at("in").join(name)).expect("an input");
        let two = [of("scene.eecvs"), of("wide.eecvs")].concat();
        std::fs::write(bench.at("in/two.eecvs"), two).expect("an input");
        bench
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.root.path().join(name)
    }

    /// Empties the folder and puts what is there before a run of the case into it.
    pub fn prepare(&self, case: &Case) -> Files {
        let run = self.at("run");
        std::fs::remove_dir_all(&run).expect("a folder");
        std::fs::create_dir_all(run.join("tmp")).expect("a folder");
        let old = match case.kind {
            // Frames without an end mark.
            Kind::Appended => {
                let whole = std::fs::read(self.at("in/scene.eecvs")).expect("an input");
                let mark_bytes = whole.last_chunk::<8>().expect("an end mark");
                let mark_bytes = u32::from_le_bytes(*mark_bytes.first_chunk().expect("4 of 8"));
                whole[..whole.len() - mark_bytes as usize].to_vec()
            }
            _ => b"old".to_vec(),
        };
        for name in case.old {
            std::fs::write(run.join(name), &old).expect("a file");
        }
        if case.line.starts_with("report") {
            copy(&self.rows(case), &run.join("OUT"));
        }
        if case.kind == Kind::Together {
            copy(&self.at("in/fleet"), &run.join("fleet"));
        }
        files(&run)
    }

    /// The folder with the rows of a finished report: with them, another one is drawn in seconds.
    fn rows(&self, case: &Case) -> PathBuf {
        let rows = self.at("in/rows");
        if !rows.exists() {
            let whole = self.at("in/report");
            let line = case.line.replace("OUT", "IN/report");
            let mut command = self.command(case.program, &line);
            command.current_dir(self.at("in"));
            let output = command.output().expect("a program that starts");
            assert!(output.status.success(), "{}: {output:?}", case.line);
            std::fs::create_dir(&rows).expect("a folder");
            let row_file = "rows.jsonl";
            std::fs::copy(whole.join(row_file), rows.join(row_file)).expect("rows");
        }
        rows
    }

    /// A program in the folder `run`.
    fn command(&self, name: &str, line: &str) -> Command {
        let inputs = self.at("in");
        let inputs = inputs.to_str().expect("UTF-8");
        let line = line.split_whitespace().map(|word| {
            word.replace("IN/", &format!("{inputs}/"))
                .replace("PORT", &self.port.to_string())
                .replace("DOMAIN", &self.domain.to_string())
        });
        let mut command = Command::new(program(name));
        command
            .args(line)
            .current_dir(self.at("run"))
            .stdin(Stdio::null())
            .stdout(Stdio::null());
        command
    }

    /// Starts a case; the folder must have been prepared.
    pub fn start(&self, case: &Case, plan: &str) -> Run {
        let log = self.at("calls");
        let _ = std::fs::remove_file(&log);
        let mut command = self.command(case.program, case.line);
        command
            .env("TMPDIR", self.at("run/tmp"))
            .env("LD_PRELOAD", built().join("deps/libfaults.so"))
            .env("EECVS_FAULTS_FOLDER", self.at("run"))
            .env("EECVS_FAULTS_LOG", &log)
            .env("EECVS_FAULTS_PLAN", plan)
            .stderr(Stdio::piped());
        let child = command.spawn().expect("a program that starts");
        let others = case.beside.iter().map(|(name, line)| {
            let mut other = self.command(name, line);
            other.current_dir(self.at("in")).stderr(Stdio::null());
            Beside::start(other)
        });
        Run {
            child,
            beside: others.collect(),
            line: case.line,
            longest: match case.cost {
                Cost::Minutes(_) => LONGEST_OF_MINUTES,
                _ => LONGEST,
            },
        }
    }

    /// Waits for the end of a command, and looks at what it left.
    pub fn end(&self, mut run: Run) -> Outcome {
        let begun = Instant::now();
        let child = &mut run.child;
        let status = loop {
            if let Some(status) = child.try_wait().expect("a child") {
                break status;
            }
            if begun.elapsed() > run.longest {
                let _ = child.kill();
                panic!("{}: {:?}: it hangs", run.line, child.wait());
            }
            run.beside.iter_mut().for_each(Beside::go_on);
            std::thread::sleep(Duration::from_millis(1));
        };
        let mut stderr = Vec::new();
        if let Some(mut pipe) = child.stderr.take() {
            pipe.read_to_end(&mut stderr).expect("a pipe");
        }
        let calls = std::fs::read(self.at("calls")).unwrap_or_default();
        Outcome {
            status,
            stderr: String::from_utf8_lossy(&stderr).into_owned(),
            files: files(&self.at("run")),
            calls: String::from_utf8_lossy(&calls)
                .lines()
                .map(str::to_owned)
                .collect(),
        }
    }

    /// Runs a case from the state before it.
    pub fn run(&self, case: &Case, plan: &str) -> (Files, Outcome) {
        let before = self.prepare(case);
        (before, self.end(self.start(case, plan)))
    }

    /// Counts the events of a file; `None` if it cannot be read to its end.
    pub fn events(&self, name: &str) -> Option<u64> {
        let mut command = Command::new(program("eecvs"));
        let command = command
            .args(["info", "--json", name])
            .current_dir(self.at("run"));
        let output = command.output().expect("a program that starts");
        let info: serde_json::Value = serde_json::from_slice(&output.stdout).ok()?;
        info["events"].as_u64().filter(|_| output.status.success())
    }
}

impl Outcome {
    pub fn is_success(&self) -> bool {
        self.status.success()
    }

    /// Whether it was killed.
    pub fn is_killed(&self) -> bool {
        self.status.signal() == Some(libc::SIGKILL)
    }
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let place = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy(&entry.path(), &place),
            false => drop(std::fs::copy(entry.path(), place).expect("a file")),
        }
    }
}

fn files(folder: &Path) -> Files {
    fn walk(root: &Path, folder: &Path, files: &mut Files) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                walk(root, &path, files);
            } else if path.is_file() {
                let name = path.strip_prefix(root).expect("a file of the folder");
                let bytes = std::fs::read(&path).expect("a file");
                files.insert(name.to_string_lossy().into_owned(), bytes);
            }
        }
    }
    let mut all = Files::new();
    walk(folder, folder, &mut all);
    all
}
