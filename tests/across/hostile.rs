//! Streams made to harm a reader: sound checksums, contradicting contents. They are refused,
//! counted and cost no more than their length; nothing panics.

use eecvs::decode::WindowReader;
use eecvs::frame_file::FrameReader;
use eecvs::window_limit::WindowLimit;
use eecvs_nostd::frame::{HEADER_BYTES_MAX, seal};
use eecvs_nostd::pack::bits_lsb_first::BitWriter;
use eecvs_nostd::{
    Coded, Coder, Descriptor, Event, FRAME_BYTES_MAX, Fidelity, Frame, FrameError, Header, Hybrid,
    Mode, Polarity, Quantiser, Regime, Sensor, Transform, UnpackError,
};
use strategies::sealed;

fn header() -> Header {
    Header {
        truncated: false,
        begins_run: false,
        last: false,
        regime: Regime::Sparse,
        mode: Mode::Transform,
        is_key: true,
        has_previous: false,
        levels: None,
        scans: None,
        order: None,
        sequence: 0,
        part: 0,
        sensor: Sensor {
            width: 8,
            height: 8,
        },
        t0_us: 0,
        duration_us: 1000,
        window_events: 2,
        events: 1,
        pixels: 1,
        late: 0,
        filtered: 0,
        dropped: 0,
        thinned: 0,
        saturated: 0,
        transform: Transform::Dwt,
        m: 8,
        grid: 16,
        quantiser: Quantiser::DEFAULT,
        timed_max: 0,
    }
}

/// A frame of a pixel with one ON event at the sensor's last place.
fn frame(header: &Header) -> Vec<u8> {
    let Sensor { width, height } = header.sensor;
    let last = Descriptor {
        x: width - 1,
        y: height - 1,
        on: 1,
        off: 0,
        coded: Coded::Cell(0),
    };
    frame_of(header, &[last])
}

/// A frame of these pixels.
fn frame_of(header: &Header, pixels: &[Descriptor]) -> Vec<u8> {
    let mut out = vec![0; 1000];
    let mut writer = BitWriter::new(&mut out[HEADER_BYTES_MAX..]);
    let (packing, mut next) = (header.packing(), 0);
    for pixel in pixels {
        packing.pack(pixel, &mut next, &mut writer).expect("room");
    }
    let payload_bytes = writer.finish();
    let range = seal(header, payload_bytes, &mut out).expect("room");
    out[range].to_vec()
}

fn unpack_error(frame: &[u8]) -> Option<UnpackError> {
    let frame = Frame::parse(frame).expect("sound checksums");
    frame.descriptors().find_map(Result::err)
}

#[test]
fn header_fields_out_of_range_are_refused() {
    assert!(Frame::parse(&frame(&header())).is_ok());
    type Change = fn(&mut Header);
    let cases: [(&str, Change); 13] = [
        ("M of 0", |h| h.m = 0),
        ("M of 65", |h| h.m = 65),
        ("grid of 0", |h| h.grid = 0),
        ("Haar grid of 24", |h| h.grid = 24),
        ("grid of 2048", |h| h.grid = 2048),
        ("duration of 0", |h| h.duration_us = 0),
        ("events above the window's", |h| h.events = 3),
        ("a window of 2^24 events", |h| h.window_events = 1 << 24),
        ("pixels above the events", |h| h.pixels = 2),
        ("pixels above the sensor's", |h| {
            (h.window_events, h.events, h.pixels) = (100, 100, 65);
        }),
        ("events without a pixel", |h| h.pixels = 0),
        ("a sensor 2049 wide", |h| h.sensor.width = 2049),
        ("a sensor 0 high", |h| {
            (h.sensor.width, h.sensor.height) = (1, 0);
        }),
    ];
    for (name, change) in cases {
        let mut changed = header();
        change(&mut changed);
        let mut out = [0; 200];
        let range = seal(&changed, 10, &mut out).expect("room");
        assert_eq!(
            Frame::parse(&out[range]),
            Err(FrameError::HeaderInvalid),
            "{name}"
        );
    }
}

/// CRC-16/IBM-3740, as the header's.
fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xffff, |crc, byte| {
        (0..8).fold(crc ^ (u16::from(*byte) << 8), |crc: u16, _| {
            (crc << 1) ^ (0x1021 * (crc >> 15))
        })
    })
}

/// `frame` with its header's fields replaced, and a header checksum that is right again.
fn with_fields(frame: &[u8], fields: &[u8]) -> Vec<u8> {
    let mut changed = [&frame[..3], &[fields.len() as u8 + 6], fields].concat();
    changed.extend(crc16(&changed).to_le_bytes());
    changed.extend(&frame[usize::from(frame[3])..]);
    changed
}

#[test]
fn a_header_is_checked_before_it_is_trusted() {
    let frame = frame(&header());
    let fields = &frame[4..usize::from(frame[3]) - 2];
    assert_eq!(with_fields(&frame, fields), frame);
    let parse = |fields: &[u8]| Frame::parse(&with_fields(&frame, fields)).map(|_| ());
    assert_eq!(
        parse(&[fields, &[0]].concat()),
        Err(FrameError::HeaderInvalid),
        "a byte after the fields"
    );
    let most = [&[0xff, 0xff, 0xff, 0xff, 0x0f], &fields[1..]].concat();
    assert_eq!(
        parse(&most),
        Err(FrameError::HeaderInvalid),
        "a payload of 2^32 - 1 bytes"
    );
    // 2^24 is more than a frame with its header; 2^23 is awaited.
    let large = [&[0x80, 0x80, 0x80, 0x08], &fields[1..]].concat();
    assert_eq!(parse(&large), Err(FrameError::HeaderInvalid));
    let awaited = [&[0x80, 0x80, 0x80, 0x04], &fields[1..]].concat();
    assert_eq!(parse(&awaited), Err(FrameError::Incomplete));
    // A damaged length is noticed before a byte of the payload has come.
    let mut damaged = frame[..usize::from(frame[3])].to_vec();
    damaged[4] ^= 0x40;
    assert_eq!(Frame::parse(&damaged), Err(FrameError::HeaderDamaged));
}

#[test]
fn a_payload_that_contradicts_its_header_is_refused() {
    assert_eq!(unpack_error(&frame(&header())), None);
    let mut more_events = header();
    more_events.events = 2;
    assert_eq!(
        unpack_error(&frame(&more_events)),
        Some(UnpackError::Events)
    );
    let mut more_pixels = header();
    (more_pixels.events, more_pixels.pixels) = (2, 2);
    assert!(unpack_error(&frame(&more_pixels)).is_some());
    let mut out = [0; 200];
    let range = seal(
        &Header {
            events: 0,
            pixels: 0,
            ..header()
        },
        1,
        &mut out,
    )
    .expect("room");
    assert_eq!(unpack_error(&out[range]), Some(UnpackError::Trailing));

    let good = Header {
        sequence: 1,
        last: true,
        ..header()
    };
    let stream = [frame(&more_events), frame(&good)].concat();
    let mut windows = WindowReader::new(FrameReader::new(&stream[..]));
    assert!(windows.next_window().expect("memory").is_some());
    assert!(windows.next_window().expect("memory").is_none());
    assert_eq!(windows.report().frames_malformed, 1);
}

/// A frame of 40 bytes states as many events as its header can hold: what no sensor sends is refused, before it is
/// decoded, unless the caller asks for it.
#[test]
fn windows_that_no_sensor_sends_are_refused_and_counted() {
    let of = |events: u32, pixels: u16, duration_us: u32| {
        let header = Header {
            window_events: events,
            events,
            pixels: pixels.into(),
            duration_us,
            last: true,
            ..header()
        };
        let of_each = events / u32::from(pixels);
        let pixels: Vec<_> = (0..pixels)
            .map(|pixel| Descriptor {
                x: pixel % header.sensor.width,
                y: pixel / header.sensor.width,
                on: of_each,
                off: 0,
                coded: Coded::Levels(Default::default()),
            })
            .collect();
        frame_of(&header, &pixels)
    };
    let read = |frame: &[u8], limit| {
        let mut windows = WindowReader::new(FrameReader::new(frame)).with_limit(limit);
        let window = windows.next_window().expect("memory");
        assert!(windows.next_window().expect("memory").is_none());
        let report = windows.report();
        assert_eq!(
            report.frames_crowded,
            u64::from(window.is_none()),
            "{report:?}"
        );
        assert_eq!(report.has_loss(), window.is_none());
        window.is_some()
    };
    let most = of((1 << 24) - 1, 1, 20_000);
    assert!(most.len() <= 40, "{} bytes", most.len());
    assert!(!read(&most, WindowLimit::Sensor));
    assert!(read(&most, WindowLimit::Events((1 << 24) - 1)));
    assert!(!read(&most, WindowLimit::Events((1 << 24) - 2)));
    // All events of a window: 2^20, or 1100 a microsecond.
    let all = |events, duration_us| read(&of(events, 64, duration_us), WindowLimit::Sensor);
    assert!(all(1 << 20, 9) && !all((1 << 20) + 64, 9));
    assert!(all(64 * 17_187, 1000) && !all(64 * 17_188, 1000));
    // Those of one pixel: 2^16, and one every 10 us.
    let one = |events, duration_us| read(&of(events, 1, duration_us), WindowLimit::Sensor);
    assert!(one(1 << 16, 9) && !one((1 << 16) + 1, 9));
    assert!(one((1 << 16) + 70_000, 700_000) && !one((1 << 16) + 70_001, 700_000));
    // What follows is read.
    let good = Header {
        sequence: 1,
        last: true,
        ..header()
    };
    let stream = [most, frame(&good)].concat();
    let mut windows = WindowReader::new(FrameReader::new(&stream[..]));
    let window = windows.next_window().expect("memory").expect("the second");
    assert_eq!(window.header.sequence, 1);
    assert_eq!(windows.report().frames_crowded, 1);
}

/// The header of a frame of the quick coder.
fn quick() -> Header {
    Header {
        mode: Mode::Hybrid(Hybrid {
            coder: Coder::Quick,
            fidelity: Fidelity::Lossless,
        }),
        transform: Regime::Sparse.transform(),
        last: true,
        window_events: 1,
        pixels: 0,
        ..header()
    }
}

/// Bits of the mode and fields that a frame of the quick coder does not have.
#[test]
fn headers_of_the_quick_coder_say_nothing_else() {
    let frame = sealed(&quick(), &[]);
    assert_eq!(frame[2], 4);
    let fields = &frame[4..usize::from(frame[3]) - 2];
    let parse = |fields: &[u8]| Frame::parse(&with_fields(&frame, fields)).map(|_| ());
    assert_eq!(parse(fields), Ok(()));
    // P and flags take a byte each.
    assert_eq!(fields[2], 3);
    for bit in 2..8 {
        let mut changed = fields.to_vec();
        changed[2] |= 1 << bit;
        assert_eq!(parse(&changed), Err(FrameError::HeaderInvalid), "{bit}");
    }
    // A tolerance with its value before the further flags, an order, no byte for the tree.
    let (before, further) = fields.split_at(fields.len() - 2);
    let mut tolerance = [before, &[9], further].concat();
    tolerance[2] |= 1 << 2;
    assert_eq!(parse(&tolerance), Err(FrameError::HeaderInvalid));
    let mut ordered = [before, &[0], further].concat();
    ordered[1] |= 1 << 7;
    assert_eq!(parse(&ordered), Err(FrameError::HeaderInvalid));
    assert_eq!(
        parse(&fields[..fields.len() - 1]),
        Err(FrameError::HeaderInvalid)
    );
    // Of another version.
    for version in [2, 3] {
        let mut other = frame.clone();
        other[2] = version;
        let end = usize::from(other[3]) - 2;
        let crc = crc16(&other[..end]).to_le_bytes();
        other[end..end + 2].copy_from_slice(&crc);
        assert_eq!(Frame::parse(&other), Err(FrameError::HeaderInvalid));
    }
}

/// A frame of the keys coder may have a fidelity, and has neither history nor order; its payload's events are counted
/// against its bytes before memory is taken for them.
#[test]
fn headers_of_the_keys_coder_say_nothing_else() {
    let with = |fidelity| Header {
        mode: Mode::Hybrid(Hybrid {
            coder: Coder::Keys,
            fidelity,
        }),
        ..quick()
    };
    for fidelity in [
        Fidelity::Lossless,
        Fidelity::ToleranceUs(9),
        Fidelity::Bins(9),
    ] {
        let header = with(fidelity);
        let frame = sealed(&header, &[]);
        assert_eq!(frame[2], 4);
        assert_eq!(Frame::parse(&frame).map(|frame| frame.header), Ok(header));
        let fields = &frame[4..usize::from(frame[3]) - 2];
        let parse = |fields: &[u8]| Frame::parse(&with_fields(&frame, fields)).map(|_| ());
        for bit in 4..8 {
            let mut changed = fields.to_vec();
            changed[2] |= 1 << bit;
            assert_eq!(parse(&changed), Err(FrameError::HeaderInvalid), "{bit}");
        }
        let (before, further) = fields.split_at(fields.len() - 2);
        assert_eq!(further, [0, 4]);
        let mut ordered = [before, &[0], further].concat();
        ordered[1] |= 1 << 7;
        assert_eq!(parse(&ordered), Err(FrameError::HeaderInvalid));
        // Levels that neither a tree nor this coder has.
        for tree in [8, 32, 36, 0xFC] {
            let other = [before, &[0, tree]].concat();
            assert_eq!(parse(&other), Err(FrameError::HeaderInvalid), "{tree}");
        }
        for payload in [&[][..], &[0; 20], &[0xFF; 300]] {
            let most = Header {
                window_events: (1 << 24) - 1,
                events: (1 << 24) - 1,
                ..header
            };
            let stream = sealed(&most, payload);
            let limit = WindowLimit::Events((1 << 24) - 1);
            let mut windows = WindowReader::new(FrameReader::new(&stream[..])).with_limit(limit);
            assert!(windows.next_window().expect("memory").is_none());
            assert_eq!(windows.report().frames_malformed, 1);
        }
    }
}

/// A payload of few bytes is refused before memory is taken for the events that its header states.
#[test]
fn payloads_of_the_quick_coder_hold_what_they_state() {
    let most = Header {
        window_events: (1 << 24) - 1,
        events: (1 << 24) - 1,
        ..quick()
    };
    let good = Header {
        sequence: 1,
        t0_us: 5000,
        ..quick()
    };
    for payload in [&[][..], &[0; 20], &[0xFF; 300], &payload_of_one()] {
        let stream = [sealed(&most, payload), sealed(&good, &payload_of_one())].concat();
        let limit = WindowLimit::Events((1 << 24) - 1);
        let mut windows = WindowReader::new(FrameReader::new(&stream[..])).with_limit(limit);
        let window = windows.next_window().expect("memory").expect("the second");
        assert_eq!(window.header.sequence, 1);
        assert_eq!(window.events.len(), 1);
        assert!(windows.next_window().expect("memory").is_none());
        assert_eq!(windows.report().frames_malformed, 1);
    }
}

/// The payload of an OFF event at the first pixel at t0.
fn payload_of_one() -> [u8; 4] {
    // Words of 7 bits for the 8 x 8 sensor; one byte of upper parts.
    [0x87, 0x00, 0x00, 0x01]
}

/// The events of a pixel need not follow each other.
#[test]
fn crowded_pixels_in_order_of_arrival_are_refused() {
    let sensor = Sensor::new(300, 200).expect("a sensor");
    let mut config = strategies::plain_config(sensor, Transform::Dct, 8);
    config.window.window_us = 9;
    let mut frames = |coder, of_pixel: u32| {
        let fidelity = Fidelity::Lossless;
        config.mode = Mode::Hybrid(Hybrid { coder, fidelity });
        let events: Vec<_> = (0..2 * of_pixel - 1)
            .map(|i| Event {
                t_us: 5,
                x: if i % 2 == 0 { 7 } else { (i % 250) as u16 },
                y: if i % 2 == 0 { 9 } else { (i % 190) as u16 + 10 },
                polarity: Polarity::On,
            })
            .collect();
        strategies::encode(config, &events, 1 << 18, FRAME_BYTES_MAX).concat()
    };
    for coder in [Coder::Keys, Coder::Quick] {
        for (of_pixel, is_read) in [(1 << 16, true), ((1 << 16) + 1, false)] {
            let stream = frames(coder, of_pixel);
            let mut windows = WindowReader::new(FrameReader::new(&stream[..]));
            assert_eq!(windows.next_window().expect("memory").is_some(), is_read);
            assert_eq!(windows.report().frames_crowded, u64::from(!is_read));
        }
    }
}

/// Headers of the windows that frames with these headers, numbered in order, make; and how many
/// frames were read when each window came.
fn windows(headers: &[Header]) -> Vec<(Header, usize, u64)> {
    let stream: Vec<u8> = (0..)
        .zip(headers)
        .flat_map(|(sequence, header)| {
            frame(&Header {
                sequence,
                ..*header
            })
        })
        .collect();
    let mut reader = WindowReader::new(FrameReader::new(&stream[..]));
    let mut windows = Vec::new();
    while let Some(window) = reader.next_window().expect("memory") {
        let Header { sensor, grid, .. } = window.header;
        for pixel in &window.pixels {
            assert!(sensor.contains(pixel.x, pixel.y));
            assert!(pixel.coefficients.iter().all(|(k, ..)| *k < grid));
        }
        windows.push((window.header, window.pixels.len(), reader.report().frames));
    }
    windows
}

#[test]
fn only_parts_of_one_window_are_put_together() {
    let first = header();
    let second = Header {
        part: 1,
        last: true,
        ..first
    };
    let shapes = |headers: &[Header]| -> Vec<usize> {
        windows(headers).iter().map(|window| window.1).collect()
    };
    assert_eq!(shapes(&[first, second]), [2]);
    // The last part closes the window without a look at the next frame.
    assert_eq!(windows(&[first, second, first])[0].2, 2);
    // A window of the same start begins with part 0, also after one whose end was lost.
    assert_eq!(shapes(&[first, first, second]), [1, 2]);
    // A frame of another sensor ends what is read.
    let mut other = second;
    other.sensor.width = 64;
    assert_eq!(shapes(&[first, other, second]), [1]);
    let changes: [fn(&mut Header); 6] = [
        |h| h.grid = 32,
        |h| h.m = 9,
        |h| h.transform = Transform::Dtft,
        |h| h.quantiser = Quantiser::new(0).expect("in range"),
        |h| h.window_events = 3,
        |h| h.duration_us = 999,
    ];
    for change in changes {
        let mut other = second;
        change(&mut other);
        assert_eq!(shapes(&[first, other]), [1, 1], "{other:?}");
    }
}

#[test]
fn endless_parts_do_not_grow_a_window() {
    let parts: Vec<_> = (0..20).map(|part| Header { part, ..header() }).collect();
    let windows = windows(&parts);
    assert_eq!(windows.len(), 10);
    assert!(windows.iter().all(|window| window.1 == 2));
}

#[test]
fn frames_claimed_inside_of_each_other_cost_no_more_than_their_length() {
    // Sound headers end to end, each of which claims the 16 MB that follow. Checking every one of
    // them would take an hour.
    let mut out = vec![0; FRAME_BYTES_MAX];
    let payload_bytes = FRAME_BYTES_MAX - 200;
    let range = seal(&header(), payload_bytes, &mut out).expect("room");
    let start = range.start;
    let header_bytes = usize::from(out[start + 3]);
    let claim = out[start..start + header_bytes].to_vec();
    let mut stream: Vec<u8> = claim.into_iter().cycle().take(40_000_000).collect();
    let mut reader = FrameReader::new(&stream[..]);
    assert!(reader.next_frame().expect("memory").is_none());
    assert_eq!(reader.report().damaged_bytes, 40_000_000);
    assert_eq!(reader.report().damaged_runs, 1);

    // Four of them, and a frame inside is still found.
    stream.truncate(4 * header_bytes);
    stream.extend(frame(&header()));
    stream.resize(FRAME_BYTES_MAX + 4 * header_bytes, 0);
    let mut reader = FrameReader::new(&stream[..]);
    let found = reader.next_frame().expect("memory").expect("a frame");
    assert_eq!(found.offset, 4 * header_bytes as u64);
}
