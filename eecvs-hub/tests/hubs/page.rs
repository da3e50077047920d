//! The page in a browser, as wide as a desk's and as a telephone's, of a hub with sensors in all states. Skipped, with a
//! notice, without Chromium; `EECVS_BROWSER` names one that must run. Pictures of the page are kept in the folder that
//! `EECVS_PAGE` names.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use eecvs_hub::board::{Board, HubFigures};
use eecvs_hub::message::{Events, Status, Stored};
use eecvs_nostd::{Coder, Fidelity, Frame, Mode};
use event_emulator::Preset;
use serde_json::{Value, json};

use crate::browser;
use crate::chromium::Browser;
use crate::feed::{Scene, Served, Way, answer_clock, events, name, scene, stamp};

/// What measures a page.
const MEASURE: &str = include_str!("../../../host-harness/tests/browser/measure.js");

/// Of a desk and of a telephone.
const WIDTHS: [u32; 2] = [1280, 390];

/// Least height of letters.
const LETTER_PX: f64 = 12.0;

/// A sensor of the test: its name, its scene, and what is the matter with it.
struct Cast {
    name: &'static str,
    preset: Preset,
    mode: Mode,
    what: What,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Well,
    Thinned,
    Ahead,
    Double,
    Missing,
    Damaged,
    Congested,
    Late,
    LetGo,
    Quiet,
    Gone,
    Silent,
}

/// The run of all sensors, by a clock that nothing is compared with.
const RUN: u64 = 1_700_000_000_000_000;

const EXACT: Mode = events(Coder::Fast, Fidelity::Lossless);
const DENSE: Mode = events(Coder::Dense, Fidelity::Lossless);

const fn cast(name: &'static str, preset: Preset, mode: Mode, what: What) -> Cast {
    Cast {
        name,
        preset,
        mode,
        what,
    }
}

/// In the order of their names.
const CAST: [Cast; 12] = [
    cast("drone/front", Preset::IndoorFlying, DENSE, What::Well),
    cast(
        "drone/rear",
        Preset::IndoorFlying,
        events(Coder::Fast, Fidelity::Bins(32)),
        What::Ahead,
    ),
    cast(
        "gate-1",
        Preset::OutdoorWellLitBlur,
        events(Coder::Dense, Fidelity::ToleranceUs(50)),
        What::Thinned,
    ),
    cast("gate-2", Preset::OutdoorLowBrightness, EXACT, What::Quiet),
    cast(
        "hall-1/door/left",
        Preset::IndoorHdrBlur,
        EXACT,
        What::Missing,
    ),
    cast(
        "hall-1/door/right",
        Preset::IndoorDarkHdr,
        EXACT,
        What::Damaged,
    ),
    cast(
        "hall-2/ceiling",
        Preset::IndoorDarkBlur,
        Mode::Coefficients(Coder::Fast),
        What::Late,
    ),
    cast("motorcycle", Preset::Motorcycle, EXACT, What::Congested),
    cast(
        "street/a-camera-with-a-rather-long-name_of-the-north-side",
        Preset::OutdoorDarkBlur,
        DENSE,
        What::LetGo,
    ),
    cast(
        "street/night",
        Preset::OutdoorDark,
        Mode::Transform,
        What::Double,
    ),
    cast("workshop/spare", Preset::OutdoorDark, EXACT, What::Silent),
    cast("yard", Preset::Motorcycle, EXACT, What::Gone),
];

/// Feeds a board with the cast, in a loop, until it is dropped.
struct Feeder {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Cast {
    fn scene(&self) -> Scene {
        let budget = (self.what == What::Thinned).then_some(150_000);
        scene(
            self.preset,
            Way {
                window_us: 20_000,
                bytes_per_second: budget,
                ..Way::of(self.mode)
            },
        )
    }

    fn status(&self, next: u64) -> Status {
        let is = |what| self.what == what;
        let many = |is: bool, count| if is { count } else { 0 };
        Status {
            run: RUN,
            next,
            width: 346,
            height: 260,
            up_us: 7_260_000_000,
            events: Events {
                late: many(is(What::Late), 1234),
                filtered: many(is(What::Late), 99),
                dropped: many(is(What::Late), 17),
                thinned: many(is(What::Thinned), 400_000),
                ..Events::default()
            },
            budget: (is(What::Thinned) || is(What::Congested)).then_some(150_000),
            is_congested: is(What::Congested),
            outages: many(is(What::LetGo), 3),
            outages_us: many(is(What::LetGo), 754_000_000),
            stored: Stored {
                memory_bytes: 3_200_000,
                disk_bytes: many(is(What::LetGo), 1_250_000_000),
                let_go_frames: many(is(What::LetGo), 21),
                ..Stored::default()
            },
            ..Status::default()
        }
    }

    /// The frame of a step.
    fn feed(&self, board: &Board, scene: &Scene, step: u64) {
        let cam = name(self.name);
        let stops = matches!(self.what, What::Quiet | What::Gone) && step > 10;
        if self.what == What::Silent || stops {
            return;
        }
        if self.what == What::Missing && step % 7 == 3 {
            return;
        }
        // A scene begins with a frame that decodes by itself.
        let mut frame = scene.frames[step as usize % scene.frames.len()].clone();
        if self.what == What::Damaged && step == 5 {
            frame[40] ^= 1;
        }
        let ahead_us = if self.what == What::Ahead {
            7_250_000
        } else {
            0
        };
        let ago_us = 3_000 + step as i64 % 10 * 500 - ahead_us;
        board.frame(&cam, stamp(RUN, step, ago_us), &frame);
        if step.is_multiple_of(25) {
            answer_clock(board, &cam, RUN, ahead_us);
        }
    }
}

impl Feeder {
    fn new(board: &Arc<Board>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (board, wish) = (Arc::clone(board), Arc::clone(&stop));
        let scenes: Vec<Scene> = CAST.iter().map(Cast::scene).collect();
        let thread = thread::spawn(move || {
            let mut step = 0_u64;
            while !wish.load(Ordering::Relaxed) {
                board.hub(HubFigures {
                    routers: 2,
                    receivers: 17,
                });
                for (cast, scene) in CAST.iter().zip(&scenes) {
                    if cast.what == What::Double && step.is_multiple_of(10) {
                        // Another one of this name, which began before the first.
                        let other = Status {
                            run: RUN + 1,
                            up_us: 8_000_000_000 + 20_000 * step,
                            ..cast.status(0)
                        };
                        board.status(&name(cast.name), other);
                    }
                    cast.feed(&board, scene, step);
                    if step.is_multiple_of(25) && cast.what != What::Silent {
                        board.status(
                            &name(cast.name),
                            cast.status(if cast.what == What::Missing { step } else { 0 }),
                        );
                    }
                    board.alive(&name(cast.name), cast.what != What::Gone);
                }
                step += 1;
                thread::sleep(Duration::from_millis(20));
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Feeder {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

fn keep(browser: &mut Browser, file: &str) {
    if let Ok(folder) = std::env::var("EECVS_PAGE") {
        browser.save(&PathBuf::from(folder).join(file));
    }
}

/// All that is wrong with the page as it is, beside what it fetches from the hub itself.
fn faults(browser: &mut Browser, origin: &str) -> Vec<String> {
    let script = format!(
        "(() => {{ {MEASURE}\n window.onload = null; return page({{ contentDocument: document }}) }})()"
    );
    let page: browser::Page = serde_json::from_value(browser.run(&script)).unwrap();
    let own = [
        format!("outside of the page: {origin}/"),
        "outside of the page: src=/picture/".to_owned(),
    ];
    // Sensors' pictures have no letters.
    let all = page.faults(1000.0).into_iter();
    all.filter(|fault| !own.iter().any(|own| fault.starts_with(own)))
        .collect()
}

/// Texts of the cards that are shown, by the classes and names of their parts.
const CARDS: &str = "[...document.querySelectorAll('#cards > li')].filter(item => !item.hidden).map(item => ({
    name: item.querySelector('h2').textContent, state: item.querySelector('.state').textContent,
    alt: item.querySelector('img').alt, picture: !item.querySelector('img').hidden, mix: [...item.querySelectorAll('.mix span')].filter(part => !part.hidden).map(part => part.textContent).join(' '),
    ...Object.fromEntries([...item.querySelectorAll('[data-of]')].map(of => [of.dataset.of, of.textContent])) }))";

/// Goes through the page from the top, so that every card was in view for a while.
fn scroll_through(browser: &mut Browser) {
    let height = browser
        .run("document.documentElement.scrollHeight")
        .as_u64()
        .unwrap();
    for top in (0..height).step_by(800) {
        browser.run(&format!("scrollTo(0, {top})"));
        thread::sleep(Duration::from_millis(1200));
    }
    browser.run("scrollTo(0, 0)");
}

fn text<'v>(card: &'v Value, of: &str) -> &'v str {
    card[of].as_str().unwrap()
}

fn check_cards(cards: &[Value]) {
    let names: Vec<&str> = cards.iter().map(|card| text(card, "name")).collect();
    assert_eq!(names, CAST.map(|cast| cast.name));
    for (cast, card) in CAST.iter().zip(cards) {
        let has = |of: &str, part: &str| {
            assert!(
                text(card, of).contains(part),
                "{}: {part} is not in {card:#}",
                cast.name
            );
        };
        let is_live = !matches!(cast.what, What::Quiet | What::Gone | What::Silent);
        has("alt", cast.name);
        match cast.what {
            What::Gone => has("state", "not connected"),
            What::Quiet => has("state", "quiet for"),
            What::Silent => has("state", "no frames yet"),
            What::Double => has("state", "2 sensors with this name"),
            _ => has("state", "● connected"),
        }
        if is_live {
            assert_eq!(card["picture"], json!(true), "{}", cast.name);
            for of in ["events", "bits"] {
                let shown: f64 = text(card, of)
                    .trim_end_matches([' ', 'k', 'M'])
                    .parse()
                    .unwrap();
                assert!(shown > 0.0, "{card:#}");
            }
            has("sensor", "346 × 260");
            if cast.what != What::Double {
                has("sensor", "up 2 h 1 min");
            }
            let most = if cast.preset == Preset::Motorcycle {
                "dense 100%"
            } else {
                "%"
            };
            has("mix", most);
            has("window", "/s");
            has("density", " events/pixel s");
        }
        match cast.mode {
            _ if cast.what == What::Silent => has("times", "–"),
            Mode::Transform => has("times", "16 coefficients a pixel, plain coder"),
            Mode::Coefficients(_) => has("times", "16 coefficients a pixel, fast coder"),
            mode if mode == DENSE => has("times", "exact, dense coder"),
            mode if mode == EXACT => has("times", "exact, fast coder"),
            _ if cast.what == What::Thinned => has("times", ", dense coder, thinned by"),
            _ => has("times", "in 32 bins, fast coder"),
        }
        match cast.what {
            What::Ahead => {
                has("latency", " ms, p99 ");
                has("latency", "; its clock is 7.25 s ahead");
            }
            _ if is_live => has("latency", " ms, p99 "),
            _ => {}
        }
        match cast.what {
            What::Missing => has("frames", " missing"),
            What::Damaged => has("frames", "1 damaged"),
            What::LetGo => has("frames", "21 dropped by its store"),
            _ => has("frames", "all here"),
        }
        match cast.what {
            What::Late => has("lost", "1,234 late, 17 dropped, 99 filtered"),
            What::Thinned => has("lost", "400,000 thinned"),
            What::Silent => has("lost", "unknown"),
            _ => has("lost", "none"),
        }
        has(
            "outages",
            if cast.what == What::LetGo {
                "3, 13 min in all"
            } else {
                "none"
            },
        );
        match cast.what {
            What::Congested => has("budget", "150 kB/s, link congested"),
            What::Thinned => has("budget", "150 kB/s"),
            _ => has("budget", "none"),
        }
        match cast.what {
            What::LetGo => has("store", "3.20 MB, disk 1.25 GB"),
            What::Silent => has("store", "unknown"),
            _ => has("store", "3.20 MB, disk 0 B"),
        }
    }
}

#[test]
fn the_page_is_whole_at_both_widths() {
    let Some(program) = browser::find() else {
        eprintln!("skipped: there is no chromium");
        return;
    };
    let board = Arc::new(Board::new("conference <b>hall</b>"));
    let _feeder = Feeder::new(&board);
    let mut served = Served::new(&board);
    let origin = format!("http://{}", served.address);
    let mut browser = Browser::start(&program);
    // Sensors that have stopped are said to be quiet.
    thread::sleep(Duration::from_secs(6));
    for (width, is_dark) in WIDTHS
        .iter()
        .flat_map(|width| [(*width, true), (*width, false)])
    {
        browser.open(&origin, width, is_dark);
        browser.wait("document.querySelectorAll('#cards > li').length === 12");
        scroll_through(&mut browser);
        // A picture that is being exchanged is none for a moment.
        let started = Instant::now();
        let mut found = faults(&mut browser, &origin);
        while !found.iter().all(|fault| is_of_hidden(fault))
            && started.elapsed() < Duration::from_secs(5)
        {
            thread::sleep(Duration::from_millis(70));
            found = faults(&mut browser, &origin);
        }
        found.retain(|fault| !is_of_hidden(fault));
        assert_eq!(found, [""; 0], "at {width}");
        let least = "Math.min(...[...document.querySelectorAll('body *')].filter(e => e.textContent.trim() && !['SCRIPT', 'STYLE'].includes(e.tagName)).map(e => parseFloat(getComputedStyle(e).fontSize)))";
        let least = browser.run(least).as_f64().unwrap();
        assert!(least >= LETTER_PX, "letters of {least} px");
        let cards = browser.run(CARDS);
        check_cards(cards.as_array().unwrap());
        let title = browser.run("[document.title, document.getElementById('hub').textContent, document.querySelectorAll('#hub *').length]");
        assert_eq!(
            title,
            json!([
                "EECVS hub conference <b>hall</b>",
                "conference <b>hall</b>",
                0
            ])
        );
        let summary = browser.run("['connected', 'known', 'routers', 'receivers', 'said'].map(id => document.getElementById(id).textContent)");
        assert_eq!(
            summary,
            json!(["11", "of 12 known", "2", "receivers linked: 17", "● live"])
        );
        for of in ["events", "bytes", "missing"] {
            let shown = browser.run(&format!("document.getElementById('{of}').textContent"));
            assert!(
                shown
                    .as_str()
                    .unwrap()
                    .starts_with(|c: char| c.is_ascii_digit() && c != '0'),
                "{of}: {shown}"
            );
        }
        keep(
            &mut browser,
            &format!("hub-{width}{}.png", if is_dark { "-dark" } else { "" }),
        );
        println!("at {width}: 12 cards, letters of {least:.1} px or more");
    }
    assert_eq!(browser.console, [""; 0]);
    filters_and_orders(&mut browser);
    assert_eq!(browser.console, [""; 0]);
    served.stop();
    browser.wait(
        "document.getElementById('said').textContent.startsWith('The hub has not answered for')",
    );
    keep(&mut browser, "hub-stopped.png");
}

/// Sensors without frames have an image without a picture, which is hidden.
fn is_of_hidden(fault: &str) -> bool {
    ["has no size", "is not decoded", "is empty"]
        .iter()
        .any(|what| fault == format!("img : {what}"))
}

fn filters_and_orders(browser: &mut Browser) {
    let names = |browser: &mut Browser| -> Vec<String> {
        let cards = browser.run(CARDS);
        cards
            .as_array()
            .unwrap()
            .iter()
            .map(|card| text(card, "name").to_owned())
            .collect()
    };
    browser.run("document.getElementById('filter').focus()");
    browser.tell("Input.insertText", &json!({ "text": "DOOR" }));
    assert_eq!(names(browser), ["hall-1/door/left", "hall-1/door/right"]);
    assert_eq!(
        browser.run("document.getElementById('count').textContent"),
        json!("2 of 12 shown")
    );
    browser.tell("Input.insertText", &json!({ "text": "<i>" }));
    assert_eq!(names(browser), [""; 0]);
    assert_eq!(
        browser.run("document.getElementById('none').textContent"),
        json!("No name contains “door<i>”.")
    );
    browser.run("document.getElementById('filter').value = ''; document.getElementById('filter').dispatchEvent(new Event('input'))");
    assert_eq!(names(browser).len(), 12);
    let mut choose = |by: &str| {
        let set = format!(
            "document.getElementById('order').value = '{by}'; document.getElementById('order').dispatchEvent(new Event('change'))"
        );
        browser.run(&set);
        names(browser)
    };
    let by_losses = choose("losses");
    assert_eq!(by_losses[..2], ["gate-1", "hall-2/ceiling"]);
    let by_rate = choose("rate");
    let last: Vec<_> = by_rate[9..].iter().map(String::as_str).collect();
    assert_eq!(last, ["gate-2", "workshop/spare", "yard"]);
    assert_ne!(by_rate[..9], choose("name")[..9]);
}

#[test]
fn a_thousand_sensors_do_not_make_it_crawl() {
    let Some(program) = browser::find() else {
        eprintln!("skipped: there is no chromium");
        return;
    };
    let board = Arc::new(Board::new("hall"));
    let scene = scene(Preset::OutdoorDark, Way::of(EXACT));
    let feed = |step: u64| {
        for number in 0..1000 {
            let cam = name(&format!("row-{:02}/camera-{number}", number / 25));
            board.frame(
                &cam,
                stamp(1, step, 2_000),
                &scene.frames[step as usize % scene.frames.len()],
            );
        }
    };
    feed(0);
    let served = Served::new(&board);
    let mut browser = Browser::start(&program);
    browser.open(&format!("http://{}", served.address), 1280, false);
    browser.wait("document.querySelectorAll('#cards > li').length === 1000");
    browser.run("document.getElementById('order').value = 'rate'; drawnMs.length = 0; window.frames_ms = []; let was = performance.now(); \
        const next = now => { frames_ms.push(now - was); was = now; requestAnimationFrame(next) }; requestAnimationFrame(next)");
    for step in 1..80 {
        feed(step);
        thread::sleep(Duration::from_millis(100));
    }
    let seen = browser
        .run("({ updates: drawnMs, longest: Math.max(...frames_ms.slice(5)), cards: seen.size })");
    println!("1,000 sensors: {seen}");
    let updates: Vec<f64> = seen["updates"]
        .as_array()
        .unwrap()
        .iter()
        .map(|ms| ms.as_f64().unwrap())
        .collect();
    assert!(updates.len() >= 4, "{updates:?}");
    let mean = updates.iter().sum::<f64>() / updates.len() as f64;
    println!(
        "an update took {mean:.1} ms in the mean, {:.1} at the most",
        updates.iter().copied().fold(0.0, f64::max)
    );
    // Of a second; measured on whatever else the machine does.
    assert!(mean < 100.0, "{updates:?}");
    assert!(seen["cards"].as_u64().unwrap() < 100);
    assert_eq!(browser.console, [""; 0]);
    let all = Frame::parse(&scene.frames[0]).unwrap().header;
    assert!(all.events > 0);
}
