//! A page as a browser shows it: what is on it, how large, and what is wrong with it.
//!
//! Pages stand in frames, in one page around them that measures the frames and leaves its measures in its
//! own text, which a headless Chromium prints. Frames are narrower than Chromium's
//! windows can be.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde::Deserialize;

/// Run in the page around the frames.
const SCRIPT: &str = include_str!("measure.js");
/// Names of the browser.
const NAMES: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];
/// After so long a browser is ended.
const TIMEOUT: Duration = Duration::from_secs(60);
/// What a browser says of each line of a page's console.
const CONSOLE: &str = "CONSOLE";

/// Least size of letters, in pixels of the screen: of prose and tables, and of charts and pictures.
const TEXT_PX: f64 = 12.0;
const CHART_TEXT_PX: f64 = 9.0;

/// A table of a page.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Table {
    /// The heading of its section.
    pub title: String,
    pub head: usize,
    pub rows: usize,
    pub empty_cells: usize,
    pub width: f64,
    pub height: f64,
}

/// A chart or a picture of a page.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Picture {
    /// `svg` or `img`.
    pub kind: String,
    /// Below it.
    pub caption: String,
    /// On the screen.
    pub width: f64,
    pub height: f64,
    /// Of its own.
    pub natural_width: f64,
    pub natural_height: f64,
    /// To its last pixel.
    pub is_decoded: bool,
    /// A few of an image; elements of a chart.
    pub colours: usize,
}

/// The smallest letters.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Least {
    pub px: f64,
    pub text: String,
}

/// A page at one width.
#[derive(Debug, Clone, Deserialize)]
pub struct Page {
    /// Of its window.
    pub width: f64,
    /// Of its content: more where it must be scrolled sideways.
    pub scroll_width: f64,
    pub tables: Vec<Table>,
    pub pictures: Vec<Picture>,
    pub least_text: Option<Least>,
    pub least_chart_text: Option<Least>,
    /// Texts of charts that reach out of their chart.
    pub cut_texts: Vec<String>,
    /// Texts beside the window that no box scrolls to.
    pub spilling_texts: Vec<String>,
    /// What is fetched from elsewhere.
    pub addresses: Vec<String>,
    /// Links to places that the page does not have.
    pub dead_links: Vec<String>,
}

/// What the frames show, and what their consoles say.
#[derive(Debug, Clone)]
pub struct View {
    /// In the order of the frames.
    pub pages: Vec<Page>,
    pub console: Vec<String>,
}

/// The browser that there is: what `EECVS_BROWSER` names, which must run, or one of the usual names.
pub fn find() -> Option<String> {
    if let Ok(named) = std::env::var("EECVS_BROWSER") {
        return Some(named);
    }
    let is_there = |name: &&'static str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    NAMES.into_iter().find(is_there).map(str::to_owned)
}

/// Opens pages, each as wide as it says.
///
/// # Panics
/// Where the browser does not do its work: that is no fault of the page.
pub fn view(browser: &str, pages: &[(String, u32)]) -> View {
    let folder = tempfile::tempdir().unwrap();
    let around = folder.path().join("around.html");
    fs::write(&around, frames(pages)).unwrap();
    let (dom, log) = run(browser, folder.path(), &around);
    let (_, json) = dom.split_once("<pre id=\"measures\">").unwrap_or_else(|| {
        panic!("{browser} has no measures:\n{dom}\n{log}");
    });
    let (json, _) = json.split_once("</pre>").unwrap();
    let seen: Vec<Page> = serde_json::from_str(json)
        .unwrap_or_else(|error| panic!("{browser}: {error}: {json}\n{log}"));
    assert_eq!(seen.len(), pages.len());
    for (page, (_, width)) in seen.iter().zip(pages) {
        assert_eq!(page.width, f64::from(*width), "width of a frame");
    }
    View {
        pages: seen,
        console: log
            .lines()
            .filter(|line| line.contains(CONSOLE))
            .map(str::to_owned)
            .collect(),
    }
}

/// The page around the frames.
fn frames(pages: &[(String, u32)]) -> String {
    let frame = |(html, width): &(String, u32)| {
        let inside = html.replace('&', "&amp;").replace('"', "&quot;");
        format!(
            "<iframe style=\"border: 0; width: {width}px; height: 800px\" srcdoc=\"{inside}\"></iframe>\n"
        )
    };
    format!(
        "<!doctype html>\n<meta charset=\"utf-8\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <pre id=\"measures\"></pre>\n<script>\n{SCRIPT}</script>\n{}",
        pages.iter().map(frame).collect::<String>()
    )
}

/// Runs the browser on a file: the page as it is after its scripts, and what the browser logs.
fn run(browser: &str, folder: &Path, file: &Path) -> (String, String) {
    let [dom, log] = ["dom", "log"].map(|name| folder.join(name));
    let mut child = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
            // Their width is not the page's.
            "--hide-scrollbars",
            "--enable-logging=stderr",
            "--v=0",
            "--window-size=1400,900",
            "--dump-dom",
        ])
        .arg(format!("--user-data-dir={}", folder.join("user").display()))
        .arg(format!("file://{}", file.display()))
        .stdin(Stdio::null())
        .stdout(File::create(&dom).unwrap())
        .stderr(File::create(&log).unwrap())
        .spawn()
        .unwrap_or_else(|error| panic!("{browser}: {error}"));
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break Some(status);
        }
        if started.elapsed() > TIMEOUT {
            child.kill().unwrap();
            child.wait().unwrap();
            break None;
        }
        thread::sleep(Duration::from_millis(20));
    };
    let text = |path| String::from_utf8_lossy(&fs::read(path).unwrap()).into_owned();
    let (dom, log) = (text(&dom), text(&log));
    let Some(status) = status else {
        panic!("{browser} was ended after {TIMEOUT:?}:\n{log}");
    };
    assert!(status.success(), "{browser}: {status}:\n{log}");
    (dom, log)
}

impl Page {
    /// Everything that no page should have, a line each; `letter_px` is the height of the letters of
    /// images, in their own pixels.
    pub fn faults(&self, letter_px: f64) -> Vec<String> {
        let mut faults = Vec::new();
        if self.scroll_width > self.width {
            faults.push(format!("the page is {} wide", self.scroll_width));
        }
        for table in &self.tables {
            let Table { title, .. } = table;
            if table.rows == 0 || table.head == 0 || table.empty_cells > 0 {
                faults.push(format!("table {title}: no rows, or cells without text"));
            }
            if !(table.width > 0.0 && table.height > 0.0) {
                faults.push(format!("table {title}: has no size"));
            }
        }
        for picture in &self.pictures {
            let Picture { kind, caption, .. } = picture;
            if !(picture.width > 0.0 && picture.height > 0.0) {
                faults.push(format!("{kind} {caption}: has no size"));
            }
            if !picture.is_decoded {
                faults.push(format!("{kind} {caption}: is not decoded"));
            }
            if picture.colours < 2 {
                faults.push(format!("{kind} {caption}: is empty"));
            }
            let letters = letter_px * picture.width / picture.natural_width;
            if kind == "img" && letters < CHART_TEXT_PX {
                faults.push(format!("{kind} {caption}: letters of {letters:.1} px"));
            }
            // Scaled alike both ways.
            let ratio =
                picture.width * picture.natural_height / (picture.height * picture.natural_width);
            if (ratio - 1.0).abs() > 0.02 {
                faults.push(format!("{kind} {caption}: is distorted"));
            }
        }
        for (least, allowed) in [
            (&self.least_text, TEXT_PX),
            (&self.least_chart_text, CHART_TEXT_PX),
        ] {
            if let Some(Least { px, text }) = least.as_ref().filter(|least| least.px < allowed) {
                faults.push(format!("letters of {px:.1} px: {text}"));
            }
        }
        for (what, which) in [
            ("cut off", &self.cut_texts),
            ("out of reach", &self.spilling_texts),
            ("outside of the page", &self.addresses),
            ("no such place", &self.dead_links),
        ] {
            faults.extend(which.iter().map(|text| format!("{what}: {text}")));
        }
        faults
    }
}
