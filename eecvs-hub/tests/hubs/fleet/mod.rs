//! A fleet with keys of its own, on this computer: hubs, sensors and receivers in one process.
#![allow(missing_docs)]

use std::collections::BTreeMap;
use std::net::{TcpListener, TcpStream};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use eecvs::encode::{Limits, encode};
use eecvs_hub::access::{Access, Role};
use eecvs_hub::certificate::Authority;
use eecvs_hub::clock::Clock;
use eecvs_hub::downlink::{self, Downlink};
use eecvs_hub::hub::{self, Hub};
use eecvs_hub::link::Links;
use eecvs_hub::store::disk::Settings;
use eecvs_hub::uplink::{self, Uplink};
use eecvs_nostd::{
    Coder, Config, Density, Fidelity, Hybrid, Mode, Sensor, Thresholds, WindowConfig,
};
use event_emulator::{Preset, SceneConfig, emulate};

/// How frames are kept on disk.
const SETTINGS: Settings = Settings {
    bytes_max: 64 << 20,
    sync_ms: 100,
};

/// Longest wait for what has to happen; a machine may be busy.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Waits until something is so.
pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let started = Instant::now();
    while !is_so() {
        assert!(
            started.elapsed() < PATIENCE,
            "not within {PATIENCE:?}: {what}"
        );
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A port that nobody has at the moment.
pub fn port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

pub struct Fleet {
    pub folder: tempfile::TempDir,
    pub ports: Vec<u16>,
}

impl Fleet {
    /// Of hubs `h0`, `h1`, ..., sensors, and receivers with what they hear.
    pub fn new(hubs: usize, sensors: &[&str], receivers: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::open(folder.path(), 1).unwrap();
        let host = ["127.0.0.1".to_owned()];
        for number in 0..hubs {
            authority
                .sign(&Role::Hub(format!("h{number}")), &host, &[], 1)
                .unwrap();
        }
        for name in sensors {
            authority
                .sign(&Role::Sensor(name.parse().unwrap()), &[], &[], 1)
                .unwrap();
        }
        for (name, hears) in receivers {
            let hears = [(*hears).to_owned()];
            authority
                .sign(&Role::Receiver((*name).to_owned()), &[], &hears, 1)
                .unwrap();
        }
        Self {
            folder,
            ports: (0..hubs).map(|_| port()).collect(),
        }
    }

    pub fn keys(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn endpoint(&self, hub: usize) -> String {
        format!("tls/127.0.0.1:{}", self.ports[hub])
    }

    /// Starts a hub, which connects to others; with what is said of it.
    pub fn hub_with(&self, hub: usize, connect: &[usize], options: hub::Options) -> Hub {
        let links = Links {
            connect: connect.iter().map(|hub| self.endpoint(*hub)).collect(),
            listen: vec![self.endpoint(hub)],
            keys: Some(self.keys(&format!("hub-h{hub}"))),
        };
        let options = hub::Options {
            name: format!("h{hub}"),
            access: Some(Access::read(self.folder.path()).unwrap()),
            ..options
        };
        Hub::start(options, &links, None).unwrap()
    }

    pub fn hub(&self, hub: usize, connect: &[usize]) -> Hub {
        let options = hub::Options {
            watch: Some("**".to_owned()),
            ..hub::Options::default()
        };
        self.hub_with(hub, connect, options)
    }

    /// Links of a client of a hub, with the keys of a folder.
    pub fn links(&self, hub: usize, keys: &str) -> Links {
        Links {
            connect: vec![self.endpoint(hub)],
            listen: Vec::new(),
            keys: Some(self.keys(keys)),
        }
    }

    pub fn sensor(&self, hub: usize, name: &str, keys: &str, store: Option<&Path>) -> Uplink {
        self.sensor_with(hub, name, keys, store, Clock::start())
    }

    /// Starts a sensor whose computer has this clock.
    pub fn sensor_with(
        &self,
        hub: usize,
        name: &str,
        keys: &str,
        store: Option<&Path>,
        clock: Clock,
    ) -> Uplink {
        let options = uplink::Options {
            name: name.parse().unwrap(),
            sensor: SENSOR,
            memory_bytes: 1 << 20,
            disk: store.map(|folder| (folder.to_owned(), SETTINGS)),
            bytes_per_second: None,
            clock,
        };
        Uplink::start(&options, &self.links(hub, keys)).unwrap()
    }

    pub fn receiver(&self, hub: usize, keys: &str, names: &str) -> Receiver {
        let options = downlink::Options {
            names: vec![names.to_owned()],
            ..downlink::Options::default()
        };
        self.receiver_with(hub, keys, options)
    }

    pub fn receiver_with(&self, hub: usize, keys: &str, options: downlink::Options) -> Receiver {
        let came: Arc<Mutex<Came>> = Arc::default();
        let own = Arc::clone(&came);
        let deliver = move |delivered: downlink::Delivered<'_>| {
            let mut came = own.lock().unwrap();
            let name = match delivered.lane {
                0 => delivered.name.to_string(),
                lane => format!("{}~{}", delivered.name, lane + 1),
            };
            let of = came.entry(name).or_default();
            of.push((delivered.stamp.number, delivered.frame.to_vec()));
            Ok(())
        };
        let downlink = Downlink::start(options, &self.links(hub, keys), Box::new(deliver)).unwrap();
        Receiver { downlink, came }
    }
}

/// Numbers and frames, by name; `NAME~2` is the second sensor of a name.
pub type Came = BTreeMap<String, Vec<(u64, Vec<u8>)>>;

pub struct Receiver {
    pub downlink: Downlink,
    pub came: Arc<Mutex<Came>>,
}

impl Receiver {
    pub fn count(&self, name: &str) -> usize {
        self.came.lock().unwrap().get(name).map_or(0, Vec::len)
    }

    pub fn connected(&self) {
        until("a receiver is connected", || self.downlink.is_connected());
    }
}

pub const SENSOR: Sensor = match Sensor::new(64, 48) {
    Some(sensor) => sensor,
    None => panic!("a size"),
};

/// Frames of a scene, in windows of 2 ms.
pub fn frames(duration_us: u64, coder: Coder) -> Vec<Vec<u8>> {
    let mut config = SceneConfig::model_1(Preset::IndoorFlying, 1);
    config.sensor = SENSOR;
    config.duration_us = duration_us;
    let mut scene = emulate(config).unwrap();
    let mode = Mode::Hybrid(Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    });
    let window = WindowConfig::new(SENSOR, 2000);
    let thresholds = Thresholds::new(Density::PICO, 2 * Density::PICO).unwrap();
    let config = Config::new(window, thresholds, mode);
    let mut frames = Pieces::default();
    encode(
        &mut scene,
        config,
        Limits::default(),
        NonZeroUsize::MIN,
        &mut frames,
        &mut |_| {},
    )
    .unwrap();
    frames.0
}

/// A frame in each write.
#[derive(Default)]
struct Pieces(Vec<Vec<u8>>);

impl std::io::Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.push(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Sends frames over and over, one each so often, for so long; how many.
pub fn send(uplink: &Uplink, frames: &[Vec<u8>], every: Duration, most: usize) {
    for number in 0..most {
        uplink
            .send(&frames[number % frames.len()], uplink.clock().now_us())
            .unwrap();
        std::thread::sleep(every);
    }
}

/// That all of a sensor's frames have come, each once, in order, as they were sent.
pub fn assert_all(receiver: &Receiver, name: &str, frames: &[Vec<u8>], count: usize) {
    let came = receiver.came.lock().unwrap();
    let came = &came[name];
    assert_eq!(came.len(), count, "{name}");
    for (at, (number, frame)) in came.iter().enumerate() {
        assert_eq!(*number, at as u64, "{name}");
        assert!(*frame == frames[at % frames.len()], "{name}: frame {at}");
    }
}

/// Bytes that are nothing, to an address.
pub fn garbage(address: &str, seed: u64) {
    use std::io::Write as _;
    let Ok(mut stream) = TcpStream::connect(address) else {
        return;
    };
    let mut state = seed | 1;
    let mut bytes = vec![0; 1 + (seed as usize * 977) % 70_000];
    for byte in &mut bytes {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        *byte = state as u8;
    }
    // A start of TLS or of Zenoh's own, every now and then.
    let start: &[u8] = match seed % 4 {
        0 => &[0x16, 3, 1, 2, 0],
        1 => &[0x05, 0, 1, 9],
        2 => &[0xff, 0xff],
        _ => &[],
    };
    bytes.splice(0..0, start.iter().copied());
    let _ = stream.write_all(&bytes);
    if seed.is_multiple_of(3) {
        // Some stay.
        std::thread::sleep(Duration::from_millis(50));
    }
}
