//! The encoder behind the class: a recording goes in over the bus as packets, and every frame that comes
//! back has the bytes of the host's own.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::Result;
use eecvs_nostd::event_link::{FIELDS_BYTES_MAX, Kind, PACKET_BYTES_MAX, Packet, Status};
use eecvs_nostd::fixed_point::{Sum, WideSum};
use eecvs_nostd::ingest::{Counts, Exchange, Ingest, Work};
use eecvs_nostd::link_source::Link;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Polarity, Quantiser,
    Scratch, Sensor, Thresholds, Window, WindowBuffers, WindowConfig, WindowEncoder,
};
use eecvs_usb_class::{FROM_HOST, Outgoing, Sender, TO_HOST};
use host_harness::formats::{EventReader, Skipped};
use host_harness::mcu::connection::{Connection, Halves};
use host_harness::mcu::{self, Job};
use usb_bridge::peripheral::class_bus::{Application, ClassBus, Inbox};
use usb_bridge::peripheral::wire::Wire;
use usb_bridge::peripheral::{Bulk, Peripheral};
use usb_device::bus::UsbBusAllocator;

use crate::script::{SERIAL_FROM_HOST, SERIAL_TO_HOST};

const SENSOR: Sensor = Sensor {
    width: 70,
    height: 40,
};
const MEMORY_WORDS: usize = 2 * 700;
const FRAME_BYTES: usize = 2048;
const NUMBERS: usize = 64;

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
struct Encoder {
    link: Link,
    ingest: Ingest<'static>,
    queues: Queues,
    encoder: Option<WindowEncoder<'static>>,
    window: Option<Window<'static>>,
    /// What waits for room in the queue to the host.
    message: Option<Vec<u8>>,
    status: Status,
}

impl Encoder {
    fn new() -> Self {
        Self {
            link: Link::new(),
            ingest: Ingest::new(),
            queues: Queues::default(),
            encoder: None,
            window: None,
            message: None,
            status: Status::default(),
        }
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
                let config = setup.config().unwrap();
                let scratch = Scratch {
                    sums: leak(Sum::ZERO, NUMBERS),
                    totals: leak(WideSum::ZERO, NUMBERS),
                    magnitudes: leak(0, NUMBERS),
                    dense: None,
                    coefficients: None,
                    hot: leak(0, 4),
                    order: &mut [],
                };
                self.encoder = Some(WindowEncoder::new(config, scratch).unwrap());
                let shares = WindowBuffers::share(leak(0, MEMORY_WORDS), 2, config.window.sensor);
                for buffers in shares.unwrap() {
                    self.status.window_events = buffers.slots.len() as u32;
                    let window = Window::new(config.window, buffers);
                    self.queues.free.extend(window);
                }
                self.ingest.set_up(&setup, 2);
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
            self.ingest
                .poll(&mut self.link.source(|| inbox.take()), &mut self.queues);
            if let Some(message) = self.message.take() {
                if sender.is_heard() && !sender.has_room(message.len()) {
                    self.message = Some(message);
                    return;
                }
                sender.send(&message, || false);
            }
            if !self.step(sender) && inbox.is_empty() {
                return;
            }
        }
    }
}

type Device = Arc<Mutex<ClassBus<'static, Encoder>>>;

/// One function of the device, as a stream of bytes.
#[derive(Clone)]
struct Function {
    device: Device,
    to_host: u8,
    from_host: u8,
}

impl Read for Function {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let mut data = Vec::new();
        let room = bytes.len() / 64 * 64;
        let mut device = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        match device.bulk_in(self.to_host, room, &mut data) {
            Bulk::Data if !data.is_empty() => {
                bytes[..data.len()].copy_from_slice(&data);
                Ok(data.len())
            }
            Bulk::Stall => Err(ErrorKind::BrokenPipe.into()),
            _ => {
                drop(device);
                thread::sleep(Duration::from_micros(100));
                Err(ErrorKind::WouldBlock.into())
            }
        }
    }
}

impl Write for Function {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut device = self.device.lock().unwrap_or_else(PoisonError::into_inner);
        if device.held_bytes(self.from_host) > 4096 {
            drop(device);
            thread::sleep(Duration::from_micros(100));
            return Err(ErrorKind::WouldBlock.into());
        }
        let len = bytes.len().min(1000);
        match device.bulk_out(self.from_host, &bytes[..len]) {
            true => Ok(len),
            false => Err(ErrorKind::BrokenPipe.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl mcu::Link for Function {
    fn halves(&self) -> io::Result<Halves> {
        Ok(Halves {
            reader: Box::new(self.clone()),
            writer: Box::new(self.clone()),
        })
    }
}

/// Events of a few crowded places on a quiet sensor.
struct Recording {
    events: std::vec::IntoIter<Event>,
    skipped: Skipped,
}

fn recording() -> Box<dyn EventReader> {
    let mut state = 1_u32;
    let mut next = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let mut t_us = 5_000_000_000;
    let events: Vec<_> = (0..20_000)
        .map(|_| {
            t_us += u64::from(next(12));
            let crowded = next(3) > 0;
            let place = |size: u32, random: u32| if crowded { random % 9 } else { random % size };
            Event {
                t_us,
                x: place(70, next(1 << 20)) as u16,
                y: place(40, next(1 << 20)) as u16,
                polarity: match next(2) {
                    0 => Polarity::Off,
                    _ => Polarity::On,
                },
            }
        })
        .collect();
    Box::new(Recording {
        events: events.into_iter(),
        skipped: Skipped::default(),
    })
}

impl EventReader for Recording {
    fn format(&self) -> &'static str {
        "test"
    }

    fn sensor(&self) -> Sensor {
        SENSOR
    }

    fn read(&mut self, events: &mut Vec<Event>) -> Result<usize> {
        let before = events.len();
        events.extend(self.events.by_ref().take(1000));
        Ok(events.len() - before)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

#[test]
fn frames_over_either_function_are_the_hosts() {
    let wire = Wire::default();
    // A device that a thread may have is there for good.
    let allocator = Box::leak(Box::new(UsbBusAllocator::new(wire.clone())));
    let ends = Box::leak(Box::new(Outgoing::new())).split();
    let device = ClassBus::new(&wire, allocator, ends, "1", Encoder::new()).unwrap();
    let device = Arc::new(Mutex::new(device));
    let hybrid = Hybrid {
        coder: Coder::Fast,
        fidelity: Fidelity::Lossless,
    };
    for (mode, to_host, from_host) in [
        (Mode::Hybrid(hybrid), TO_HOST, FROM_HOST),
        (Mode::Transform, SERIAL_TO_HOST, SERIAL_FROM_HOST),
        (Mode::Transform, TO_HOST, FROM_HOST),
    ] {
        let job = Job {
            open: &|| Ok(recording()),
            config: Config {
                window: WindowConfig {
                    sensor: SENSOR,
                    window_us: 5000,
                },
                thresholds: Thresholds::new(1_000_000_000_000, 50_000_000_000_000).unwrap(),
                transform: None,
                m: 8,
                grid: None,
                quantiser: Quantiser::DEFAULT,
                mode,
                key_windows: KEY_WINDOWS,
                readout: None,
                filter: Filter::NONE,
                bytes_per_second: None,
                keep_order: false,
            },
            hot: &[],
            drop_when_full: false,
        };
        let function = Function {
            device: Arc::clone(&device),
            to_host,
            from_host,
        };
        let mut connection = Connection::new(&function, Duration::from_secs(10)).unwrap();
        let outcome = mcu::run(&mut connection, &job, &|_| ()).unwrap();
        outcome.verdict().unwrap();
        assert_eq!(outcome.events_encoded, 20_000, "{mode:?}");
        assert!(outcome.frames_identical > 20);
        let device = device.lock().unwrap();
        assert_eq!(device.bytes_refused(), 0);
        let counts = device.counts();
        assert_eq!(counts.bytes_dropped, 0);
        assert_eq!(counts.serial, from_host == SERIAL_FROM_HOST);
    }
}
