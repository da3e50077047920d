//! The worked example of docs/wire-format.md is what the encoder writes.

use eecvs::frame_file::{FrameFileWriter, FrameSink};
use eecvs::reconstruct::hybrid::HybridDecoder;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Frame, Hybrid, Mode, Polarity, Sensor, Transform,
};
use strategies::{encode, plain_config, sealed};

const DOCUMENT: &str = include_str!("../../docs/wire-format.md");

/// Returns the bytes in the table of a section of the document.
fn bytes_of(section: &str) -> String {
    let example = DOCUMENT
        .split(section)
        .nth(1)
        .and_then(|rest| rest.split("\n#").next())
        .expect("the example's section");
    example
        .lines()
        .filter_map(|line| line.split_once(" | `")?.1.split_once('`'))
        .flat_map(|(bytes, _)| bytes.split(' '))
        .collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

fn frame() -> Vec<u8> {
    let config = Config {
        grid: Some(4),
        ..plain_config(
            Sensor {
                width: 8,
                height: 4,
            },
            Transform::Dwt,
            2,
        )
    };
    let event = Event {
        t_us: 1000,
        x: 3,
        y: 1,
        polarity: Polarity::On,
    };
    encode(config, &[event], 10, 4096).concat()
}

#[test]
fn the_documents_quick_payload_is_true() {
    let sensor = Sensor {
        width: 640,
        height: 480,
    };
    let mut config = plain_config(sensor, Transform::Dct, 16);
    config.window.window_us = 1000;
    config.window.origin_us = Some(0);
    config.mode = Mode::Hybrid(Hybrid {
        coder: Coder::Quick,
        fidelity: Fidelity::Lossless,
    });
    let event = |t_us, x, y, on| Event {
        t_us,
        x,
        y,
        polarity: Polarity::from_bool(on),
    };
    let events = [
        event(3, 10, 20, true),
        event(9, 12, 21, false),
        event(9, 11, 20, true),
    ];
    let frame = encode(config, &events, 10, 4096).concat();
    let frame = Frame::parse(&frame).expect("a frame");
    assert_eq!(
        bytes_of("\n#### Worked example of the quick coder"),
        hex(frame.payload)
    );
}

#[test]
fn the_documents_keys_payload_is_true() {
    let sensor = Sensor {
        width: 8,
        height: 4,
    };
    let mut config = plain_config(sensor, Transform::Dct, 16);
    config.window.window_us = 16;
    config.window.origin_us = Some(1000);
    const HYBRID: Hybrid = Hybrid {
        coder: Coder::Keys,
        fidelity: Fidelity::Lossless,
    };
    config.mode = Mode::Hybrid(HYBRID);
    let event = |t_us, x, y, on| Event {
        t_us,
        x,
        y,
        polarity: Polarity::from_bool(on),
    };
    let events = [
        event(1002, 3, 0, true),
        event(1005, 3, 0, true),
        event(1005, 1, 2, false),
        event(1006, 1, 2, true),
        event(1014, 2, 2, true),
    ];
    let frame = encode(config, &events, 10, 4096).concat();
    let frame = Frame::parse(&frame).expect("a frame");
    assert_eq!(
        bytes_of("\n#### Worked example of the preset code"),
        hex(frame.payload)
    );
    // With a code of its own.
    let payload = bytes_of("\n#### Worked example of the keys coder");
    let digits: Vec<_> = payload.bytes().collect();
    let payload: Vec<u8> = digits
        .chunks(2)
        .map(|two| {
            let two = std::str::from_utf8(two).expect("digits");
            u8::from_str_radix(two, 16).expect("a byte")
        })
        .collect();
    let frame = sealed(&frame.header, &payload);
    let frame = Frame::parse(&frame).expect("a frame");
    let decoded = HybridDecoder::default().frame(&frame, HYBRID);
    assert_eq!(decoded.as_deref(), Ok(&events[..]));
}

#[test]
fn the_documents_frame_is_true() {
    assert_eq!(bytes_of("\n## Worked example"), hex(&frame()));
}

#[test]
fn the_documents_file_is_true() {
    let frame = frame();
    let mut out = FrameFileWriter::new(Vec::new());
    let header = Frame::parse(&frame).expect("a frame").header;
    out.frame(&header, &frame).expect("memory");
    let file = out.finish().expect("memory");
    let (begin, end) = (&file[..12], &file[12 + frame.len()..]);
    assert_eq!(bytes_of("\n### Worked example"), hex(begin) + &hex(end));
}
