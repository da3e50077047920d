//! What callers get wrong is a status, and every coder's frames come back, whatever the lent memory held.

use std::ffi::CStr;
use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};

use eecvs_capi::*;
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::evt21::{self, Order};
use eecvs_nostd::{Event, Polarity, aer};

const STATUS_NONE: EecvsStatus = EecvsStatus::None;

fn config(width: u16, height: u16) -> EecvsConfig {
    let mut config = MaybeUninit::uninit();
    // SAFETY: it can be written.
    let status = unsafe { eecvs_config_init(config.as_mut_ptr(), width, height) };
    assert_eq!(status, EecvsStatus::Ok);
    // SAFETY: it was written.
    unsafe { config.assume_init() }
}

fn size(config: &EecvsConfig) -> Result<usize, EecvsStatus> {
    let mut bytes = 0;
    // SAFETY: both are lent.
    match unsafe { eecvs_encoder_size(config, &raw mut bytes) } {
        EecvsStatus::Ok => Ok(bytes),
        status => Err(status),
    }
}

/// Memory that was used before.
fn memory(bytes: usize) -> Vec<u64> {
    vec![0xA5A5_5A5A_DEAD_BEEF; bytes.div_ceil(8)]
}

fn encoder(config: &EecvsConfig, memory: &mut [u64]) -> *mut EecvsEncoder {
    let mut made = null_mut();
    let bytes = size_of_val(memory);
    // SAFETY: the memory outlives the encoder in each test.
    let status =
        unsafe { eecvs_encoder_new(config, memory.as_mut_ptr().cast(), bytes, &raw mut made) };
    assert_eq!(status, EecvsStatus::Ok);
    made
}

fn events(count: u64) -> Vec<EecvsEvent> {
    let event = |at: u64| EecvsEvent {
        t_us: 3 * at,
        x: (at * 7 % 40) as u16,
        y: (at * 5 % 30) as u16,
        polarity: at.is_multiple_of(3).into(),
    };
    (0..count).map(event).collect()
}

fn take(it: *mut EecvsEncoder, frames: &mut Vec<u8>) {
    let mut out = [0; EECVS_FRAME_BYTES_MIN];
    loop {
        let mut bytes = 0;
        // SAFETY: all are lent.
        let status = unsafe { eecvs_next_frame(it, out.as_mut_ptr(), out.len(), &raw mut bytes) };
        frames.extend_from_slice(&out[..bytes]);
        match status {
            EecvsStatus::Ok => {}
            STATUS_NONE => return,
            other => panic!("{other:?}"),
        }
    }
}

/// Encodes `count` inputs, which `push` gives from a position on: it has the encoder, the position and where the number of
/// those taken is to be written.
fn encode_by(
    config: &EecvsConfig,
    count: usize,
    push: impl Fn(*mut EecvsEncoder, usize, *mut usize) -> EecvsStatus,
) -> (Vec<u8>, EecvsCounts) {
    let mut memory = memory(size(config).unwrap());
    let it = encoder(config, &mut memory);
    let (mut frames, mut at) = (Vec::new(), 0);
    while at < count {
        let mut taken = 0;
        let status = push(it, at, &raw mut taken);
        at += taken;
        match status {
            EecvsStatus::Ok => {}
            EecvsStatus::Closed => take(it, &mut frames),
            other => panic!("{other:?}"),
        }
    }
    // SAFETY: it is an encoder.
    assert_eq!(unsafe { eecvs_flush(it) }, EecvsStatus::Ok);
    take(it, &mut frames);
    let mut counts = EecvsCounts::default();
    // SAFETY: both are lent.
    unsafe { eecvs_get_counts(it, &raw mut counts) };
    assert_eq!(counts.bytes, frames.len() as u64);
    (frames, counts)
}

fn encode(config: &EecvsConfig, events: &[EecvsEvent]) -> Vec<u8> {
    let (frames, counts) = encode_by(config, events.len(), |it, at, taken| {
        let rest = &events[at..];
        // SAFETY: all are lent.
        unsafe { eecvs_push(it, rest.as_ptr(), rest.len(), taken) }
    });
    assert_eq!(counts.events, events.len() as u64);
    frames
}

/// Decodes frames that come in portions of a prime number of bytes.
fn decode(frames: &[u8]) -> (Vec<EecvsEvent>, EecvsLosses) {
    let it = eecvs_decoder_new();
    let mut found = Vec::new();
    let mut room = events(100);
    let mut next = |found: &mut Vec<EecvsEvent>| {
        loop {
            let mut count = 0;
            // SAFETY: all are lent.
            let status =
                unsafe { eecvs_decoder_next(it, room.as_mut_ptr(), room.len(), &raw mut count) };
            found.extend_from_slice(&room[..count]);
            match status {
                EecvsStatus::Ok => {}
                STATUS_NONE => return,
                other => panic!("{other:?}"),
            }
        }
    };
    for part in frames.chunks(997) {
        // SAFETY: all are lent.
        let status = unsafe { eecvs_decoder_push(it, part.as_ptr(), part.len()) };
        assert_eq!(status, EecvsStatus::Ok);
        next(&mut found);
    }
    // SAFETY: it is a decoder.
    assert_eq!(unsafe { eecvs_decoder_finish(it) }, EecvsStatus::Ok);
    next(&mut found);
    let mut losses = EecvsLosses::default();
    // SAFETY: both are lent, and the decoder is not used again.
    unsafe {
        assert_eq!(
            eecvs_decoder_push(it, null(), 0),
            EecvsStatus::ErrorFinished
        );
        eecvs_decoder_losses(it, &raw mut losses);
        eecvs_decoder_free(it);
    }
    (found, losses)
}

fn key(event: &EecvsEvent) -> (u64, u16, u16, u8) {
    (event.t_us, event.x, event.y, event.polarity)
}

#[test]
fn every_coder_brings_events_back() {
    let sent = events(30_000);
    for coder in [EecvsCoder::Fast, EecvsCoder::Quick, EecvsCoder::Dense] {
        let mut config = config(40, 30);
        config.coder = coder as u8;
        config.window_us = 5000;
        let frames = encode(&config, &sent);
        let (mut found, losses) = decode(&frames);
        found.sort_unstable_by_key(key);
        assert!(found == sent, "{coder:?}: {} events", found.len());
        assert_eq!((losses.frames_lost, losses.damaged_bytes), (0, 0));
        // A lost frame is counted.
        let (found, losses) = decode(&frames[frames.len() / 3..]);
        assert!(found.len() < sent.len() && losses.damaged_bytes > 0);
    }
    let sent = events(3000);
    let mut config = config(40, 30);
    config.coder = EecvsCoder::Transform as u8;
    for transform in 0..3 {
        config.transform = transform;
        for few_as_times in [0, 1] {
            config.few_as_times = few_as_times;
            let (found, _) = decode(&encode(&config, &sent));
            assert_eq!(found.len(), sent.len());
        }
    }
}

/// Rows of events at one time, which EVT 2.1 has in one word, some of them off the sensor.
fn rows() -> Vec<Event> {
    let mut events = Vec::new();
    for row in 0..2000_u64 {
        let polarity = Polarity::from_bool(row.is_multiple_of(3));
        let columns = (0..64).filter(|column| column * row % 7 < 3);
        events.extend(columns.map(|x| Event {
            t_us: 40 * row,
            x: x as u16,
            y: (row * 5 % 30) as u16,
            polarity,
        }));
    }
    events
}

#[test]
fn the_words_of_sensors_are_their_events() {
    let events = rows();
    let structs: Vec<EecvsEvent> = events
        .iter()
        .map(|event| EecvsEvent {
            t_us: event.t_us,
            x: event.x,
            y: event.y,
            polarity: event.polarity as u8,
        })
        .collect();
    let mut evt2 = Evt2Encoder::new(0);
    let evt2: Vec<[u8; 4]> = events
        .iter()
        .flat_map(|event| {
            let (time, word) = evt2.encode(*event).unwrap();
            time.into_iter().chain([word])
        })
        .map(u32::to_le_bytes)
        .collect();
    let (mut vectors, mut rest, mut high) = (Vec::new(), &events[..], None);
    while let Some(first) = rest.first() {
        let now = first.t_us >> evt21::LOW_BITS;
        if high.replace(now) != Some(now) {
            vectors.push(evt21::time_word(now));
        }
        let (count, word) = evt21::vector(rest);
        vectors.push(word);
        rest = &rest[count..];
    }
    // Windows that end by their number of events, so most within a word; and by their time.
    for (window_events, window_us) in [(100, 32_768), (4096, 1000)] {
        let mut config = config(50, 30);
        (config.window_events, config.window_us) = (window_events, window_us);
        let (frames, counts) = encode_by(&config, structs.len(), |it, at, taken| {
            // SAFETY: all are lent.
            unsafe { eecvs_push(it, structs[at..].as_ptr(), structs.len() - at, taken) }
        });
        let outside = events.iter().filter(|event| event.x >= 50).count() as u64;
        assert_eq!(
            (counts.events, counts.outside),
            (events.len() as u64, outside)
        );
        assert!(counts.frames > 50 && outside > 0);
        let by_evt2 = encode_by(&config, evt2.len(), |it, at, taken| {
            // SAFETY: all are lent.
            unsafe { eecvs_push_evt2(it, evt2[at..].as_ptr().cast(), evt2.len() - at, taken) }
        });
        assert!(by_evt2 == (frames.clone(), counts), "{:?}", by_evt2.1);
        for order in [Order::Little, Order::UpperFirst] {
            let words: Vec<_> = vectors.iter().map(|word| order.bytes(*word)).collect();
            // In portions, too, and with nothing in between.
            for portion in [1, usize::MAX] {
                let by_evt21 = encode_by(&config, words.len(), |it, at, taken| {
                    let rest = &words[at..];
                    let (first, count) = (rest.as_ptr().cast(), rest.len().min(portion));
                    // SAFETY: all are lent.
                    unsafe {
                        eecvs_push_evt21(it, first, 0, 0, null_mut());
                        eecvs_push_evt21(
                            it,
                            first,
                            count,
                            u8::from(order == Order::UpperFirst),
                            taken,
                        )
                    }
                });
                assert!(by_evt21 == (frames.clone(), counts), "{:?}", by_evt21.1);
            }
        }
        let by_aer = encode_by(&config, structs.len(), |it, at, taken| {
            let word = aer::word(events[at]).unwrap();
            // SAFETY: all are lent.
            unsafe { eecvs_push_aer(it, &raw const word, 1, events[at].t_us, taken) }
        });
        assert!(by_aer == (frames, counts), "{:?}", by_aer.1);
    }
}

#[test]
fn a_decoder_finds_frames_after_any_number_of_other_bytes() {
    let frames = encode(&config(40, 30), &events(1000));
    let it = eecvs_decoder_new();
    let (mut room, mut count) = (events(2000), 0);
    let mut found = Vec::new();
    let noise = vec![0; 1 << 20];
    // More than a file is searched for.
    for bytes in core::iter::repeat_n(&noise, 66).chain([&frames]) {
        // SAFETY: all are lent.
        unsafe {
            let status = eecvs_decoder_push(it, bytes.as_ptr(), bytes.len());
            assert_eq!(status, EecvsStatus::Ok);
            eecvs_decoder_next(it, room.as_mut_ptr(), room.len(), &raw mut count);
            found.extend_from_slice(&room[..count]);
        }
    }
    // SAFETY: all are lent, and the decoder is not used again.
    unsafe {
        let none = eecvs_decoder_next(it, room.as_mut_ptr(), 0, &raw mut count);
        assert_eq!(none, EecvsStatus::ErrorRoom);
        eecvs_decoder_finish(it);
        eecvs_decoder_next(it, room.as_mut_ptr(), room.len(), &raw mut count);
        found.extend_from_slice(&room[..count]);
        eecvs_decoder_free(it);
    }
    assert_eq!(found, events(1000));
}

#[test]
fn the_last_time_of_the_clock_comes_back() {
    let last = |t_us| EecvsEvent {
        t_us,
        x: 1,
        y: 2,
        polarity: 1,
    };
    for coder in [EecvsCoder::Fast, EecvsCoder::Quick, EecvsCoder::Dense] {
        let mut config = config(40, 30);
        config.coder = coder as u8;
        for sent in [vec![last(u64::MAX)], vec![last(5), last(u64::MAX)]] {
            assert_eq!(decode(&encode(&config, &sent)).0, sent, "{coder:?}");
        }
    }
}

#[test]
fn times_that_a_budget_coarsens_are_counted() {
    let mut config = config(40, 30);
    config.bytes_per_second = 20_000;
    let sent = events(30_000);
    let (found, losses) = decode(&encode(&config, &sent));
    assert!(losses.events_approximate > 0 && losses.events_approximate <= found.len() as u64);
    assert_eq!(
        found.len() as u64 + losses.events_thinned,
        sent.len() as u64
    );
    config.bytes_per_second = 0;
    assert_eq!(decode(&encode(&config, &sent)).1.events_approximate, 0);
}

#[test]
fn words_that_are_no_events_are_counted() {
    let mut config = config(2048, 30);
    config.window_events = 100;
    let vector = 1_u64 << 60 | 2047 << 43 | 0x8000_0001;
    let words = [vector, 0xE << 60, evt21::time_word(3), vector, 1 << 60].map(u64::to_le_bytes);
    let (frames, counts) = encode_by(&config, words.len(), |it, at, taken| {
        // SAFETY: all are lent.
        unsafe { eecvs_push_evt21(it, words[at..].as_ptr().cast(), words.len() - at, 0, taken) }
    });
    // Two before the first time, another type, none in a vector; of two events one is off every sensor.
    assert_eq!((counts.events, counts.outside, counts.ignored), (2, 1, 4));
    assert_eq!(decode(&frames).0.len(), 1);
    let word = 1 << 19;
    let (_, counts) = encode_by(&config, 1, |it, _, taken| {
        // SAFETY: all are lent.
        unsafe {
            let refused = eecvs_push_evt21(it, null(), 0, 2, taken);
            assert_eq!(refused, EecvsStatus::ErrorFlag);
            eecvs_push_aer(it, &raw const word, 1, 0, taken)
        }
    });
    assert_eq!((counts.events, counts.ignored), (0, 1));
}

#[test]
fn what_a_caller_gets_wrong_is_a_status() {
    use EecvsStatus as S;
    let refused = |change: fn(&mut EecvsConfig)| {
        let mut config = config(40, 30);
        change(&mut config);
        size(&config).and_then(|bytes| {
            let (mut memory, mut made) = (memory(bytes), null_mut());
            let first = memory.as_mut_ptr().cast();
            // SAFETY: all are lent.
            match unsafe { eecvs_encoder_new(&raw const config, first, bytes, &raw mut made) } {
                S::Ok => Ok(()),
                status => Err(status),
            }
        })
    };
    assert_eq!(refused(|_| ()), Ok(()));
    for (change, status) in [
        ((|c| c.width = 0) as fn(&mut EecvsConfig), S::ErrorWindow),
        (|c| c.height = 2049, S::ErrorWindow),
        (|c| c.window_us = 0, S::ErrorWindow),
        (|c| c.window_events = 0, S::ErrorWindow),
        (|c| c.coder = 4, S::ErrorCoder),
        (|c| c.transform = 3, S::ErrorCoder),
        (|c| c.m = 0, S::ErrorCoefficients),
        (|c| c.m = 65, S::ErrorCoefficients),
        (|c| c.step_log2 = 9, S::ErrorCoefficients),
        (|c| (c.coder, c.tolerance_us) = (1, 5), S::ErrorFidelity),
        (|c| (c.coder, c.tolerance_us) = (3, 5), S::ErrorFidelity),
        (|c| c.bytes_per_second = 1, S::ErrorBudget),
        (
            |c| (c.coder, c.bytes_per_second) = (1, 100_000),
            S::ErrorBudget,
        ),
        (|c| c.few_as_times = 2, S::ErrorFlag),
        (|c| c.remove_isolated = 255, S::ErrorFlag),
    ] {
        assert_eq!(refused(change), Err(status));
    }

    let good = config(40, 30);
    let bytes = size(&good).unwrap();
    let mut memory = memory(bytes + 8);
    let first: *mut u8 = memory.as_mut_ptr().cast();
    let new = |memory: *mut u8, bytes| {
        let mut made = null_mut();
        // SAFETY: all are lent.
        let status =
            unsafe { eecvs_encoder_new(&raw const good, memory.cast(), bytes, &raw mut made) };
        assert_eq!(made.is_null(), status != S::Ok);
        status
    };
    assert_eq!(new(first, bytes - 1), S::ErrorMemory);
    assert_eq!(new(first, 0), S::ErrorMemory);
    assert_eq!(new(first.wrapping_add(4), bytes), S::ErrorPointer);
    assert_eq!(new(null_mut(), bytes), S::ErrorPointer);
    assert_eq!(new(first, bytes), S::Ok);

    let it = encoder(&good, &mut memory);
    let event = events(1);
    let (mut out, mut count) = ([0; EECVS_FRAME_BYTES_MIN], 0);
    // SAFETY: what is not null is lent.
    unsafe {
        assert_eq!(
            eecvs_push(null_mut(), event.as_ptr(), 1, null_mut()),
            S::ErrorPointer
        );
        assert_eq!(eecvs_push(it, null(), 1, null_mut()), S::ErrorPointer);
        assert_eq!(
            eecvs_push(it, event.as_ptr(), usize::MAX, null_mut()),
            S::ErrorPointer
        );
        assert_eq!(eecvs_push(it, null(), 0, &raw mut count), S::Ok);
        assert_eq!(eecvs_push(it, event.as_ptr(), 1, null_mut()), S::Ok);
        assert_eq!(
            eecvs_push_evt2(it, null(), 1, &raw mut count),
            S::ErrorPointer
        );
        let mut next = |out: *mut u8, room| eecvs_next_frame(it, out, room, &raw mut count);
        assert_eq!(next(null_mut(), 4096), S::ErrorPointer);
        assert_eq!(next(out.as_mut_ptr(), 2047), S::ErrorRoom);
        assert_eq!(
            eecvs_next_frame(it, out.as_mut_ptr(), 2048, null_mut()),
            S::ErrorPointer
        );
        assert_eq!(eecvs_add_hot(it, 40, 0), S::ErrorOutside);
        assert_eq!(eecvs_add_hot(it, 39, 0), S::ErrorHot);
        assert_eq!(eecvs_set_budget(it, 1), S::Ok);
        assert_eq!(eecvs_set_tolerance(it, 10), S::Ok);
        assert_eq!(eecvs_flush(null_mut()), S::ErrorPointer);
        assert_eq!(eecvs_flush(it.wrapping_byte_add(1)), S::ErrorPointer);
        assert_eq!(eecvs_pass(it, 1_000_000), S::Closed);
        assert_eq!(eecvs_get_counts(it, null_mut()), S::ErrorPointer);
        eecvs_decoder_free(null_mut());
        assert_eq!(eecvs_decoder_push(null_mut(), null(), 0), S::ErrorPointer);
        let name = |status| CStr::from_ptr(eecvs_status_name(status)).to_str().unwrap();
        assert_eq!(
            name(S::ErrorRoom as i32),
            "the room for a frame is too small"
        );
        assert_eq!(name(12345), "unknown status");
        assert_eq!(eecvs_abi_version(), EECVS_ABI_VERSION);
    }
}
