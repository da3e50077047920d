//! The encoder behind the class: a recording goes in over the bus as packets, and every frame that comes
//! back has the bytes of the host's own.

use std::io::{self, ErrorKind, Read, Write};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Filter, Hybrid, KEY_WINDOWS, Mode, Polarity, Quantiser, Sensor,
    Thresholds, WindowConfig,
};
use eecvs_usb_class::{FROM_HOST, TO_HOST};
use event_files::{EventReader, Skipped};
use mcu_link::Job;
use mcu_link::connection::{Connection, Halves};
use usb_bridge::peripheral::class_bus::ClassBus;
use usb_bridge::peripheral::{Bulk, Peripheral};

use super::application::Encoder;
use super::script::{SERIAL_FROM_HOST, SERIAL_TO_HOST};

pub const SENSOR: Sensor = Sensor {
    width: 70,
    height: 40,
};

pub type Device = Arc<Mutex<ClassBus<'static, Encoder>>>;

/// One function of the device, as a stream of bytes.
#[derive(Clone)]
pub struct Function {
    pub device: Device,
    pub to_host: u8,
    pub from_host: u8,
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

impl mcu_link::Link for Function {
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

pub fn recording() -> Box<dyn EventReader> {
    Box::new(Recording {
        events: events().into_iter(),
        skipped: Skipped::default(),
    })
}

pub fn events() -> Vec<Event> {
    let mut state = 1_u32;
    let mut next = |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let mut t_us = 5_000_000_000;
    (0..20_000)
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
        .collect()
}

impl EventReader for Recording {
    fn format(&self) -> &'static str {
        "test"
    }

    fn sensor(&self) -> Sensor {
        SENSOR
    }

    fn read(&mut self, events: &mut Vec<Event>) -> event_types::stream::Result<usize> {
        let before = events.len();
        events.extend(self.events.by_ref().take(1000));
        Ok(events.len() - before)
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }
}

pub fn config(mode: Mode) -> Config {
    Config {
        window: WindowConfig::new(SENSOR, 5000),
        thresholds: Thresholds::new(1_000_000_000_000, 50_000_000_000_000).unwrap(),
        transform: None,
        m: 8,
        grid: None,
        quantiser: Quantiser::DEFAULT,
        few_as_times: false,
        max_emd_us: None,
        mode,
        key_windows: KEY_WINDOWS,
        readout: None,
        filter: Filter::NONE,
        bytes_per_second: None,
        keep_order: false,
    }
}

#[test]
fn frames_over_either_function_are_the_hosts() {
    let device = Arc::new(Mutex::new(Encoder::new().on_a_bus()));
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
            config: config(mode),
            hot: &[],
            drop_when_full: false,
        };
        let function = Function {
            device: Arc::clone(&device),
            to_host,
            from_host,
        };
        let mut connection = Connection::new(&function, Duration::from_secs(10)).unwrap();
        let outcome = mcu_link::run(&mut connection, &job, &|_| ()).unwrap();
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
