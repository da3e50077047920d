//! Windows to frames, and frames to the link: `main`'s side.

use eecvs_nostd::event_link::{Kind, Packet, Setup, Status};
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::{Counts, Work};
use eecvs_nostd::{
    Config, Filter, KEY_WINDOWS, Mode, Quantiser, Scratch, Sensor, Thresholds, Window,
    WindowBuffers, WindowConfig, WindowEncoder,
};

use static_cell::ConstStaticCell;

use crate::board::{self, Sender};
use crate::clock::{Stopwatch, interrupt_ticks, nanoseconds};
use crate::receiving;
use crate::stack;

/// Windows in turn.
const WINDOWS: usize = 2;
/// Memory of all windows in words: memory.x has its budget.
const WINDOW_WORDS: usize = 22 * 1024;
/// Numbers of the largest grid: any M up to 64 at its default grid.
const NUMBERS: usize = 256;
/// Largest frame.
const FRAME_BYTES: usize = 4096;

/// What runs before the first setup: never used on events.
const IDLE: Config = Config {
    window: WindowConfig {
        sensor: Sensor {
            width: 1,
            height: 1,
        },
        window_us: 1,
    },
    thresholds: Thresholds::new(0, 0).unwrap(),
    transform: None,
    m: 1,
    grid: None,
    quantiser: Quantiser::DEFAULT,
    mode: Mode::Transform,
    key_windows: KEY_WINDOWS,
    readout: None,
    filter: Filter::NONE,
    bytes_per_second: None,
};

/// Ticks, summed up beyond 32 bits.
#[derive(Default)]
struct Total {
    ticks: u64,
}

impl Total {
    fn add(&mut self, ticks: u32) {
        self.ticks = self.ticks.wrapping_add(u64::from(ticks));
    }

    fn ns(&self) -> u64 {
        nanoseconds(self.ticks)
    }
}

/// The encoder and what it has done.
pub struct Encoding {
    sender: Sender,
    encoder: WindowEncoder<'static>,
    out: &'static mut [u8; FRAME_BYTES],
    window_events: usize,
    running: bool,
    windows: u32,
    frames: u32,
    receive: Total,
    interrupts_seen: u32,
    encode: Total,
    send: Total,
}

impl Encoding {
    /// The encoder before its first setup. `None` when called again.
    #[inline(never)]
    pub fn new(sender: Sender) -> Option<Self> {
        static SUMS: ConstStaticCell<[Sum; NUMBERS]> = ConstStaticCell::new([Sum::ZERO; NUMBERS]);
        static TOTALS: ConstStaticCell<[WideSum; NUMBERS]> =
            ConstStaticCell::new([WideSum::ZERO; NUMBERS]);
        static MAGNITUDES: ConstStaticCell<[u32; NUMBERS]> = ConstStaticCell::new([0; NUMBERS]);
        static OUT: ConstStaticCell<[u8; FRAME_BYTES]> = ConstStaticCell::new([0; FRAME_BYTES]);
        let scratch = Scratch {
            sums: SUMS.try_take()?,
            totals: TOTALS.try_take()?,
            magnitudes: MAGNITUDES.try_take()?,
            dense: None,
            coefficients: None,
            hot: &[],
        };
        Some(Self {
            sender,
            encoder: WindowEncoder::new(IDLE, scratch).ok()?,
            out: OUT.try_take()?,
            window_events: 0,
            running: false,
            windows: 0,
            frames: 0,
            receive: Total::default(),
            interrupts_seen: 0,
            encode: Total::default(),
            send: Total::default(),
        })
    }

    /// Tells the host that the encoder has started.
    pub fn greet(&mut self) {
        self.send_status(0, Counts::default());
    }

    /// Does one piece of work, or sleeps where there is none.
    pub fn work(&mut self) {
        let interrupts = interrupt_ticks();
        self.receive
            .add(interrupts.wrapping_sub(self.interrupts_seen));
        self.interrupts_seen = interrupts;
        match receiving::work() {
            Some(Work::Window(window)) => self.encode(window),
            Some(Work::Setup(setup, counts)) => {
                self.set_up(&setup);
                self.send_status(Kind::Setup as u8, counts);
            }
            Some(Work::Flush(counts)) => {
                defmt::info!(
                    "{=u32} windows in {=u32} frames; {}",
                    self.windows,
                    self.frames,
                    counts
                );
                self.send_status(Kind::Flush as u8, counts);
            }
            None => receiving::wait(),
        }
    }

    fn encode(&mut self, mut window: Window<'static>) {
        self.windows = self.windows.wrapping_add(u32::from(window.events() > 0));
        loop {
            let stopwatch = Stopwatch::start();
            let frame = self.encoder.next_frame(&mut window, self.out);
            self.encode.add(stopwatch.stop());
            // The output is longer than the least that a frame takes.
            let Ok(Some(frame)) = frame else {
                break;
            };
            let stopwatch = Stopwatch::start();
            if let Some(bytes) = self.out.get(frame.range) {
                self.sender.send(bytes);
            }
            self.send.add(stopwatch.stop());
            self.frames = self.frames.wrapping_add(1);
            if frame.header.dropped > 0 {
                defmt::warn!("{=u32} events lost", frame.header.dropped);
            }
        }
        receiving::free(window);
    }

    fn set_up(&mut self, setup: &Setup) {
        self.running = false;
        self.window_events = 0;
        let mut windows = [const { None }; WINDOWS];
        if let Some(config) = setup.config()
            && self.encoder.set_up(config).is_ok()
            && let Some(shares) = window_buffers(config.window.sensor)
        {
            for (window, buffers) in windows.iter_mut().zip(shares) {
                self.window_events = buffers.slots.len();
                *window = Window::new(config.window, buffers);
            }
        }
        self.running = windows.iter().all(Option::is_some);
        if self.running {
            defmt::info!("{}: {=usize} events a window", setup, self.window_events);
            receiving::set_up(setup, WINDOWS);
            windows.into_iter().flatten().for_each(receiving::free);
        } else {
            self.window_events = 0;
            defmt::error!("refused: {}", setup);
            receiving::set_up(setup, 0);
        }
    }

    fn send_status(&mut self, answers: u8, counts: Counts) {
        let status = Status {
            answers,
            running: self.running,
            window_events: self.window_events as u32,
            frame_bytes: FRAME_BYTES as u32,
            events: counts.events,
            lost: counts.lost,
            dropped: counts.dropped,
            ignored: counts.ignored.wrapping_add(receiving::ignored()),
            damaged_bytes: receiving::damaged_bytes(),
            overruns: board::overruns(),
            windows: self.windows,
            frames: self.frames,
            receive_ns: self.receive.ns(),
            encode_ns: self.encode.ns(),
            send_ns: self.send.ns(),
            stack_bytes: stack::used_bytes(),
        };
        let mut body = [0; 96];
        let mut packet = [0; 128];
        let body = status.write(&mut body).ok().and_then(|len| body.get(..len));
        let packet = body.and_then(|body| {
            let status = Packet {
                kind: Kind::Status,
                position: counts.events,
                body,
            };
            let len = status.write(&mut packet).ok()?;
            packet.get(..len)
        });
        // There is room for the longest status.
        if let Some(packet) = packet {
            self.sender.send(packet);
        }
    }
}

/// The windows' memory, divided for a sensor; `None` where it is too small.
fn window_buffers(sensor: Sensor) -> Option<impl Iterator<Item = WindowBuffers<'static>>> {
    static mut MEMORY: [u32; WINDOW_WORDS] = [0; WINDOW_WORDS];
    // SAFETY: called on a setup only, by `main` alone, when every window made of this memory
    // before has come back and was dropped: `Ingest` hands a setup over only then.
    let memory = unsafe { (&raw mut MEMORY).as_mut() }?;
    WindowBuffers::share(memory, WINDOWS, sensor)
}
