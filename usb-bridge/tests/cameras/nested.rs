//! Streams of messages that are nested to cost work: headers without end, each of which claims all that follows.

use eecvs::encode::HostStorage;
use eecvs::frame_file::FrameReader;
use eecvs_nostd::frame::{self, HEADER_BYTES_MAX};
use eecvs_nostd::{
    Config, Event, FRAME_BYTES_MAX, Mode, Polarity, Sensor, Thresholds, WindowConfig,
};
use mcu_link::link::Demultiplexer;
use usb_bridge::device::mcu::messages::{self, Messages};
use usb_bridge::forward::demux::Demux;
use usb_bridge::forward::packet::{Packet, WORDS_BYTES_MAX};

const STREAM_BYTES: usize = 1 << 21;
/// Bytes that arrive at a time.
const PIECE_BYTES: usize = 1 << 14;
const SENSOR: Sensor = Sensor {
    width: 8,
    height: 8,
};

/// Headers of frames with a payload of this many bytes, one behind the other.
fn frames(payload_bytes: usize) -> Vec<u8> {
    let thresholds = Thresholds::new(0, 0).expect("in order");
    let config = Config::new(WindowConfig::new(SENSOR, 1000), thresholds, Mode::Transform);
    let mut storage = HostStorage::new(SENSOR, 10);
    let mut encoder = storage.encoder(config).expect("a valid configuration");
    let event = Event {
        t_us: 5,
        x: 1,
        y: 2,
        polarity: Polarity::On,
    };
    let _ = encoder.push(event);
    encoder.flush();
    let mut out = vec![0; HEADER_BYTES_MAX + payload_bytes + 4];
    let header = encoder
        .next_frame(&mut out)
        .expect("room")
        .expect("a frame")
        .header;
    out.fill(0);
    let range = frame::seal(&header, payload_bytes, &mut out).expect("room");
    let sealed = &out[range];
    sealed[..usize::from(sealed[3])].repeat(STREAM_BYTES / usize::from(sealed[3]))
}

/// Headers of the longest packets of raw events.
fn packets() -> Vec<u8> {
    let mut packet = Vec::new();
    let words = vec![0; WORDS_BYTES_MAX];
    Packet {
        encoding: "evk4/evt3",
        sensor: SENSOR,
        sequence: 0,
        time_base_us: None,
        after_loss: false,
        events: 0,
        words: &words,
    }
    .write(&mut packet);
    let header = packet.len() - WORDS_BYTES_MAX - 4;
    packet[..header].repeat(STREAM_BYTES / header)
}

/// Work that grows with the stream: a few times the longest message and the stream's bytes.
fn check(checked: u64, longest: usize, stream: &[u8]) {
    // Searched within the budget, and the rest once.
    let most = (4 * longest + 6 * stream.len()) as u64;
    assert!(
        (stream.len() as u64..=most).contains(&checked),
        "{checked} of {}",
        stream.len()
    );
}

#[test]
fn frames_in_a_file_take_work_by_their_bytes() {
    let stream = frames(STREAM_BYTES / 4);
    let mut reader = FrameReader::new(&stream[..]);
    assert!(reader.next_frame().expect("memory does not fail").is_none());
    assert_eq!(reader.report().damaged_bytes, stream.len() as u64);
    check(reader.checked_bytes(), FRAME_BYTES_MAX, &stream);
}

#[test]
fn messages_of_a_stream_take_work_by_their_bytes() {
    for stream in [frames(STREAM_BYTES / 4), packets()] {
        let mut demux = Demux::default();
        for piece in stream.chunks(PIECE_BYTES) {
            demux.push(piece);
            assert!(demux.next_message().is_none());
        }
        demux.interrupt();
        assert_eq!(demux.rest_bytes(), 0);
        assert_eq!(demux.damaged_bytes(), stream.len() as u64);
        check(demux.checked_bytes(), FRAME_BYTES_MAX, &stream);
    }
}

#[test]
fn frames_of_an_encoder_take_work_by_their_bytes() {
    let longest = messages::FRAME_BYTES_MAX;
    let stream = frames(longest - 100);
    let mut messages = Messages::default();
    let mut link = Demultiplexer::default();
    for piece in stream.chunks(PIECE_BYTES) {
        messages.push(piece);
        assert!(messages.next().is_none());
        link.push(piece);
        assert!(link.next_message().is_none());
    }
    while messages.has_begun() {
        messages.give_up();
        assert!(messages.next().is_none());
    }
    while link.is_incomplete() {
        link.give_up();
        assert!(link.next_message().is_none());
    }
    assert_eq!(messages.damaged().0, stream.len() as u64);
    assert_eq!(link.damaged_bytes(), stream.len() as u64);
    check(messages.checked_bytes(), longest, &stream);
    check(link.checked_bytes(), longest, &stream);
}
