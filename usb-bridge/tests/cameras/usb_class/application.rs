//! The firmware's encoder in the application's place, fed by the link or by a sensor of its own.

use std::collections::VecDeque;

use eecvs_nostd::coder::dense::model::Model;
use eecvs_nostd::coder::dense::{DenseMemory, words};
use eecvs_nostd::event_link::{
    FIELDS_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, Refusal, Setup, Status,
};
use eecvs_nostd::evt2::Evt2Encoder;
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::from_link::Link;
use eecvs_nostd::ingest::from_sensor::{Block, Port, SensorSource};
use eecvs_nostd::ingest::{Counts, Exchange, Ingest, Work};
use eecvs_nostd::{Coder, Event, Hybrid, Mode, Scratch, Window, WindowBuffers, WindowEncoder};
use eecvs_usb_class::{Outgoing, Sender};
use heapless::spsc::Queue;
use usb_bridge::peripheral::class_bus::{Application, ClassBus, Inbox};
use usb_bridge::peripheral::wire::Wire;
use usb_device::bus::UsbBusAllocator;

/// Words of the windows.
const MEMORY_WORDS: usize = 2 * 700;
const FRAME_BYTES: usize = 2048;
const NUMBERS: usize = 128;
/// Words between the sensor's interrupt and ingest.
const SENSOR_WORDS: usize = 512;

/// Both sides' exchange, as in the firmware.
#[derive(Default)]
struct Queues {
    free: VecDeque<Window<'static>>,
    work: VecDeque<Work<'static>>,
}

impl Exchange<'static> for Queues {
    fn free(&mut self) -> Option<Window<'static>> {
        self.free.pop_front()
    }

    fn has_room(&self) -> bool {
        self.work.len() < 4
    }

    fn hand_over(&mut self, work: Work<'static>) {
        self.work.push_back(work);
    }
}

fn leak<T: Clone>(value: T, len: usize) -> &'static mut [T] {
    Box::leak(vec![value; len].into_boxed_slice())
}

/// The firmware's two sides, one after the other.
pub struct Encoder {
    link: Link,
    sensor: Option<OwnSensor>,
    /// Setups so far.
    setups: u32,
    ingest: Ingest<'static>,
    queues: Queues,
    encoder: Option<WindowEncoder<'static>>,
    window: Option<Window<'static>>,
    /// What waits for room in the queue to the host.
    message: Option<Vec<u8>>,
    status: Status,
}

/// A sensor on a port of its own, whose events come as soon as a host has set the encoder up.
struct OwnSensor {
    port: Port<'static, 'static>,
    source: SensorSource<'static, 'static>,
    /// The block that the transfer fills, a word at a time.
    block: Option<Block<'static>>,
    words: VecDeque<u32>,
}

impl Encoder {
    /// One whose events the host sends.
    pub fn new() -> Self {
        Self {
            link: Link::new(),
            sensor: None,
            setups: 0,
            ingest: Ingest::new(),
            queues: Queues::default(),
            encoder: None,
            window: None,
            message: None,
            status: Status::default(),
        }
    }

    /// One beside a sensor that sees `events`; it begins with `setup`.
    pub fn with_sensor(setup: Setup, events: &[Event]) -> Self {
        let filled: &'static mut Queue<_, SENSOR_WORDS> = Box::leak(Box::new(Queue::new()));
        let free: &'static mut Queue<Block<'_>, SENSOR_WORDS> = Box::leak(Box::new(Queue::new()));
        let ((put_filled, take_filled), (mut put_free, take_free)) = (filled.split(), free.split());
        for word in leak([0; 4], SENSOR_WORDS - 1).chunks_mut(1) {
            put_free.enqueue(word).unwrap();
        }
        let mut encoder = Evt2Encoder::new(0);
        let mut words = VecDeque::new();
        for event in events {
            let (time, word) = encoder.encode(*event).unwrap();
            words.extend(time.into_iter().chain([word]));
        }
        Self {
            sensor: Some(OwnSensor {
                port: Port::new(put_filled, take_free),
                source: SensorSource::new(take_filled, put_free, setup),
                block: Some(leak([0; 4], 1)),
                words,
            }),
            ..Self::new()
        }
    }

    /// The device with it, attached to a bus in memory; one that a thread may have is there for good.
    pub fn on_a_bus(self) -> ClassBus<'static, Self> {
        let wire = Wire::default();
        let allocator = Box::leak(Box::new(UsbBusAllocator::new(wire.clone())));
        let ends = Box::leak(Box::new(Outgoing::new())).split();
        ClassBus::new(&wire, allocator, ends, "1", self).unwrap()
    }

    /// Takes what the source brings, as far as windows are free.
    fn ingest(&mut self, inbox: &mut Inbox) {
        let link = self.link.source(|| inbox.take());
        let Some(sensor) = &mut self.sensor else {
            let mut link = link;
            self.ingest.poll(&mut link, &mut self.queues);
            return;
        };
        self.ingest
            .poll(&mut sensor.source.with_host(link), &mut self.queues);
    }

    /// The sensor's next word, while nothing waits for a window; `false` where there is none.
    fn see(&mut self) -> bool {
        let Some(sensor) = &mut self.sensor else {
            return false;
        };
        // Its own setup was the first.
        let word = sensor.words.front().filter(|_| self.setups > 1);
        let Some(word) = word.copied() else {
            return false;
        };
        sensor.words.pop_front();
        let Some(block) = sensor.block.take() else {
            return false;
        };
        block.fill(word.to_le_bytes());
        sensor.block = Some(sensor.port.exchange(block, 1));
        true
    }

    /// The encoder for a setup, its windows among the free ones, and how many they are.
    fn set_up(&mut self, setup: &Setup) -> Result<usize, Refusal> {
        self.encoder = None;
        self.status.dense_words = 0;
        let config = setup.config()?;
        let sensor = config.window.sensor;
        let dense = match config.mode {
            Mode::Hybrid(Hybrid {
                coder: Coder::Dense,
                ..
            }) => {
                let words = leak(0, words(sensor, false));
                self.status.dense_words = words.len() as u32;
                let model = Box::leak(Box::new(Model::UNSET));
                Some(DenseMemory { model, words })
            }
            _ => None,
        };
        let scratch = Scratch {
            sums: leak(Sum::ZERO, NUMBERS),
            totals: leak(WideSum::ZERO, NUMBERS),
            magnitudes: leak(0, NUMBERS),
            dense,
            tree: None,
            keys: None,
            coefficients: None,
            hot: leak(0, 4),
            order: &mut [],
        };
        let encoder = WindowEncoder::new(config, scratch)?;
        let shares = WindowBuffers::share(leak(0, MEMORY_WORDS), 2, &config.windows());
        for buffers in shares.ok_or(Refusal::Windows)? {
            self.status.window_events = buffers.slots.len() as u32;
            let window = Window::new(config.windows(), buffers);
            self.queues.free.extend(window);
        }
        self.encoder = Some(encoder);
        Ok(2)
    }

    fn answer(&mut self, kind: Kind, counts: Counts) {
        self.status = Status {
            answers: kind as u8,
            running: self.encoder.is_some(),
            frame_bytes: FRAME_BYTES as u32,
            events: counts.events,
            lost: counts.lost,
            dropped: counts.dropped,
            ignored: counts.ignored.wrapping_add(self.link.ignored()),
            damaged_bytes: self.link.damaged_bytes(),
            ..self.status
        };
        let (mut body, mut packet) = ([0; FIELDS_BYTES_MAX], [0; PACKET_BYTES_MAX]);
        let len = self.status.write(&mut body).unwrap();
        let status = Packet {
            kind: Kind::Status,
            position: counts.events,
            body: &body[..len],
        };
        let len = status.write(&mut packet).unwrap();
        self.message = Some(packet[..len].to_vec());
    }

    /// One piece of work; `false` where there is none.
    fn step(&mut self, sender: &mut Sender<'_>) -> bool {
        if let (Some(window), Some(encoder)) = (&mut self.window, &mut self.encoder) {
            let mut out = [0; FRAME_BYTES];
            match encoder.next_frame(window, &mut out).unwrap() {
                Some(frame) => {
                    self.status.frames += 1;
                    self.message = Some(out[frame.range].to_vec());
                }
                None => self.queues.free.extend(self.window.take()),
            }
            return true;
        }
        match self.queues.work.pop_front() {
            None => return false,
            Some(Work::Window(window)) => {
                self.status.windows += u32::from(window.events() > 0);
                self.window = Some(window);
            }
            Some(Work::Setup(setup, counts)) => {
                sender.follow();
                self.setups += 1;
                let windows = self.set_up(&setup);
                self.status.refusal = windows.err();
                self.ingest.set_up(&setup, windows.unwrap_or(0));
                self.answer(Kind::Setup, counts);
            }
            Some(Work::Flush(counts)) => self.answer(Kind::Flush, counts),
            Some(Work::HotEnd(counts)) => self.answer(Kind::Hot, counts),
            Some(Work::Hot(_)) => {}
        }
        true
    }
}

impl Application for Encoder {
    fn work(&mut self, inbox: &mut Inbox, sender: &mut Sender<'_>) {
        if inbox.has_restarted() {
            self.link.restart(0);
        }
        loop {
            self.ingest(inbox);
            if let Some(message) = self.message.take() {
                if sender.is_heard() && !sender.has_room(message.len()) {
                    self.message = Some(message);
                    return;
                }
                sender.send(&message, || false);
            }
            if !self.step(sender) && inbox.is_empty() && !self.see() {
                return;
            }
        }
    }
}
