//! An encoder that a host sets up, as the commands do it: over the bulk endpoints, over a serial port.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use anyhow::Result;
use eecvs_nostd::event_link::Setup;
use eecvs_nostd::{
    Coder, Config, Event, Fidelity, Hybrid, Mode, Polarity, Sensor, Thresholds, Transform,
    WindowConfig,
};
use mcu_link::{Job, Outcome};
use serialport::{SerialPort, TTYPort};
use usb_bridge::device::mcu::parse::McuParser;
use usb_bridge::device::mcu::{ANY_SENSOR, MCU};
use usb_bridge::device::{Model, Parse};
use usb_bridge::encoder::{Encoder, Wish};
use usb_bridge::link::loopback::Attachment;
use usb_bridge::link::serial::SerialLink;
use usb_bridge::peripheral::Peripheral;
use usb_bridge::record;
use usb_bridge::session::{Limits, Session, Source};
use usb_bridge::stop::Stop;

use super::application;
use super::encoder::{Function, SENSOR, config, events, recording};
use super::script::{SERIAL_FROM_HOST, SERIAL_TO_HOST};

const LOSSLESS: Hybrid = Hybrid {
    coder: Coder::Fast,
    fidelity: Fidelity::Lossless,
};
const FAST: Mode = Mode::Hybrid(LOSSLESS);
const DENSE: Mode = Mode::Hybrid(Hybrid {
    coder: Coder::Dense,
    ..LOSSLESS
});

/// An encoder on a bus in memory, opened as one on USB is.
fn attached(device: impl Peripheral + 'static) -> (Attachment, Encoder) {
    let attachment = Attachment::new("eecvs", Box::new(device));
    let mut control = Box::new(attachment.control());
    let source = Source {
        model: &MCU,
        info: MCU.identify(control.as_mut()).unwrap(),
        link: Box::new(attachment.stream(&MCU.transfers())),
        control: Some(control),
    };
    (attachment, Encoder::begin(source).unwrap())
}

fn run(encoder: &Encoder, config: Config, progress: &(dyn Fn(u64) + Sync)) -> Result<Outcome> {
    let job = Job {
        open: &|| Ok(recording()),
        config,
        hot: &[],
        drop_when_full: false,
    };
    let mut connection = encoder.connect(Duration::from_secs(10))?;
    Ok(mcu_link::run(&mut connection, &job, progress)?)
}

fn sorted(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_unstable();
    events
}

fn decoded(bytes: &[u8]) -> Vec<Event> {
    let (mut parser, mut found) = (McuParser::new(ANY_SENSOR), Vec::new());
    parser.parse(bytes, &mut found);
    assert_eq!(parser.losses().iter().collect::<Vec<_>>(), []);
    sorted(found)
}

/// Coefficients that hold every time: as many as there are cells of a microsecond.
fn every_coefficient() -> Config {
    let window = WindowConfig::new(SENSOR, 64);
    Config {
        window,
        transform: Some(Transform::Dwt),
        m: 64,
        grid: Some(64),
        ..config(Mode::Transform)
    }
}

/// The same encoder, set up anew for each.
#[test]
fn a_recording_returns_over_bulk_endpoints() {
    let (_, encoder) = attached(application::Encoder::new().on_a_bus());
    // Of coefficients a time is the middle of its cell, which is a microsecond or less.
    for (config, off_us) in [
        (config(FAST), 0),
        (config(DENSE), 0),
        (every_coefficient(), 1),
    ] {
        let outcome = run(&encoder, config, &|_| ()).unwrap();
        outcome.verdict().unwrap();
        let (found, sent) = (by_place(decoded(&outcome.bytes)), by_place(events()));
        assert_eq!(found.len(), sent.len(), "{:?}", config.mode);
        let is_off = |(found, sent): &(&Event, &Event)| {
            let off = found.t_us.abs_diff(sent.t_us) > off_us;
            off || (found.x, found.y, found.polarity) != (sent.x, sent.y, sent.polarity)
        };
        let off: Vec<_> = found.iter().zip(&sent).filter(is_off).collect();
        // Opposite events of a pixel in one cell cancel each other out of the coefficients.
        let cancelled = match off_us {
            0 => 0,
            _ => opposite(&sent),
        };
        let told = (config.mode, off.first());
        assert!(off.len() <= cancelled, "{}: {told:?}", off.len());
        assert!(cancelled < 50);
    }
}

/// Events with one of the other polarity at their pixel within a microsecond.
fn opposite(events: &[Event]) -> usize {
    let key = |event: &Event| (event.y, event.x, event.t_us, event.polarity);
    let all: BTreeSet<_> = events.iter().map(key).collect();
    let has_other = |event: &&Event| {
        let other = Polarity::from_bool(event.polarity == Polarity::Off);
        let mut times = event.t_us - 1..=event.t_us + 1;
        times.any(|t_us| all.contains(&(event.y, event.x, t_us, other)))
    };
    events.iter().filter(has_other).count()
}

/// Pixel by pixel and by polarity, in the order of time.
fn by_place(mut events: Vec<Event>) -> Vec<Event> {
    events.sort_by_key(|event| (event.y, event.x, event.polarity, event.t_us));
    events
}

#[test]
fn a_setup_that_is_refused_is_one_line() {
    let dense = |width, height| Config {
        window: WindowConfig::new(Sensor { width, height }, 5000),
        ..config(DENSE)
    };
    let (_, encoder) = attached(application::Encoder::new().on_a_bus());
    let error = run(&encoder, dense(2048, 2048), &|_| ()).unwrap_err();
    assert_eq!(
        format!("{error:#}"),
        "the encoder refuses the setup for 2048 x 2048 pixels: it has no memory for windows of this \
         sensor, or their duration is 0 us"
    );
    // It takes another one.
    run(&encoder, config(FAST), &|_| ())
        .unwrap()
        .verdict()
        .unwrap();
    // An encoder beside a sensor has the size that it has.
    let own = Setup::new(&config(FAST), 0);
    let (_, encoder) = attached(application::Encoder::with_sensor(own, &[]).on_a_bus());
    let wish = Wish {
        config: dense(71, 40),
        hot: &[],
    };
    let error = encoder.set_up(&wish).err().unwrap();
    assert_eq!(
        format!("{error:#}"),
        "simulated eecvs: the encoder refuses the setup for 71 x 40 pixels: a side of the sensor is \
         out of range, or the encoder's own sensor has another size"
    );
}

#[test]
fn one_that_vanishes_in_the_middle_is_one_line() {
    let (attachment, encoder) = attached(application::Encoder::new().on_a_bus());
    let unplug = |events: u64| {
        if events >= 8000 {
            attachment.unplug();
        }
    };
    let error = run(&encoder, config(FAST), &unplug).unwrap_err();
    let told = format!("{error:#}");
    assert!(
        told.ends_with("simulated eecvs: unplugged; connect it again and rerun the command"),
        "{told}"
    );
    assert!(!told.contains('\n'), "{told}");
}

/// Moves bytes between a terminal and the device's serial function, as a kernel's driver does.
fn carry(mut terminal: TTYPort, mut function: Function, over: &AtomicBool) {
    let mut bytes = [0; 512];
    terminal.set_timeout(Duration::from_millis(1)).unwrap();
    while !over.load(Ordering::Relaxed) {
        if let Ok(len) = terminal.read(&mut bytes) {
            let mut left = &bytes[..len];
            while !left.is_empty() && !over.load(Ordering::Relaxed) {
                match function.write(left) {
                    Ok(sent) => left = &left[sent..],
                    Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
                }
                let _ = function.give(&mut terminal);
            }
        }
        let _ = function.give(&mut terminal);
    }
}

impl Function {
    /// What the device has for the host, to the terminal.
    fn give(&mut self, terminal: &mut TTYPort) -> std::io::Result<()> {
        let mut bytes = [0; 4096];
        let len = self.read(&mut bytes)?;
        terminal.set_timeout(Duration::from_secs(5))?;
        terminal.write_all(&bytes[..len])?;
        terminal.set_timeout(Duration::from_millis(1))?;
        Ok(())
    }
}

#[test]
fn a_recording_returns_over_the_serial_port() {
    let (terminal, other) = TTYPort::pair().unwrap();
    let path = other.name().unwrap();
    // It is locked while it is open.
    drop(other);
    let link = Box::new(SerialLink::open(&path, 115_200).unwrap());
    let function = Function {
        device: Arc::new(Mutex::new(application::Encoder::new().on_a_bus())),
        to_host: SERIAL_TO_HOST,
        from_host: SERIAL_FROM_HOST,
    };
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| carry(terminal, function, &over));
        let source = Source {
            model: &MCU,
            info: MCU.describe(ANY_SENSOR, "frames").unwrap(),
            link,
            control: None,
        };
        let outcome =
            Encoder::begin(source).and_then(|encoder| run(&encoder, config(FAST), &|_| ()));
        over.store(true, Ordering::Relaxed);
        let outcome = outcome.unwrap();
        outcome.verdict().unwrap();
        assert!(decoded(&outcome.bytes) == sorted(events()));
    });
}

/// What `capture --set-up` does: an encoder beside its sensor encodes as it is told, and its frames are kept.
#[test]
fn an_encoder_beside_its_sensor_is_set_up() {
    let mut seen: Vec<Event> = events().into_iter().take(3000).collect();
    for event in &mut seen {
        event.t_us -= 4_999_999_000;
    }
    let last = *seen.last().unwrap();
    // It closes the window before.
    let later = Event {
        t_us: last.t_us + 100_000,
        ..last
    };
    let all: Vec<Event> = seen.iter().copied().chain([later]).collect();
    let own = Setup::new(
        &Config {
            thresholds: Thresholds::new(0, 0).unwrap(),
            ..config(Mode::Transform)
        },
        0,
    );
    for mode in [FAST, DENSE] {
        let device = application::Encoder::with_sensor(own, &all).on_a_bus();
        let (_, encoder) = attached(device);
        let wish = Wish {
            config: config(mode),
            hot: &[],
        };
        let source = encoder.set_up(&wish).unwrap();
        let limits = Limits {
            duration: Some(Duration::from_secs(10)),
            events: Some(seen.len() as u64),
        };
        let session = Session::start(source, 1 << 20, &Stop::default(), limits).unwrap();
        let mut bytes = Vec::new();
        record::encoders_frames(&session, &mut bytes, &mut record::Order::default()).unwrap();
        let (report, failure) = session.finish();
        assert!(failure.is_none());
        assert!(report.losses.is_empty(), "{:?}", report.losses);
        assert!(decoded(&bytes) == sorted(seen.clone()), "{mode:?}");
        let frame = eecvs_nostd::Frame::parse(&bytes).unwrap();
        assert_eq!(frame.header.mode, mode);
    }
}
