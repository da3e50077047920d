//! Received bytes to frames by two windows in turn: the same frames as by one window, and every
//! event accounted for whatever happens to the link.

use std::collections::VecDeque;

use eecvs_nostd::event_link::{
    BODY_BYTES_MAX, FIELDS_BYTES_MAX, HotNumbers, Kind, PACKET_BYTES_MAX, Packet, Setup,
};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::from_link::Link;
use eecvs_nostd::ingest::{Counts, Exchange, Ingest, Poll, Work};
use eecvs_nostd::{
    Config, Encoder, Event, Frame, Mode, Polarity, Push, Scratch, Sensor, Thresholds, Window,
    WindowBuffers, WindowConfig, WindowEncoder,
};
use proptest::prelude::*;

const SENSOR: Sensor = Sensor {
    width: 70,
    height: 9,
};
const WINDOW_US: u32 = 1000;
/// Room for few events, so that windows also close early.
const MEMORY_WORDS: usize = 2 * (32 + 2 * 40);

fn config() -> Config {
    Config {
        m: 8,
        ..Config::new(
            WindowConfig::new(SENSOR, WINDOW_US),
            Thresholds::new(1_000_000_000_000, 50_000_000_000_000).unwrap(),
            Mode::Transform,
        )
    }
}

fn setup(when_full: u8, time_base_us: u64) -> Setup {
    Setup {
        when_full,
        ..Setup::new(&config(), time_base_us)
    }
}

/// The link's bytes for a setup, events and a flush; the packets' boundaries too.
fn packets(events: &[Event], body_bytes: usize, when_full: u8) -> Vec<Vec<u8>> {
    packets_without(&[], events, body_bytes, when_full)
}

/// The same with hot pixels, in two packets, after the setup.
fn packets_without(
    hot: &[(u16, u16)],
    events: &[Event],
    body_bytes: usize,
    when_full: u8,
) -> Vec<Vec<u8>> {
    let mut packets = Vec::new();
    let mut put = |kind, position, body: &[u8]| {
        let mut out = [0; PACKET_BYTES_MAX];
        let packet = Packet {
            kind,
            position,
            body,
        };
        let len = packet.write(&mut out).unwrap();
        packets.push(out[..len].to_vec());
    };
    let base_us = events.first().map_or(0, |event| event.t_us);
    let mut body = [0; FIELDS_BYTES_MAX];
    let len = setup(when_full, base_us).write(&mut body).unwrap();
    put(Kind::Setup, 0, &body[..len]);
    let (one, other) = hot.split_at(hot.len() / 2);
    for half in [one, other].into_iter().filter(|half| !half.is_empty()) {
        let mut numbers: Vec<_> = half.iter().map(|pixel| SENSOR.number(*pixel)).collect();
        numbers.sort_unstable();
        let (mut body, mut writer) = ([0; BODY_BYTES_MAX], HotNumbers::START);
        assert!(
            numbers
                .iter()
                .all(|number| writer.write(*number, &mut body))
        );
        put(Kind::Hot, 0, &body[..writer.bytes()]);
    }
    let mut words = Evt2Encoder::new(base_us);
    let (mut body, mut position, mut sent) = (Vec::new(), 0, 0);
    words.restate_time();
    for event in events {
        if body.len() + 8 > body_bytes {
            put(Kind::Words, position, &body);
            body.clear();
            position = sent;
            words.restate_time();
        }
        let (due, word) = words.encode(*event).expect("fits");
        for word in due.into_iter().chain([word]) {
            body.extend(word.to_le_bytes());
        }
        sent += 1;
    }
    put(Kind::Words, position, &body);
    put(Kind::Flush, sent, &[]);
    packets
}

/// The encoding side of a microcontroller, run at moments that the test chooses.
#[derive(Default)]
struct Side {
    free: VecDeque<Window<'static>>,
    work: VecDeque<Work<'static>>,
}

impl Exchange<'static> for Side {
    fn free(&mut self) -> Option<Window<'static>> {
        self.free.pop_front()
    }

    fn has_room(&self) -> bool {
        self.work.len() < 3
    }

    fn hand_over(&mut self, work: Work<'static>) {
        self.work.push_back(work);
    }
}

struct Machine {
    link: Link,
    ingest: Ingest<'static>,
    side: Side,
    encoder: Option<WindowEncoder<'static>>,
    frames: Vec<u8>,
    flushed: Vec<Counts>,
    setups: usize,
    /// Pixels kept out, at each answer.
    hot: Vec<usize>,
}

fn leak<T: Clone>(value: T, len: usize) -> &'static mut [T] {
    Box::leak(vec![value; len].into_boxed_slice())
}

impl Machine {
    fn new() -> Self {
        Self {
            link: Link::new(),
            ingest: Ingest::new(),
            side: Side::default(),
            encoder: None,
            frames: Vec::new(),
            flushed: Vec::new(),
            setups: 0,
            hot: Vec::new(),
        }
    }

    /// One piece of the encoding side's work.
    fn work(&mut self) {
        match self.side.work.pop_front() {
            None => {}
            Some(Work::Flush(counts)) => self.flushed.push(counts),
            Some(Work::Hot(number)) => {
                let pixel = SENSOR.pixel(number).expect("on the sensor");
                let encoder = self.encoder.as_mut().expect("set up before");
                encoder.add_hot(pixel).expect("room");
            }
            Some(Work::HotEnd(_)) => {
                let encoder = self.encoder.as_ref().expect("set up before");
                self.hot.push(encoder.hot_count());
            }
            Some(Work::Setup(setup, _)) => {
                let config = setup.config().expect("the test's own");
                let scratch = Scratch {
                    sums: leak(Sum::ZERO, 64),
                    totals: leak(WideSum::ZERO, 64),
                    magnitudes: leak(0, 64),
                    dense: None,
                    tree: None,
                    keys: None,
                    coefficients: None,
                    hot: leak(0, 40),
                    order: &mut [],
                };
                self.encoder = Some(WindowEncoder::new(config, scratch).unwrap());
                let buffers =
                    WindowBuffers::share(leak(0, MEMORY_WORDS), 2, &config.windows()).unwrap();
                for buffers in buffers {
                    self.side
                        .free
                        .push_back(Window::new(config.windows(), buffers).unwrap());
                }
                self.setups += 1;
                self.ingest.set_up(&setup, 2);
            }
            Some(Work::Window(mut window)) => {
                let mut out = [0; 1400];
                let encoder = self.encoder.as_mut().expect("set up before windows come");
                while let Some(frame) = encoder.next_frame(&mut window, &mut out).unwrap() {
                    self.frames.extend(&out[frame.range]);
                }
                self.side.free.push_back(window);
            }
        }
    }

    /// Feeds bytes; `pace` says how many polls pass between two pieces of work.
    fn receive(&mut self, bytes: &[u8], chunk: usize, pace: usize) {
        let mut bytes = bytes.iter().copied();
        let mut polls = 0_usize;
        loop {
            let mut budget = chunk;
            let poll = self.ingest.poll(
                &mut self.link.source(|| {
                    budget = budget.checked_sub(1)?;
                    bytes.next()
                }),
                &mut self.side,
            );
            polls += 1;
            if poll == Poll::Stalled || polls.is_multiple_of(pace) {
                self.work();
            }
            if poll == Poll::Idle && bytes.len() == 0 {
                break;
            }
        }
        while !self.side.work.is_empty() {
            self.work();
            self.ingest
                .poll(&mut self.link.source(|| None), &mut self.side);
        }
    }
}

/// The frames of one window that is encoded as soon as it closes.
fn expected(events: &[Event]) -> Vec<u8> {
    expected_without(&[], events)
}

fn expected_without(hot: &[(u16, u16)], events: &[Event]) -> Vec<u8> {
    let mut memory = vec![0; MEMORY_WORDS];
    let buffers = WindowBuffers::share(&mut memory, 2, &WindowConfig::new(SENSOR, 1))
        .unwrap()
        .next()
        .unwrap();
    let (mut sums, mut totals, mut magnitudes) = ([Sum::ZERO; 64], [WideSum::ZERO; 64], [0; 64]);
    let scratch = Scratch {
        sums: &mut sums,
        totals: &mut totals,
        magnitudes: &mut magnitudes,
        dense: None,
        tree: None,
        keys: None,
        coefficients: None,
        hot: &mut [0; 40],
        order: &mut [],
    };
    let mut encoder = Encoder::set_up(config(), buffers, scratch).unwrap();
    for pixel in hot {
        encoder.add_hot(*pixel).unwrap();
    }
    let mut frames = Vec::new();
    let mut out = [0; 1400];
    let mut take = |encoder: &mut Encoder<'_>| {
        while let Some(frame) = encoder.next_frame(&mut out).unwrap() {
            frames.extend(&out[frame.range]);
        }
    };
    for event in events {
        while encoder.push(*event) == Push::Closed {
            take(&mut encoder);
        }
    }
    encoder.flush();
    take(&mut encoder);
    frames
}

/// Events in frames, late, dropped; no frame may lie outside of the recording's time.
fn accounted(mut frames: &[u8], events: &[Event]) -> (u64, u64, u64) {
    let mut sums = (0, 0, 0);
    let last_us = events.iter().map(|event| event.t_us).max().unwrap_or(0);
    while !frames.is_empty() {
        let frame = Frame::parse(frames).expect("the encoder's own");
        assert!(frame.header.events == 0 || frame.header.t0_us <= last_us);
        sums.0 += u64::from(frame.header.events);
        sums.1 += u64::from(frame.header.late);
        sums.2 += u64::from(frame.header.dropped);
        frames = &frames[frame.bytes..];
    }
    sums
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    let step = prop_oneof![8 => -20_i64..60, 1 => -3000..9000_i64];
    proptest::collection::vec((step, 0..75_u16, 0..9_u16, any::<bool>()), 0..400).prop_map(
        |steps| {
            let base_us = 5_000_000_u64;
            let mut t_us = base_us;
            steps
                .into_iter()
                .enumerate()
                .map(|(i, (step, x, y, on))| {
                    if i > 0 {
                        t_us = t_us.saturating_add_signed(step).max(base_us);
                    }
                    Event {
                        t_us,
                        x,
                        y,
                        polarity: Polarity::from_bool(on),
                    }
                })
                .collect()
        },
    )
}

proptest! {
    /// However slow the encoding side is: a receiver that waits loses nothing, and its frames are
    /// those of one window.
    #[test]
    fn two_windows_give_the_frames_of_one(
        events in events(), body in 8..=BODY_BYTES_MAX, chunk in 1..2000_usize, pace in 1..40_usize,
    ) {
        let mut machine = Machine::new();
        machine.receive(&packets(&events, body, Setup::WAIT).concat(), chunk, pace);
        prop_assert_eq!(&machine.frames, &expected(&events));
        prop_assert_eq!(machine.flushed.len(), 1);
        let counts = machine.flushed[0];
        prop_assert_eq!(counts, Counts { events: events.len() as u32, ..Counts::default() });
    }

    /// Hot pixels are kept out of every window after them, and filtered.
    #[test]
    fn hot_pixels_are_kept_out(
        hot in proptest::collection::vec((0..70_u16, 0..9_u16), 1..40), events in events(),
        chunk in 1..2000_usize, pace in 1..40_usize,
    ) {
        let mut machine = Machine::new();
        let stream = packets_without(&hot, &events, 200, Setup::WAIT).concat();
        machine.receive(&stream, chunk, pace);
        prop_assert_eq!(&machine.frames, &expected_without(&hot, &events));
        let distinct: std::collections::BTreeSet<_> = hot.iter().collect();
        prop_assert_eq!(machine.hot.last(), Some(&distinct.len()));
        // The next setup knows none of them.
        machine.frames.clear();
        machine.receive(&packets(&events, 200, Setup::WAIT).concat(), chunk, pace);
        prop_assert_eq!(&machine.frames, &expected(&events));
    }

    /// A receiver that drops tells in its frames what it dropped.
    #[test]
    fn what_is_dropped_is_counted(
        events in events(), body in 8..=BODY_BYTES_MAX, chunk in 1..2000_usize, pace in 1..200_usize,
    ) {
        let mut machine = Machine::new();
        machine.receive(&packets(&events, body, Setup::DROP).concat(), chunk, pace);
        let (encoded, late, dropped) = accounted(&machine.frames, &events);
        prop_assert_eq!(encoded + late + dropped, events.len() as u64);
        prop_assert_eq!(machine.flushed.len(), 1);
    }

    /// Packets that were lost or damaged are counted by the positions of those around them.
    #[test]
    fn what_the_link_loses_is_counted(
        events in events(), body in 8..100_usize, chunk in 1..2000_usize, pace in 1..40_usize,
        faults in proptest::collection::vec((any::<u16>(), any::<u16>(), 0..4_u8), 0..6),
    ) {
        let mut packets = packets(&events, body, Setup::WAIT);
        let words = packets.len() - 2;
        for (packet, byte, fault) in faults {
            let packet = &mut packets[1 + usize::from(packet) % words];
            match fault {
                0 => packet.clear(),
                1 => packet.truncate(usize::from(byte) % packet.len().max(1)),
                2 => packet.extend([0xEE, 0xC6, 2, 0xEE]),
                _ => {
                    let at = usize::from(byte) % packet.len().max(1);
                    if let Some(byte) = packet.get_mut(at) {
                        *byte ^= 0x41;
                    }
                }
            }
        }
        // A damaged length may swallow what follows, the flush too: the sender pads.
        let mut stream = packets.concat();
        let flush = packets.last().unwrap().clone();
        for _ in 0..PACKET_BYTES_MAX.div_ceil(flush.len()) {
            stream.extend(&flush);
        }
        let mut machine = Machine::new();
        machine.receive(&stream, chunk, pace);
        let (encoded, late, dropped) = accounted(&machine.frames, &events);
        prop_assert_eq!(encoded + late + dropped, events.len() as u64);
    }

    /// A setup in the middle of a stream flushes first and starts anew.
    #[test]
    fn a_setup_loses_nothing(
        first in events(), second in events(), chunk in 1..2000_usize, pace in 1..40_usize,
    ) {
        let mut machine = Machine::new();
        let mut stream = packets(&first, 200, Setup::WAIT);
        stream.pop();
        stream.extend(packets(&second, 60, Setup::WAIT));
        machine.receive(&stream.concat(), chunk, pace);
        prop_assert_eq!(machine.setups, 2);
        prop_assert_eq!(&machine.frames, &[expected(&first), expected(&second)].concat());
    }

    #[test]
    fn any_bytes_are_survived(
        bytes in proptest::collection::vec(
            prop_oneof![any::<u8>(), Just(0xEE), Just(0xC6), Just(2), Just(0)], 0..3000,
        ),
        events in events(), pace in 1..40_usize,
    ) {
        let mut machine = Machine::new();
        machine.receive(&bytes, 100, pace);
        machine.receive(&packets(&events, 100, Setup::WAIT).concat(), 100, pace);
        machine.receive(&bytes, 100, pace);
    }
}

/// Before a setup nothing runs: events are counted and the flush is answered.
#[test]
fn without_a_setup_events_are_counted() {
    let events: Vec<Event> = (0..10)
        .map(|i| Event {
            t_us: i,
            x: 1,
            y: 1,
            polarity: Polarity::On,
        })
        .collect();
    let mut machine = Machine::new();
    machine.receive(&packets(&events, 100, Setup::WAIT)[1..].concat(), 50, 3);
    assert_eq!(machine.flushed[0].dropped, 10);
    assert_eq!(machine.flushed[0].events, 10);
    assert!(machine.frames.is_empty());
}
