//! Counts instructions per stage on real windows, in QEMU: prints a line of JSON for each cut, transform and M.
//! `cargo xtask instructions` builds the cuts and runs this.
//!
//! With QEMU's `-icount shift=0` an instruction takes one nanosecond of virtual time, and its TIM2 runs at 1 GHz,
//! so the timer counts instructions. The image checks that first. These are instructions, not cycles: there are no
//! flash wait states and no pipeline.
//!
//! | figure | measured |
//! |---|---|
//! | `whole` | from the first word to the last byte of the last frame, nothing in between |
//! | `stages` | in another run, with a probe at every change of stage, less the probe's own cost |
#![no_std]
#![no_main]

use core::arch::asm;
use core::hint::black_box;
use core::num::NonZeroU32;

use cortex_m_rt::entry;
use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::hprintln;
use eecvs_firmware as _;
use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{self, DenseMemory};
use eecvs_nostd::evt2::Evt2Decoder;
use eecvs_nostd::{
    Coder, Config, Encoder, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, OUTPUT_BYTES_MIN,
    Quantiser, Sensor, SetupError, Stage, Storage, Thresholds, Trace, Transform, WindowConfig,
    bitmap_words, segments,
};
use stm32f4::stm32f405::{Peripherals, TIM2};

/// Events of the largest cut.
const EVENTS: usize = 8192;
const SENSOR_MAX: Sensor = Sensor {
    width: 640,
    height: 480,
};
/// Segments of the largest sensor.
const SEGMENTS: usize = segments(SENSOR_MAX.width, SENSOR_MAX.height);
/// 2K of the largest K.
const NUMBERS: usize = 64;

type Buffers = Storage<EVENTS, SEGMENTS, { bitmap_words(SEGMENTS) }, NUMBERS>;

static mut STORAGE: Buffers = Storage::new();
static mut OUT: [u8; 8192] = [0; 8192];
static mut MODEL: Model = Model::UNSET;
/// Without the window before, as in the encoder's image.
const DENSE_WORDS: usize = dense::words(SENSOR_MAX, false);
static mut WORDS: [u32; DENSE_WORDS] = [0; DENSE_WORDS];
const _: () = assert!(OUTPUT_BYTES_MIN <= 8192);

macro_rules! cut {
    ($origin:literal, $name:literal) => {
        (
            $origin,
            $name,
            include_bytes!(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/target/cuts/",
                $origin,
                "/",
                $name,
                ".words"
            )),
        )
    };
}

/// Origin, name and words of each cut; the words are empty if the recording was missing.
static CUTS: [(&str, &str, &[u8]); 6] = [
    cut!("recordings", "davis346"),
    cut!("recordings", "sparse"),
    cut!("recordings", "dense"),
    cut!("emulator", "moderate"),
    cut!("emulator", "sparse"),
    cut!("emulator", "dense"),
];

/// A cut: `tests/instructions/cuts.rs` has its layout.
#[derive(Clone, Copy)]
struct Cut {
    window: WindowConfig,
    events: u32,
    words: &'static [[u8; 4]],
}

impl Cut {
    fn parse(bytes: &'static [u8]) -> Option<Self> {
        let (words, []) = bytes.as_chunks::<4>() else {
            return None;
        };
        let ([width, height, window_us, events], words) = words.split_first_chunk::<4>()?;
        let side = |word: &[u8; 4]| u16::try_from(u32::from_le_bytes(*word)).ok();
        Some(Self {
            window: WindowConfig::new(
                Sensor::new(side(width)?, side(height)?)?,
                u32::from_le_bytes(*window_us),
            ),
            events: u32::from_le_bytes(*events),
            words,
        })
    }
}

/// Name of the runs whose pixels of few events are sent as times, after the transform's.
const FEW: &str = " few";
/// Name of the runs whose decoded times may be off by [`MEAN_US`] on average, after the coder's.
const MEAN: &str = " mean";
/// In microseconds.
const MEAN_US: Option<NonZeroU32> = NonZeroU32::new(128);

/// Name, transform, M (0 where it does not apply) and mode of every run.
const WAYS: [(&str, Transform, u8, Mode); 16] = [
    ("dct", Transform::Dct, 8, Mode::Transform),
    ("dct", Transform::Dct, 16, Mode::Transform),
    ("dtft", Transform::Dtft, 8, Mode::Transform),
    ("dtft", Transform::Dtft, 16, Mode::Transform),
    ("dwt", Transform::Dwt, 8, Mode::Transform),
    ("dwt", Transform::Dwt, 16, Mode::Transform),
    ("dct few", Transform::Dct, 8, Mode::Transform),
    ("dct few", Transform::Dct, 16, Mode::Transform),
    ("dtft few", Transform::Dtft, 8, Mode::Transform),
    ("dtft few", Transform::Dtft, 16, Mode::Transform),
    ("dwt few", Transform::Dwt, 8, Mode::Transform),
    ("dwt few", Transform::Dwt, 16, Mode::Transform),
    ("fast", Transform::Dct, 0, lossless(Coder::Fast)),
    ("dense", Transform::Dct, 0, lossless(Coder::Dense)),
    ("quick", Transform::Dct, 0, lossless(Coder::Quick)),
    ("fast mean", Transform::Dct, 0, lossless(Coder::Fast)),
];

const fn lossless(coder: Coder) -> Mode {
    Mode::Hybrid(Hybrid {
        coder,
        fidelity: Fidelity::Lossless,
    })
}

/// Returns the number of instructions so far; wraps at 2^32.
#[inline(always)]
fn instructions() -> u32 {
    // SAFETY: this reads a counter, which has no side effects.
    unsafe { &*TIM2::ptr() }.cnt().read().bits()
}

/// Adds up instructions by stage.
#[derive(Clone, Copy)]
struct Probe {
    stage: usize,
    since: u32,
    spent: [u32; Self::STAGES],
    calls: [u32; Self::STAGES],
}

impl Probe {
    /// Everything before the first stage counts as one more stage.
    const STAGES: usize = Stage::ALL.len() + 1;

    const fn new() -> Self {
        Self {
            stage: Stage::ALL.len(),
            since: 0,
            spent: [0; Self::STAGES],
            calls: [0; Self::STAGES],
        }
    }

    /// Returns what the probe measures for a stage without instructions.
    fn cost() -> u32 {
        let mut probe = Self::new();
        probe.enter(Stage::Frame);
        probe.enter(Stage::Pack);
        probe.spent[Stage::Frame as usize]
    }
}

impl Trace for Probe {
    // Never inlined, so that every call costs the same, whatever surrounds it.
    #[inline(never)]
    fn enter(&mut self, stage: Stage) {
        let spent = instructions().wrapping_sub(self.since);
        // The remainder serves as the bounds check.
        let before = self.stage % Self::STAGES;
        self.spent[before] = self.spent[before].wrapping_add(spent);
        self.calls[before] += 1;
        self.stage = stage as usize;
        self.since = instructions();
    }
}

/// Result of encoding a cut.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Output {
    windows: u32,
    frames: u32,
    pixels: u32,
    events: u32,
    bytes: u32,
    /// Checksum of the frames' own CRCs.
    check: u32,
}

impl Output {
    fn take<T: Trace>(&mut self, encoder: &mut Encoder<'_>, out: &mut [u8], trace: &mut T) {
        self.windows += 1;
        while let Ok(Some(encoded)) = encoder.next_frame_traced(out, trace) {
            self.frames += 1;
            self.pixels += encoded.header.pixels;
            self.events += encoded.header.events;
            self.bytes += encoded.range.len() as u32;
            let crc = out.get(encoded.range).and_then(|frame| frame.last_chunk());
            self.check = self.check.rotate_left(1) ^ crc.map_or(0, |crc| u32::from_le_bytes(*crc));
        }
    }
}

/// Measures the instructions and output of an encoder that is set up anew.
#[inline(never)]
fn measure<T: Trace>(
    config: Config,
    words: &[[u8; 4]],
    (storage, dense): (&mut Buffers, DenseMemory<'_>),
    out: &mut [u8],
    trace: &mut T,
) -> Option<(u32, Output)> {
    // Borrowed in place: if it were moved, it would be on the stack twice.
    let encoder = &mut set_up(config, storage, dense);
    let Ok(encoder) = encoder else {
        return None;
    };
    let before = instructions();
    let output = encode(words, encoder, out, trace);
    Some((instructions().wrapping_sub(before), output))
}

/// Separate, so that the copies made while an encoder is built leave the stack with this function.
#[inline(never)]
fn set_up<'b>(
    config: Config,
    storage: &'b mut Buffers,
    dense: DenseMemory<'b>,
) -> Result<Encoder<'b>, SetupError> {
    storage.encoder_with(config, Some(dense))
}

#[inline(never)]
fn encode<T: Trace>(
    words: &[[u8; 4]],
    encoder: &mut Encoder<'_>,
    out: &mut [u8],
    trace: &mut T,
) -> Output {
    let mut output = Output {
        windows: 0,
        frames: 0,
        pixels: 0,
        events: 0,
        bytes: 0,
        check: 0,
    };
    let mut decoder = Evt2Decoder::new(0);
    trace.enter(Stage::Ingest);
    let mut rest = words;
    loop {
        let taken = encoder.window().push_words(&mut decoder, rest);
        let Some(left) = rest.get(taken.words..).filter(|left| !left.is_empty()) else {
            break;
        };
        rest = left;
        output.take(encoder, out, trace);
        trace.enter(Stage::Ingest);
    }
    encoder.flush();
    output.take(encoder, out, trace);
    trace.enter(Stage::Ingest);
    output
}

/// Counts a loop with a known number of instructions: 2 * 1,000.
fn known_loop() -> u32 {
    let mut turns = 1000;
    let before = instructions();
    // SAFETY: this counts a register down and touches nothing else.
    unsafe {
        asm!("2:", "subs {0}, #1", "bne 2b", inout(reg) turns, options(nomem, nostack));
    }
    let after = instructions();
    black_box(turns);
    after.wrapping_sub(before)
}

#[entry]
fn main() -> ! {
    // SAFETY: `main` runs once, and nothing else uses these.
    #[allow(static_mut_refs)]
    let (storage, out, model, words) = unsafe { (&mut STORAGE, &mut OUT, &mut MODEL, &mut WORDS) };
    if let Some(peripherals) = Peripherals::take() {
        peripherals
            .RCC
            .apb1enr()
            .modify(|_, w| w.tim2en().enabled());
        peripherals.TIM2.cr1().modify(|_, w| w.cen().enabled());
    }
    let counted = known_loop();
    if !(2000..2010).contains(&counted) {
        hprintln!(
            "TIM2 counted {counted} for 2,000 instructions: does QEMU run with -icount shift=0?"
        );
        debug::exit(EXIT_FAILURE);
    }
    let cost = Probe::cost();
    let mut failed = false;
    for (origin, name, bytes) in CUTS {
        let Some(cut) = Cut::parse(bytes) else {
            continue;
        };
        // A hybrid frame does not say how many pixels it has: take the number from the transforms' frames.
        let mut pixels = 0;
        for (label, transform, m, mode) in WAYS {
            let config = Config {
                window: cut.window,
                thresholds: Thresholds::new(0, 0).unwrap(),
                transform: Some(transform),
                m: m.max(8),
                grid: None,
                quantiser: Quantiser::DEFAULT,
                few_as_times: label.ends_with(FEW),
                max_emd_us: MEAN_US.filter(|_| label.ends_with(MEAN)),
                mode,
                key_windows: KEY_WINDOWS,
                readout: None,
                filter: Filter::NONE,
                bytes_per_second: None,
                keep_order: false,
            };
            let mut probe = Probe::new();
            let dense = DenseMemory {
                model: &mut *model,
                words: &mut *words,
            };
            let whole = measure(config, cut.words, (storage, dense), out, &mut ());
            let dense = DenseMemory {
                model: &mut *model,
                words: &mut *words,
            };
            let traced = measure(config, cut.words, (storage, dense), out, &mut probe);
            let (Some((whole, output)), Some((_, traced))) = (whole, traced) else {
                hprintln!("{origin} {name}: the encoder cannot be set up");
                failed = true;
                continue;
            };
            if traced != output || output.events != cut.events {
                hprintln!("{origin} {name}: events are missing or the runs differ");
                failed = true;
                continue;
            }
            pixels = output.pixels.max(pixels);
            let stage = |stage: Stage| {
                let i = stage as usize;
                probe.spent[i].saturating_sub(probe.calls[i] * cost)
            };
            hprintln!(
                "{{\"origin\":\"{origin}\",\"cut\":\"{name}\",\"transform\":\"{}\",\"m\":{m},\
                     \"events\":{},\"pixels\":{},\"windows\":{},\"frames\":{},\"bytes\":{},\"check\":{},\
                     \"whole\":{whole},\"stages\":{{\"ingest\":{},\"group\":{},\
                     \"accumulate\":{},\"prune\":{},\"quantise\":{},\"pack\":{},\"frame\":{}}}}}",
                label,
                output.events,
                pixels,
                output.windows,
                output.frames,
                output.bytes,
                output.check,
                stage(Stage::Ingest),
                stage(Stage::Group),
                stage(Stage::Accumulate),
                stage(Stage::Prune),
                stage(Stage::Quantise),
                stage(Stage::Pack),
                stage(Stage::Frame),
            );
        }
    }
    debug::exit(if failed { EXIT_FAILURE } else { EXIT_SUCCESS });
    loop {
        cortex_m::asm::wfi();
    }
}
