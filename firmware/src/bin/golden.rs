//! Golden vectors on the target: they have to give the same bits as on the host, or the image exits with an error.
//! For QEMU.
//!
//! The image also compares code that some targets have of their own with the portable code: words taken in runs
//! with words taken one by one, sums of lists with those of impulses that are not in lists, and the walks of the
//! eight-coefficient DCT, of the Haar transform on 16 bins, of pixels sent as times and of both event coders with the
//! walks that run under a trace.
#![no_std]
#![no_main]

use core::cell::RefCell;
use core::num::NonZeroU32;

use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use critical_section::Mutex;
use eecvs_firmware as _;
use eecvs_nostd::Slot;
use eecvs_nostd::coder::dense::DenseMemory;
#[cfg(not(feature = "microbit"))]
use eecvs_nostd::coder::dense::model::Model;
#[cfg(not(feature = "microbit"))]
use eecvs_nostd::coder::dense::words;
use eecvs_nostd::evt2::{Evt2Decoder, Word};
use eecvs_nostd::fixed_point::{CHUNK_EVENTS, Sum};
use eecvs_nostd::group::Impulse;
use eecvs_nostd::group::lists::Lists;
use eecvs_nostd::transform::phase::PhaseScale;
use eecvs_nostd::transform::{Basis, Dct, Dtft};
use eecvs_nostd::{
    Axis, Coder, Config, Encoder, Event, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode,
    OUTPUT_BYTES_MIN, Polarity, Push, Quantiser, Readout, Sensor, Stage, Storage, Thresholds,
    Trace, Transform, WindowConfig, bitmap_words, segments,
};

/// A golden vector, as described in `tests/frames/golden.rs`.
struct Golden {
    width: u16,
    height: u16,
    transform: &'static str,
    m: u8,
    /// Code of the mode, as in a setup; [`QUICK`] stands for the quick coder.
    mode: u8,
    fidelity: u32,
    /// Period and slope of the columns' scans, in 2^-16 us.
    scans: Option<(u32, i32)>,
    /// Whether pixels of few events are sent as times.
    few_as_times: bool,
    /// (t_us, x, y, p).
    events: &'static [(u64, u16, u16, u8)],
    frames: &'static [&'static [u8]],
}

include!(concat!(env!("OUT_DIR"), "/golden.rs"));

/// Sensor of the walks: wide enough for long gaps.
const WIDE: (u16, u16) = (2048, 8);
const SEGMENTS: usize = segments(WIDE.0, WIDE.1);
type Small = Storage<400, SEGMENTS, { bitmap_words(SEGMENTS) }, 64>;

/// Sensor of the dense coder's walk: it has enough rows and segments for all neighbours.
#[cfg(not(feature = "microbit"))]
const TALL: Sensor = Sensor {
    width: 100,
    height: 40,
};
/// Words enough for this sensor and for that of the vectors, with the window before.
#[cfg(not(feature = "microbit"))]
const DENSE_WORDS: usize = words(TALL, true);
#[cfg(not(feature = "microbit"))]
type Dense = (Model, [u32; DENSE_WORDS]);
#[cfg(not(feature = "microbit"))]
static DENSE: Mutex<RefCell<Dense>> = Mutex::new(RefCell::new((Model::UNSET, [0; DENSE_WORDS])));

static STORAGE: Mutex<RefCell<Small>> = Mutex::new(RefCell::new(Small::new()));

#[entry]
fn main() -> ! {
    let passed = critical_section::with(|token| {
        let mut storage = STORAGE.borrow_ref_mut(token);
        let mut failed = 0;
        #[cfg(not(feature = "microbit"))]
        let mut dense = DENSE.borrow_ref_mut(token);
        for golden in GOLDEN {
            let is_dense = golden.mode & 3 == 2;
            if is_dense && cfg!(feature = "microbit") {
                hprintln!("golden: no memory for the dense coder");
                continue;
            }
            #[cfg(not(feature = "microbit"))]
            let dense = is_dense.then(|| {
                let (model, words) = &mut *dense;
                DenseMemory { model, words }
            });
            #[cfg(feature = "microbit")]
            let dense = None;
            if !holds(golden, &mut storage, dense) {
                hprintln!("golden: {} M={} differs", golden.transform, golden.m);
                failed += 1;
            }
        }
        hprintln!("golden: {} vectors, {} differ", GOLDEN.len(), failed);
        for seed in 0..STREAMS {
            let modes: &[u8] = if cfg!(feature = "quick") {
                &[0, QUICK]
            } else {
                &[0]
            };
            for &mode in modes {
                if !runs_hold(seed, mode, &mut storage) {
                    hprintln!("golden: words of stream {} differ in mode {}", seed, mode);
                    failed += 1;
                }
            }
        }
        for seed in 0..LISTS {
            if !sums_hold::<Dct>(seed, 8) || !sums_hold::<Dct>(seed, 16) {
                hprintln!("golden: sums of list {} of the DCT differ", seed);
                failed += 1;
            }
            if !sums_hold::<Dtft>(seed, 16) {
                hprintln!("golden: sums of list {} of the DTFT differ", seed);
                failed += 1;
            }
        }
        for seed in 0..WALKS {
            for (name, transform, mode, few_as_times) in [
                ("dct", Transform::Dct, 0, false),
                ("dwt", Transform::Dwt, 0, false),
                ("dct with times", Transform::Dct, 0, true),
                ("dtft with times", Transform::Dtft, 0, true),
                ("fast", Transform::Dct, 1, false),
            ] {
                if !walks_hold(seed, (transform, mode, few_as_times), &mut storage) {
                    hprintln!("golden: walk {} of {} differs", seed, name);
                    failed += 1;
                }
            }
        }
        #[cfg(not(feature = "microbit"))]
        for seed in 0..WALKS {
            if !dense_walk_holds(seed, &mut storage, &mut dense) {
                hprintln!("golden: walk {} of dense differs", seed);
                failed += 1;
            }
        }
        failed == 0 && !GOLDEN.is_empty()
    });
    loop {
        debug::exit(if passed {
            debug::EXIT_SUCCESS
        } else {
            debug::EXIT_FAILURE
        });
    }
}

#[inline(never)]
fn holds(golden: &Golden, storage: &mut Small, dense: Option<DenseMemory<'_>>) -> bool {
    let Some(config) = config(golden) else {
        return false;
    };
    let Ok(mut encoder) = storage.encoder_with(config, dense) else {
        return false;
    };
    let mut expected = golden.frames.iter();
    for &(t_us, x, y, p) in golden.events {
        let event = Event {
            t_us,
            x,
            y,
            polarity: Polarity::from_bool(p == 1),
        };
        while encoder.push(event) == Push::Closed {
            if !frames_are(&mut encoder, &mut expected) {
                return false;
            }
        }
    }
    encoder.flush();
    frames_are(&mut encoder, &mut expected) && expected.next().is_none()
}

/// The mode whose windows keep the order of arrival.
const QUICK: u8 = 3;

const STREAMS: u32 = 64;
const STREAM_WORDS: usize = 4000;

/// Generates words of all kinds: mostly events on a sensor of 40 x 3 or next to it, some times that go forwards and
/// back, and any others.
struct Words {
    random: u32,
    t_us: u32,
    /// The event to return after a time word.
    event: Option<u32>,
    high: u32,
}

impl Words {
    fn new(seed: u32) -> Self {
        Self {
            random: seed,
            t_us: 10_000,
            event: None,
            high: 0,
        }
    }

    fn below(&mut self, end: u32) -> u32 {
        self.random = self
            .random
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        (self.random >> 8) % end
    }
}

impl Iterator for Words {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        if let Some(event) = self.event.take() {
            return Some(event);
        }
        let step_us = match self.below(64) {
            0 => self.below(5000),
            1 => return Some((self.below(1 << 16) << 16) | self.below(1 << 16)),
            2..6 => 0_u32.wrapping_sub(self.below(100)),
            _ => self.below(20),
        };
        self.t_us = self.t_us.wrapping_add(step_us);
        let (on, x, y) = (
            self.below(2),
            self.below(41),
            self.below(4).min(self.below(8)),
        );
        let event = (on << 28) | ((self.t_us % 64) << 22) | (x << 11) | y;
        let high = self.t_us / 64;
        if high == self.high {
            return Some(event);
        }
        self.high = high;
        self.event = Some(event);
        Some((8 << 28) | high)
    }
}

/// Returns whether words in runs of any length give the same frames as words one by one.
#[inline(never)]
fn runs_hold(seed: u32, mode: u8, storage: &mut Small) -> bool {
    // Some windows close early, some of them at an event that is not the latest.
    let window_us = [3000, 100 + seed, 1 << 20][seed as usize % 3];
    let golden = Golden {
        width: 40,
        height: 3,
        transform: Transform::Dct.name(),
        m: 8,
        mode,
        fidelity: 0,
        scans: None,
        few_as_times: false,
        events: &[],
        frames: &[],
    };
    let Some(mut config) = config(&golden) else {
        return false;
    };
    config.window.window_us = window_us;

    let mut one_by_one = Digest::NONE;
    let Ok(mut encoder) = storage.encoder(config) else {
        return false;
    };
    let mut decoder = Evt2Decoder::new(0);
    for word in Words::new(seed).take(STREAM_WORDS) {
        if let Word::Event(event) = decoder.decode(word) {
            while encoder.push(event) == Push::Closed {
                one_by_one.take(&mut encoder);
            }
        }
    }
    encoder.flush();
    one_by_one.take(&mut encoder);

    let mut in_runs = Digest::NONE;
    let Ok(mut encoder) = storage.encoder(config) else {
        return false;
    };
    let mut decoder = Evt2Decoder::new(0);
    let mut words = Words::new(seed).take(STREAM_WORDS);
    let mut run = [[0; 4]; 40];
    loop {
        let len = 1 + run.len() * (seed as usize % 8) / 8;
        let mut filled = 0;
        for (place, word) in run.iter_mut().take(len).zip(&mut words) {
            *place = word.to_le_bytes();
            filled += 1;
        }
        let mut rest = run.get(..filled).unwrap_or_default();
        if rest.is_empty() {
            break;
        }
        while !rest.is_empty() {
            let taken = encoder.window().push_words(&mut decoder, rest);
            rest = rest.get(taken.words..).unwrap_or_default();
            if !rest.is_empty() {
                in_runs.take(&mut encoder);
            }
        }
    }
    encoder.flush();
    in_runs.take(&mut encoder);
    in_runs == one_by_one && in_runs.events > 0
}

/// Number of lists, each with one impulse more than the one before; none where sums of lists have no code of their own.
const LISTS: u32 = if cfg!(feature = "microbit") {
    0
} else {
    2 * CHUNK_EVENTS as u32 + 3
};

/// Returns whether the first chunk has the same sums as a list and as impulses that are not in a list.
#[inline(never)]
fn sums_hold<B: Basis>(seed: u32, grid: usize) -> bool {
    let mut random = Words::new(seed);
    let duration_us = [1, 1000, 32_768, 33_333, 1 << 24][seed as usize % 5];
    let scale = PhaseScale::new(duration_us);
    let mut slots = [Slot::EMPTY; LISTS as usize];
    let mut lists = Lists::new(&mut slots);
    let impulses = (0..seed).map(|_| Impulse {
        offset_us: random.below(duration_us),
        is_on: random.below(2) == 1,
    });
    let Some(first) = lists.push(impulses) else {
        return false;
    };
    let list = lists.laid_out().impulses(first);
    let mut sums = [[Sum::NEG_ONE; 32]; 2];
    B::accumulate(list.clone(), scale, grid, &mut sums[0]);
    let rest = B::accumulate_list(&list, scale, grid, &mut sums[1]);
    // Except for c_0, which the caller sets.
    let [expected, found] = &mut sums;
    let known = if B::TRANSFORM.is_complex() { 2 } else { 1 };
    expected[..known].fill(Sum::ZERO);
    found[..known].fill(Sum::ZERO);
    let left = list.skip(CHUNK_EVENTS);
    expected == found && rest.is_none_or(|rest| rest.eq(left))
}

const WALKS: u32 = 60;
const WALK_EVENTS: u32 = 3000;

/// A trace that asks for the portable walk.
struct Listener;

impl Trace for Listener {
    const IS_PORTABLE: bool = true;

    fn enter(&mut self, _: Stage) {}
}

/// Returns whether both walks give the same frames: with single events and crowded pixels, of one polarity and
/// mixed, neighbours and far apart, with every kind of step.
#[inline(never)]
fn walks_hold(
    seed: u32,
    (transform, mode, few_as_times): (Transform, u8, bool),
    storage: &mut Small,
) -> bool {
    let golden = Golden {
        width: WIDE.0,
        height: WIDE.1,
        transform: transform.name(),
        m: 8,
        mode,
        fidelity: 0,
        scans: None,
        few_as_times,
        events: &[],
        frames: &[],
    };
    let Some(mut config) = config(&golden) else {
        return false;
    };
    let step_log2 = [-6, -15, -10, -3, 0][seed as usize % 5];
    let Some(quantiser) = Quantiser::new(step_log2) else {
        return false;
    };
    config.quantiser = quantiser;
    // The fast coder's codes are longer in longer windows.
    let scale = if mode == 0 { 0 } else { 3 * (seed / 15) };
    config.window.window_us <<= scale;
    let digest = |storage: &mut Small, listens: bool| {
        let mut digest = Digest::NONE;
        let mut encoder = storage.encoder(config).ok()?;
        let mut random = Words::new(seed);
        for i in 0..WALK_EVENTS {
            let columns = [4, 40, 2048][(seed / 5) as usize % 3];
            let event = Event {
                t_us: u64::from(i * 64 + random.below(100)) << scale,
                x: (random.below(columns) + random.below(2) * (2048 - columns)) as u16,
                y: (random.below(2) * 7) as u16,
                // Every other seed has one polarity only.
                polarity: Polarity::from_bool(seed.is_multiple_of(2) || random.below(2) == 0),
            };
            while encoder.push(event) == Push::Closed {
                digest.take_as(&mut encoder, listens);
            }
        }
        encoder.flush();
        digest.take_as(&mut encoder, listens);
        Some(digest)
    };
    let portable = digest(storage, true);
    portable.is_some_and(|digest| digest.events > 0) && digest(storage, false) == portable
}

/// Returns whether the dense coder's walks give the same frames, with the window before and without it: with events
/// far apart, edges of equal times (which rows come to follow), crowded pixels, and frames that overflow.
#[cfg(not(feature = "microbit"))]
#[inline(never)]
fn dense_walk_holds(seed: u32, storage: &mut Small, (model, memory): &mut Dense) -> bool {
    let golden = Golden {
        width: TALL.width,
        height: TALL.height,
        transform: Transform::Dct.name(),
        m: 8,
        mode: 2,
        fidelity: 0,
        scans: None,
        few_as_times: false,
        events: &[],
        frames: &[],
    };
    let Some(mut config) = config(&golden) else {
        return false;
    };
    // Times of 6 to 18 bits, of which the walk handles up to 17.
    config.window.window_us = [32_768, 60, 10_000, 65_536, 131_073, 131_072][seed as usize % 6];
    let used = if (seed / 2).is_multiple_of(2) {
        memory.len()
    } else {
        words(TALL, false)
    };
    let mut digest = |listens: bool| {
        let words = memory.get_mut(..used)?;
        let mut digest = Digest::NONE;
        let dense = Some(DenseMemory { model, words });
        let mut encoder = storage.encoder_with(config, dense).ok()?;
        let mut random = Words::new(seed);
        for i in 0..WALK_EVENTS {
            let (x, y) = match seed / 6 % 4 {
                0 => (random.below(100), random.below(40)),
                // A moving edge: columns of equal times, one after the other.
                1 => (i / 40 % 100, i % 40),
                2 => (30 + random.below(4), 14 + random.below(4)),
                _ => (random.below(100), 15 + random.below(3)),
            };
            let (step, jitter) = if seed / 6 % 4 == 1 {
                (i / 40 * 500 + random.below(2), 1)
            } else {
                (i * 40, 100)
            };
            let event = Event {
                t_us: u64::from(step + random.below(jitter)),
                x: x as u16,
                y: y as u16,
                polarity: Polarity::from_bool(random.below(4) > seed % 3),
            };
            while encoder.push(event) == Push::Closed {
                digest.take_as(&mut encoder, listens);
            }
        }
        encoder.flush();
        digest.take_as(&mut encoder, listens);
        Some(digest)
    };
    let portable = digest(true);
    portable.is_some_and(|digest| digest.events > 0) && digest(false) == portable
}

/// The part of frames that is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Digest {
    frames: u32,
    events: u32,
    hash: u32,
}

impl Digest {
    const NONE: Self = Self {
        frames: 0,
        events: 0,
        hash: 0,
    };

    fn take(&mut self, encoder: &mut Encoder<'_>) {
        self.take_as(encoder, false);
    }

    fn take_as(&mut self, encoder: &mut Encoder<'_>, listens: bool) {
        let mut out = [0; OUTPUT_BYTES_MIN];
        let mut next = |out: &mut [u8]| {
            if listens {
                encoder.next_frame_traced(out, &mut Listener)
            } else {
                encoder.next_frame(out)
            }
        };
        while let Ok(Some(frame)) = next(&mut out) {
            self.frames += 1;
            self.events += frame.header.events;
            for byte in out.get(frame.range).unwrap_or_default() {
                self.hash = (self.hash ^ u32::from(*byte)).wrapping_mul(16_777_619);
            }
        }
    }
}

fn config(golden: &Golden) -> Option<Config> {
    let fidelity = Fidelity::from_code(golden.mode >> 2, golden.fidelity)?;
    let hybrid = |coder| Mode::Hybrid(Hybrid { coder, fidelity });
    let mode = match golden.mode & 3 {
        0 => Mode::Transform,
        1 => hybrid(Coder::Fast),
        2 => hybrid(Coder::Dense),
        _ => hybrid(Coder::Quick),
    };
    Some(Config {
        window: WindowConfig::new(Sensor::new(golden.width, golden.height)?, 32_768),
        thresholds: Thresholds::new(0, 0)?,
        transform: Some(
            Transform::ALL
                .into_iter()
                .find(|transform| transform.name() == golden.transform)?,
        ),
        m: golden.m,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        few_as_times: golden.few_as_times,
        // As in a setup: a lossless mode's value is a mean error.
        max_emd_us: NonZeroU32::new(golden.fidelity).filter(|_| mode.is_lossless()),
        mode,
        key_windows: KEY_WINDOWS,
        readout: match golden.scans {
            Some((period_q16, slope_q16)) => {
                Some(Readout::new(Axis::Columns, period_q16, slope_q16)?)
            }
            None => None,
        },
        filter: Filter::NONE,
        bytes_per_second: None,
        keep_order: false,
    })
}

fn frames_are<'g>(
    encoder: &mut Encoder<'_>,
    expected: &mut impl Iterator<Item = &'g &'static [u8]>,
) -> bool {
    let mut out = [0; OUTPUT_BYTES_MIN];
    loop {
        match encoder.next_frame(&mut out) {
            Ok(None) => return true,
            Ok(Some(frame)) => {
                if out.get(frame.range) != expected.next().copied() {
                    return false;
                }
            }
            Err(_) => return false,
        }
    }
}
