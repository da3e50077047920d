//! Frames of emulated scenes, and boards that are fed with them and served.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use eecvs::encode::{Limits, encode};
use eecvs_bench::source::Source;
use eecvs_hub::board::{Board, page};
use eecvs_hub::clock::RoundTrip;
use eecvs_hub::key::Name;
use eecvs_hub::message::{Stamp, now_us};
use eecvs_nostd::{
    Coder, Config, Density, Fidelity, Frame, Hybrid, Mode, Thresholds, WindowConfig,
};
use event_emulator::Preset;
use usb_bridge::stop::Stop;

/// Events themselves, by a coder.
pub const fn events(coder: Coder, fidelity: Fidelity) -> Mode {
    Mode::Hybrid(Hybrid { coder, fidelity })
}

pub fn name(text: &str) -> Name {
    text.parse().unwrap()
}

/// A scene, and its frames, one by one.
pub struct Scene {
    pub source: Source,
    pub frames: Vec<Vec<u8>>,
}

/// What takes a frame in each write.
struct Frames(Vec<Vec<u8>>);

impl Write for Frames {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.push(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// How a scene is encoded.
#[derive(Clone, Copy)]
pub struct Way {
    pub mode: Mode,
    pub window_us: u32,
    pub frame_bytes: usize,
    pub bytes_per_second: Option<u32>,
}

impl Way {
    pub const fn of(mode: Mode) -> Self {
        Self {
            mode,
            window_us: 10_000,
            frame_bytes: 1 << 20,
            bytes_per_second: None,
        }
    }
}

pub fn scene(preset: Preset, way: Way) -> Scene {
    let source = Source::scene(preset, 7, 120_000).unwrap();
    let window = WindowConfig::new(source.sensor, way.window_us);
    let thresholds = Thresholds::new(Density::PICO / 2, 4 * Density::PICO).unwrap();
    let mut config = Config::new(window, thresholds, way.mode);
    config.key_windows = 4;
    config.bytes_per_second = way.bytes_per_second.and_then(std::num::NonZeroU32::new);
    let limits = Limits {
        frame_bytes: way.frame_bytes,
        ..Limits::default()
    };
    let mut frames = Frames(Vec::new());
    let mut reader = source.reader();
    encode(
        &mut reader,
        config,
        limits,
        NonZeroUsize::MIN,
        &mut frames,
        &mut |_| (),
    )
    .unwrap();
    assert!(frames.0.iter().all(|frame| Frame::parse(frame).is_ok()));
    Scene {
        source,
        frames: frames.0,
    }
}

/// Beside a frame whose window ended some time ago.
pub fn stamp(run: u64, number: u64, ago_us: i64) -> Stamp {
    Stamp {
        run,
        number,
        end_us: now_us().saturating_add_signed(-ago_us),
        up_us: 0,
    }
}

/// A run's clock, which is so far ahead, answers the hub.
pub fn answer_clock(board: &Board, name: &Name, run: u64, ahead_us: i64) {
    let answered_us = board.clock().now_us();
    let trip = RoundTrip {
        run,
        asked_us: answered_us - 200,
        shown_us: (answered_us - 100).saturating_add_signed(ahead_us),
        answered_us,
    };
    board.trip(name, trip);
}

/// A board that is served until it is dropped.
pub struct Served {
    pub address: SocketAddr,
    stop: Stop,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl Served {
    pub fn new(board: &Arc<Board>) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = listener.local_addr().unwrap();
        let stop = Stop::default();
        let (board, wish) = (Arc::clone(board), stop.clone());
        let thread = std::thread::spawn(move || page::serve(board, listener, wish));
        Self {
            address,
            stop,
            thread: Some(thread),
        }
    }

    pub fn stop(&mut self) {
        self.stop.ask();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap().unwrap();
        }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        stream
    }

    /// Status, head and body of the answer to a request, whose connection ends with it.
    pub fn ask(&self, request: &str) -> Answer {
        let mut stream = self.connect();
        stream.write_all(request.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        Answer::of(&bytes)
    }

    pub fn get(&self, path: &str) -> Answer {
        let host = self.address;
        self.ask(&format!(
            "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        ))
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.stop.ask();
    }
}

pub struct Answer {
    pub status: u16,
    pub head: String,
    pub body: Vec<u8>,
}

impl Answer {
    fn of(bytes: &[u8]) -> Self {
        let end = bytes
            .windows(4)
            .position(|four| four == b"\r\n\r\n")
            .expect("no head");
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Self {
            status,
            head: head.to_ascii_lowercase(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    pub fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }
}
