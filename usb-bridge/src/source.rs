//! Opens a device by name: on USB, on a serial port, from a stream file, or simulated.

use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, bail};
use event_files::output::create_bytes;

use crate::device::{self, Model, find};
use crate::link::control::Control;
use crate::link::loopback::Attachment;
use crate::link::replay::{Pace as ReplayPace, ReplayLink};
use crate::link::serial::SerialLink;
use crate::link::trace::{Place, Tracer};
use crate::link::usb::{Attached, Bus, wait_for};
use crate::link::{Link, LinkError, Outlet, Received};
use crate::peripheral::stream::{Pace, Recording, Sent};
use crate::session::Source;
use crate::stop::Stop;

/// Baud rate of a serial port. A CDC-ACM device on USB ignores it.
const BAUD: u32 = 3_000_000;

/// Which device to open, as named on the command line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Name {
    /// A USB device, named by port, serial number or model.
    Usb(String),
    /// A microcontroller on the serial port with this path.
    Serial(String),
    /// A stream file that is replayed.
    Replay(PathBuf),
    /// A model, by name, that plays a recording inside the process.
    Simulated(&'static str, PathBuf),
}

impl FromStr for Name {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(path) = text.strip_prefix("serial:") {
            return Ok(Self::Serial(path.to_owned()));
        }
        if let Some(path) = text.strip_prefix("replay:") {
            return Ok(Self::Replay(path.into()));
        }
        let Some(rest) = text.strip_prefix("sim:") else {
            return Ok(Self::Usb(text.to_owned()));
        };
        let (model, file) = rest
            .split_once(':')
            .ok_or_else(|| format!("{text}: the recording is missing: expected sim:MODEL:FILE"))?;
        let model = find(model).ok_or_else(|| {
            let known: Vec<_> = device::MODELS.iter().map(|model| model.name()).collect();
            format!("{text}: unknown model; known models: {}", known.join(", "))
        })?;
        Ok(Self::Simulated(model.name(), file.into()))
    }
}

/// How a device is opened.
#[derive(Debug, Clone)]
pub struct Options {
    /// Wait until the device is attached.
    pub wait: bool,
    /// Pace of a replay or of a simulated device.
    pub rate: Pace,
    /// File to which every transfer is written.
    pub trace: Option<PathBuf>,
    /// USB only: replaces the model's [`device::Transfers::timeout`]; zero means no timeout.
    pub hand_over: Option<Duration>,
}

/// Opens a device and identifies it. Without a name, opens the only known device on USB.
///
/// # Errors
/// No device matches, or it cannot be used; the message says what to do.
pub fn open(name: Option<&Name>, options: &Options, stop: &Stop) -> Result<Source> {
    match name {
        None => usb(None, options, stop),
        Some(Name::Usb(id)) => usb(Some(id), options, stop),
        Some(Name::Serial(path)) => serial(path, options),
        Some(Name::Replay(path)) => replay(path, options),
        Some(Name::Simulated(model, path)) => simulated(model, path, options),
    }
}

fn usb(id: Option<&str>, options: &Options, stop: &Stop) -> Result<Source> {
    let attached = if options.wait {
        let found = wait_for(id, &|| stop.is_asked())?;
        found.context("no device was attached before the end")?
    } else {
        Bus::new()?.find(id)?
    };
    let model = attached
        .model
        .with_context(|| format!("{}: is not a known camera or MCU", attached.name()))?;
    if model.needs_super_speed() {
        attached.require_super_speed()?;
    }
    let mut transfers = model.transfers();
    let never = || {
        attached
            .loses_what_is_taken_back()
            .then_some(Duration::ZERO)
    };
    if let Some(timeout) = options.hand_over.or_else(never) {
        transfers.timeout = timeout;
    }
    let opened = attached.open(transfers.interface)?;
    let tracer = tracer(options, place(&attached, model), &attached.name())?;
    let mut control: Box<dyn Control + Send> = match &tracer {
        Some(tracer) => Box::new(tracer.control(opened.control())),
        None => Box::new(opened.control()),
    };
    let info = model.identify(control.as_mut())?;
    let stream = opened.stream(&transfers)?;
    let link: Box<dyn Link> = match tracer {
        Some(tracer) => Box::new(tracer.link(stream)),
        None => Box::new(stream),
    };
    Ok(Source {
        model,
        info,
        link,
        control: Some(control),
    })
}

fn place(attached: &Attached, model: &dyn Model) -> Place {
    Place {
        bus: attached.bus.into(),
        address: attached.address,
        endpoint: model.transfers().endpoint,
    }
}

/// Creates the trace if one was requested.
fn tracer(options: &Options, place: Place, name: &str) -> Result<Option<Tracer>> {
    let Some(path) = &options.trace else {
        return Ok(None);
    };
    let of = path.display();
    let file = create_bytes(path).with_context(|| format!("{of}: cannot be created"))?;
    let out = Box::new(BufWriter::new(file));
    let tracer = Tracer::new(out, place, name).with_context(|| format!("{of}: cannot be written"));
    tracer.map(Some)
}

/// Wraps a link that is on no USB bus in a trace if one was requested.
fn traced(
    link: impl Link + 'static,
    model: &dyn Model,
    options: &Options,
) -> Result<Box<dyn Link>> {
    let place = Place {
        bus: 0,
        address: 1,
        endpoint: model.transfers().endpoint,
    };
    Ok(match tracer(options, place, link.name())? {
        Some(tracer) => Box::new(tracer.link(link)),
        None => Box::new(link),
    })
}

fn serial(path: &str, options: &Options) -> Result<Source> {
    let model = find("eecvs").context("the MCU's model")?;
    let link = SerialLink::open(path, BAUD)?;
    let info = model
        .describe(device::mcu::ANY_SENSOR, "frames")
        .context("the MCU's stream")?;
    Ok(Source {
        model,
        info,
        link: traced(link, model, options)?,
        control: None,
    })
}

fn replay(path: &Path, options: &Options) -> Result<Source> {
    let name = path.display();
    let pace = match options.rate {
        Pace::Recorded(times) => ReplayPace::Times(times),
        Pace::Max => ReplayPace::Max,
        Pace::Rate(_) => bail!(
            "{name}: a stream file holds bytes, not events: replay it at real, max or a factor such as 2x"
        ),
    };
    let link = ReplayLink::open(path, pace).with_context(|| name.to_string())?;
    let header = link.header();
    let found = find(&header.model).and_then(|model| {
        let info = model.describe(header.sensor, &header.stream)?;
        Some((model, info))
    });
    let (model, mut info) = found.ok_or_else(|| {
        anyhow!(
            "{name}: this version does not know the stream {} of model {}",
            header.stream,
            header.model
        )
    })?;
    info.name.clone_from(&header.name);
    info.serial.clone_from(&header.serial);
    info.firmware.clone_from(&header.firmware);
    Ok(Source {
        model,
        info,
        link: traced(link, model, options)?,
        control: None,
    })
}

fn simulated(model: &str, path: &Path, options: &Options) -> Result<Source> {
    let name = path.display();
    let model = find(model).context("unknown model")?;
    let sensor = event_files::open(path, None)?.sensor();
    let unfit = || {
        format!(
            "{name}: no {} has a sensor of {}x{}: crop the recording with eecvs convert --crop, or \
             choose another model",
            model.name(),
            sensor.width,
            sensor.height
        )
    };
    let writer = model.writer(sensor).with_context(unfit)?;
    let file = path.to_owned();
    let open = Box::new(move || Ok(event_files::open(&file, None)?));
    let recording = Recording::new(open, writer, options.rate, None);
    let sent = recording.sent();
    let camera = model
        .camera(sensor, Box::new(recording))
        .with_context(unfit)?;
    let attachment = Attachment::new(model.name(), camera);
    let mut control: Box<dyn Control + Send> = Box::new(attachment.control());
    let info = model.identify(control.as_mut())?;
    let link = Ending {
        inner: attachment.stream(&model.transfers()),
        sent,
    };
    Ok(Source {
        model,
        info,
        link: traced(link, model, options)?,
        control: Some(control),
    })
}

/// The stream of a simulated camera. It ends with its recording, where a real camera would stay silent for ever.
struct Ending<L> {
    inner: L,
    sent: Arc<Sent>,
}

impl<L: Link> Link for Ending<L> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        // `is_over` is read before the call: bytes written before the end are still received, and only then does an
        // empty receive mean the end.
        let is_over = self.sent.rounds() > 0;
        if let Some(cause) = self.sent.error() {
            return Err(LinkError::Failed {
                link: self.inner.name().to_owned(),
                cause: cause.to_owned(),
            });
        }
        match self.inner.receive(timeout)? {
            Received::Nothing if is_over => Ok(Received::Ended),
            received => Ok(received),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.inner.send(bytes)
    }

    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        self.inner.outlet()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told_apart() {
        let name = |text: &str| text.parse::<Name>();
        assert_eq!(name("usb:1-4"), Ok(Name::Usb("usb:1-4".to_owned())));
        assert_eq!(
            name("serial:/dev/ttyACM0"),
            Ok(Name::Serial("/dev/ttyACM0".to_owned()))
        );
        assert_eq!(name("replay:a.stream"), Ok(Name::Replay("a.stream".into())));
        let simulated = Name::Simulated("evk4", "a:b.raw".into());
        assert_eq!(name("sim:evk4:a:b.raw"), Ok(simulated));
        assert!(name("sim:evk4").is_err());
        assert!(name("sim:nothing:a").unwrap_err().contains("davis346"));
    }
}
