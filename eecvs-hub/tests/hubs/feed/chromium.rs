//! A headless Chromium that is spoken to over a pipe, by its own protocol: pages are opened as wide as is wished, scripts
//! run in them, and what their consoles say is heard.

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// The browser does what it is told within this time.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser, ended when it is dropped.
pub struct Browser {
    child: Child,
    commands: File,
    answers: Receiver<Value>,
    number: u64,
    /// Of the page that is open.
    session: String,
    /// What consoles said, and errors of scripts.
    pub console: Vec<String>,
    _folder: tempfile::TempDir,
}

impl Browser {
    /// Starts a browser with an empty page.
    ///
    /// # Panics
    /// Where it does not start: that is no fault of a page.
    pub fn start(program: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let made = Command::new("mkfifo")
            .args([path("commands"), path("answers")])
            .status();
        assert!(made.unwrap().success());
        // The shell opens the pipes as the numbers that the browser has for them.
        let child = Command::new("sh")
            .args(["-c", "exec \"$@\" 3<\"$0/commands\" 4>\"$0/answers\""])
            .arg(folder.path())
            .arg(program)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--no-first-run",
                "--hide-scrollbars",
                "--remote-debugging-pipe",
            ])
            .arg(format!("--user-data-dir={}", path("user").display()))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(path("log")).unwrap())
            .spawn()
            .unwrap();
        // In the shell's order: each opening waits for the other side's.
        let commands = OpenOptions::new()
            .write(true)
            .open(path("commands"))
            .unwrap();
        let mut pipe = File::open(path("answers")).unwrap();
        let (put, answers) = channel();
        thread::spawn(move || {
            let (mut bytes, mut part) = (Vec::new(), vec![0; 1 << 16]);
            while let Ok(count @ 1..) = pipe.read(&mut part) {
                bytes.extend_from_slice(&part[..count]);
                while let Some(end) = bytes.iter().position(|byte| *byte == 0) {
                    let message: Vec<u8> = bytes.drain(..=end).collect();
                    let message = serde_json::from_slice(&message[..end]).unwrap();
                    if put.send(message).is_err() {
                        return;
                    }
                }
            }
        });
        let mut browser = Self {
            child,
            commands,
            answers,
            number: 0,
            session: String::new(),
            console: Vec::new(),
            _folder: folder,
        };
        let target = browser.tell("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = browser.tell("Target.attachToTarget", &attach);
        session["sessionId"]
            .as_str()
            .unwrap()
            .clone_into(&mut browser.session);
        for part in ["Page.enable", "Runtime.enable", "Log.enable"] {
            browser.tell(part, &json!({}));
        }
        browser
    }

    fn hear(&mut self, message: &Value) {
        let of = &message["params"];
        match message["method"].as_str() {
            Some("Runtime.consoleAPICalled") => self.console.push(of["args"].to_string()),
            Some("Runtime.exceptionThrown") => {
                self.console.push(of["exceptionDetails"].to_string());
            }
            Some("Log.entryAdded") => self.console.push(of["entry"]["text"].to_string()),
            _ => {}
        }
    }

    /// Tells the browser to do something; what it answers.
    pub fn tell(&mut self, method: &str, params: &Value) -> Value {
        self.number += 1;
        let mut message = json!({ "id": self.number, "method": method, "params": params });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        let mut bytes = serde_json::to_vec(&message).unwrap();
        bytes.push(0);
        self.commands.write_all(&bytes).unwrap();
        let started = Instant::now();
        loop {
            let left = PATIENCE.saturating_sub(started.elapsed());
            match self.answers.recv_timeout(left) {
                Ok(answer) if answer["id"] == json!(self.number) => {
                    assert!(answer["error"].is_null(), "{method}: {answer}");
                    return answer["result"].clone();
                }
                Ok(other) => self.hear(&other),
                Err(RecvTimeoutError::Timeout) => panic!("{method}: no answer"),
                Err(RecvTimeoutError::Disconnected) => panic!("{method}: the browser has ended"),
            }
        }
    }

    /// Opens a page, so wide.
    pub fn open(&mut self, address: &str, width: u32, is_dark: bool) {
        let size = json!({ "width": width, "height": if width < 600 { 1900 } else { 900 }, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.tell("Emulation.setDeviceMetricsOverride", &size);
        let scheme = if is_dark { "dark" } else { "light" };
        let features = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        self.tell("Emulation.setEmulatedMedia", &features);
        self.tell("Page.navigate", &json!({ "url": address }));
    }

    /// What a script says, which may be a promise.
    pub fn run(&mut self, script: &str) -> Value {
        let params = json!({ "expression": script, "returnByValue": true, "awaitPromise": true });
        let result = self.tell("Runtime.evaluate", &params);
        assert!(result["exceptionDetails"].is_null(), "{script}: {result}");
        result["result"]["value"].clone()
    }

    /// Runs a script again until it says true.
    pub fn wait(&mut self, script: &str) {
        let started = Instant::now();
        while self.run(script) != json!(true) {
            assert!(started.elapsed() < PATIENCE, "never true: {script}");
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// The page as a PNG file; of a narrow one its beginning.
    pub fn save(&mut self, path: &Path) {
        let is_whole = self.run("innerWidth >= 600");
        let shot = json!({ "format": "png", "captureBeyondViewport": is_whole });
        let shot = self.tell("Page.captureScreenshot", &shot);
        fs::write(path, from_base64(shot["data"].as_str().unwrap())).unwrap();
    }
}

fn from_base64(text: &str) -> Vec<u8> {
    let value = |letter: u8| match letter {
        b'A'..=b'Z' => letter - b'A',
        b'a'..=b'z' => letter - b'a' + 26,
        b'0'..=b'9' => letter - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let (mut word, mut bits, mut bytes) = (0_u32, 0, Vec::new());
    for letter in text.bytes().filter(|letter| *letter != b'=') {
        word = word << 6 | u32::from(value(letter));
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((word >> bits) as u8);
        }
    }
    bytes
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
