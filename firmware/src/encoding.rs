//! Encodes windows to frames, and sends frames on the link: `main`'s side.

use eecvs_nostd::event_link::{FIELDS_BYTES_MAX, Kind, Packet, Refusal, Restart, Setup, Status};
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::{Counts, Work};
use eecvs_nostd::{
    Coder, Config, Fidelity, Filter, HotError, Hybrid, KEY_WINDOWS, Mode, Quantiser, Scratch,
    Sensor, Thresholds, Window, WindowBuffers, WindowConfig, WindowEncoder,
};

use static_cell::ConstStaticCell;

use crate::board::{self, Sender};
use crate::clock::{Stopwatch, interrupt_ticks, nanoseconds};
use crate::memory::{self, Shares, WINDOWS};
use crate::receiving;
use crate::{clock, fault, stack, watchdog};

/// Whether the image has all that a microcontroller can encode; a small one has the fast coder alone.
const IS_FULL: bool = cfg!(feature = "full");
/// Numbers for the largest grid: any M up to 64 at its default grid.
const NUMBERS: usize = if IS_FULL { 256 } else { 0 };
/// Most hot pixels.
const HOT_PIXELS: usize = if IS_FULL { 512 } else { 128 };

/// Configuration before the first setup; never used on events.
const IDLE: Config = Config {
    window: WindowConfig::new(
        Sensor {
            width: 1,
            height: 1,
        },
        1,
    ),
    thresholds: Thresholds::new(0, 0).unwrap(),
    transform: None,
    m: 1,
    grid: None,
    quantiser: Quantiser::DEFAULT,
    few_as_times: false,
    max_emd_us: None,
    mode: Mode::Hybrid(Hybrid {
        coder: Coder::Fast,
        fidelity: Fidelity::Lossless,
    }),
    key_windows: KEY_WINDOWS,
    readout: None,
    filter: Filter::NONE,
    bytes_per_second: None,
    keep_order: false,
};

/// Sum of ticks beyond 32 bits.
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

/// The encoder, and counts of what it has done.
pub struct Encoding {
    sender: Sender,
    restart: Option<Restart>,
    encoder: WindowEncoder<'static>,
    out: &'static mut [u8],
    window_events: usize,
    dense_words: usize,
    running: bool,
    refusal: Option<Refusal>,
    windows: u32,
    frames: u32,
    receive: Total,
    interrupts_seen: u32,
    encode: Total,
    send: Total,
}

impl Encoding {
    /// Sets up the board, the interrupts, the watchdog and the encoder, whose status says why it started again; called once,
    /// at the image's start.
    #[must_use]
    pub fn start(restart: Option<Restart>) -> Self {
        let encoding = cortex_m::Peripherals::take().and_then(|mut core| {
            let sender = board::set_up(&mut core)?;
            clock::start(&mut core.SYST);
            receiving::start(&mut core);
            board::start_watchdog();
            Self::new(sender, restart)
        });
        // Never reached: every part of the above exists once.
        encoding.unwrap_or_else(|| fault::stop())
    }

    /// Returns the encoder before its first setup; `None` on a second call.
    #[inline(never)]
    fn new(sender: Sender, restart: Option<Restart>) -> Option<Self> {
        static SUMS: ConstStaticCell<[Sum; NUMBERS]> = ConstStaticCell::new([Sum::ZERO; NUMBERS]);
        static TOTALS: ConstStaticCell<[WideSum; NUMBERS]> =
            ConstStaticCell::new([WideSum::ZERO; NUMBERS]);
        static MAGNITUDES: ConstStaticCell<[u32; NUMBERS]> = ConstStaticCell::new([0; NUMBERS]);
        static HOT: ConstStaticCell<[u32; HOT_PIXELS]> = ConstStaticCell::new([0; HOT_PIXELS]);
        let scratch = Scratch {
            sums: SUMS.try_take()?,
            totals: TOTALS.try_take()?,
            magnitudes: MAGNITUDES.try_take()?,
            dense: None,
            tree: None,
            keys: None,
            coefficients: None,
            hot: HOT.try_take()?,
            order: &mut [],
        };
        Some(Self {
            sender,
            restart,
            encoder: WindowEncoder::new(IDLE, scratch).ok()?,
            out: &mut [],
            window_events: 0,
            dense_words: 0,
            running: false,
            refusal: None,
            windows: 0,
            frames: 0,
            receive: Total::default(),
            interrupts_seen: 0,
            encode: Total::default(),
            send: Total::default(),
        })
    }

    /// Reports to the host that the encoder has started.
    pub fn greet(&mut self) {
        self.send_status(0, Counts::default());
    }

    /// Does one piece of work, or sleeps if there is none. Returns whether it answered a flush, the end of a stream.
    pub fn work(&mut self) -> bool {
        let interrupts = interrupt_ticks();
        self.receive
            .add(interrupts.wrapping_sub(self.interrupts_seen));
        self.interrupts_seen = interrupts;
        let work = receiving::work();
        // Without work, the other side waits for nothing, unless something broke.
        if work.is_some() || !receiving::is_stalled() {
            watchdog::feed();
        }
        match work {
            Some(Work::Window(window)) => self.encode(window),
            Some(Work::Setup(setup, counts)) => {
                self.sender.follow();
                self.set_up(&setup);
                self.send_status(Kind::Setup as u8, counts);
            }
            Some(Work::Hot(number)) => self.keep_out(number),
            Some(Work::HotEnd(counts)) => self.send_status(Kind::Hot as u8, counts),
            Some(Work::Flush(counts)) => {
                defmt::info!(
                    "{=u32} windows in {=u32} frames; {}",
                    self.windows,
                    self.frames,
                    counts
                );
                self.send_status(Kind::Flush as u8, counts);
                return true;
            }
            None => receiving::wait(),
        }
        false
    }

    fn encode(&mut self, mut window: Window<'static>) {
        self.windows = self.windows.wrapping_add(u32::from(window.events() > 0));
        loop {
            let stopwatch = Stopwatch::start();
            let frame = self.encoder.next_frame(&mut window, self.out);
            self.encode.add(stopwatch.stop());
            // Never an error: the output is longer than the shortest that an encoder takes.
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
        self.window_events = 0;
        self.dense_words = 0;
        let windows = self.divide(setup);
        self.running = windows.is_ok();
        self.refusal = windows.as_ref().err().copied();
        match windows {
            Ok(windows) => {
                defmt::info!("{}: {=usize} events per window", setup, self.window_events);
                receiving::set_up(setup, WINDOWS);
                windows.into_iter().flatten().for_each(receiving::free);
            }
            Err(refusal) => {
                self.window_events = 0;
                defmt::error!("setup refused, reason {}: {}", refusal, setup);
                receiving::set_up(setup, 0);
            }
        }
    }

    /// Divides the memory for a setup and sets up the encoder in it. All windows have come back before.
    fn divide(&mut self, setup: &Setup) -> Result<[Option<Window<'static>>; WINDOWS], Refusal> {
        self.encoder.lend_dense(None);
        self.out = &mut [];
        let config = setup.config()?;
        // SAFETY: every window has come back and was dropped, as `Ingest` hands over a setup only then; the encoder
        // and the output have just given up their parts.
        let shares = unsafe { memory::divide(&config) };
        let Shares {
            windows: memory,
            out,
            dense,
        } = shares.ok_or(Refusal::Dense)?;
        self.out = out;
        self.dense_words = dense.as_ref().map_or(0, |dense| dense.words.len());
        self.encoder.lend_dense(dense);
        self.encoder.set_up(config)?;
        let shares = WindowBuffers::share(memory, WINDOWS, &config.windows());
        let mut windows = [const { None }; WINDOWS];
        for (window, buffers) in windows.iter_mut().zip(shares.ok_or(Refusal::Windows)?) {
            self.window_events = buffers.slots.len();
            *window = Window::new(config.windows(), buffers);
        }
        if windows.iter().all(Option::is_some) {
            Ok(windows)
        } else {
            Err(Refusal::Windows)
        }
    }

    /// Keeps a pixel out of later windows; the first refusal is kept for the status.
    fn keep_out(&mut self, number: u32) {
        let added = if self.running {
            let sensor = self.encoder.config().window.sensor;
            let pixel = sensor.pixel(number).ok_or(HotError::Outside);
            pixel
                .and_then(|pixel| self.encoder.add_hot(pixel))
                .map_err(Refusal::from)
        } else {
            Err(Refusal::HotUnset)
        };
        self.refusal = self.refusal.or(added.err());
    }

    fn send_status(&mut self, answers: u8, counts: Counts) {
        let status = Status {
            answers,
            running: self.running,
            refusal: self.refusal,
            hot_pixels: self.encoder.hot_count() as u32,
            dense_words: self.dense_words as u32,
            window_events: self.window_events as u32,
            frame_bytes: self.out.len() as u32,
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
            restart: self.restart,
        };
        let mut body = [0; FIELDS_BYTES_MAX];
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
