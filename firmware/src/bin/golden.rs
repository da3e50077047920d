//! The golden vectors on the target: the same bits as on the host, or the image exits with an
//! error. For QEMU.
#![no_std]
#![no_main]

use core::cell::RefCell;

use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use critical_section::Mutex;
use eecvs_firmware as _;
use eecvs_nostd::{
    Config, Encoder, Event, OUTPUT_BYTES_MIN, Polarity, Push, Quantiser, Sensor, Storage,
    Thresholds, Transform, WindowConfig, bitmap_words, segments,
};

/// A golden vector: `tests/golden.rs` describes it.
struct Golden {
    width: u16,
    height: u16,
    transform: &'static str,
    m: u8,
    /// (t_us, x, y, p)
    events: &'static [(u64, u16, u16, u8)],
    frames: &'static [&'static [u8]],
}

include!(concat!(env!("OUT_DIR"), "/golden.rs"));

const SEGMENTS: usize = segments(40, 3);
type Small = Storage<400, SEGMENTS, { bitmap_words(SEGMENTS) }, 64>;

static STORAGE: Mutex<RefCell<Small>> = Mutex::new(RefCell::new(Small::new()));

#[entry]
fn main() -> ! {
    let passed = critical_section::with(|token| {
        let mut storage = STORAGE.borrow_ref_mut(token);
        let mut failed = 0;
        for golden in GOLDEN {
            if !holds(golden, &mut storage) {
                hprintln!("golden: {} M={} differs", golden.transform, golden.m);
                failed += 1;
            }
        }
        hprintln!("golden: {} vectors, {} differ", GOLDEN.len(), failed);
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

fn holds(golden: &Golden, storage: &mut Small) -> bool {
    let Some(config) = config(golden) else {
        return false;
    };
    let Ok(mut encoder) = storage.encoder(config) else {
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

fn config(golden: &Golden) -> Option<Config> {
    Some(Config {
        window: WindowConfig {
            sensor: Sensor::new(golden.width, golden.height)?,
            window_us: 32_768,
        },
        thresholds: Thresholds::new(0, 0)?,
        transform: Some(
            Transform::ALL
                .into_iter()
                .find(|transform| transform.name() == golden.transform)?,
        ),
        m: golden.m,
        grid: None,
        quantiser: Quantiser::DEFAULT,
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
