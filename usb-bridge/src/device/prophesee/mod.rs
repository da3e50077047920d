//! Prophesee's cameras: EVK2, EVK3, EVK4 and cameras built on them.
//!
//! | file | content |
//! |---|---|
//! | `treuzell.rs` | the control protocol of the boards |
//! | `registers.rs`, `registers_evk2.rs` | register sequences |
//! | `sensor.rs` | the known sensors, and how a board's sensor is found |
//! | `high_time.rs` | the upper bits of time and their wraps |
//! | `parse_evt3.rs`, `write_evt3.rs` | EVT 3.0 |
//! | `parse_evt21.rs`, `write_evt21.rs` | EVT 2.1, with the halves of a word in either order |
//! | `camera.rs` | the simulated camera |
//!
//! EVK3, EVK4 and the cameras of CenturyArks and IDS with the same board are all handled by [`EVK`], because their
//! USB IDs do not distinguish their sensors; [`Model::identify`] does. The other models exist to be simulated,
//! except for the EVK2, which is a board of its own.

pub mod camera;
mod high_time;
pub mod parse_evt21;
pub mod parse_evt3;
pub mod registers;
mod registers_evk2;
pub mod sensor;
pub mod treuzell;
pub mod write_evt21;
pub mod write_evt3;

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use eecvs_nostd::{Event, Sensor};
use event_types::evt21::Order;

use super::{Identity, Info, Model, Parse, Stream, Transfers, WriteStream};
use crate::link::control::{Control, Request};
use crate::peripheral::Peripheral;
use camera::TreuzellCamera;
use parse_evt3::Evt3Parser;
use parse_evt21::Evt21Parser;
use sensor::{Chip, Found};
use treuzell::Board;
use write_evt3::Evt3Stream;
use write_evt21::Evt21Stream;

/// Endpoint of the stream.
pub const STREAM_IN: u8 = 0x81;
/// Vendor request whose answer begins with the kind of board.
pub const KIND_REQUEST: u8 = 0x72;

/// Format of a stream, named in [`Info::stream`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// EVT 3.0.
    Evt3,
    /// EVT 2.1, with the given order of a word's halves.
    Evt21(Order),
}

impl Format {
    const ALL: [Self; 3] = [
        Self::Evt3,
        Self::Evt21(Order::UpperFirst),
        Self::Evt21(Order::Little),
    ];

    /// Returns the name of the format, as in [`Info::stream`].
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Evt3 => "evt3",
            Self::Evt21(Order::UpperFirst) => "evt21-upper-first",
            Self::Evt21(Order::Little) => "evt21",
        }
    }

    fn of(info: &Info) -> Self {
        let named = |format: &Self| format.name() == info.stream;
        Self::ALL.into_iter().find(named).unwrap_or(Self::Evt3)
    }
}

/// A model of Prophesee's cameras.
#[derive(Debug)]
pub struct Prophesee {
    name: &'static str,
    identities: &'static [Identity],
    /// USB IDs of a simulated camera.
    simulated: Identity,
    chip: Chip,
    format: Format,
}

const fn identity(vendor: u16, product: u16) -> Identity {
    Identity {
        vendor,
        product,
        major: None,
    }
}

/// EVK3 and EVK4, SilkyEvCam HD and HD Lite, UE-39B0XCP; simulated as an EVK4.
pub static EVK: Prophesee = Prophesee {
    name: "evk4",
    identities: &[
        identity(0x04B4, 0x00F4),
        identity(0x04B4, 0x00F5),
        identity(0x31F7, 0x0003),
        identity(0x31F7, 0x0004),
        identity(0x1409, 0x8E00),
    ],
    simulated: identity(0x04B4, 0x00F5),
    chip: Chip::Imx636,
    format: Format::Evt3,
};

/// An EVK4 that sends EVT 2.1; for simulation only.
pub static EVK4_EVT21: Prophesee = Prophesee {
    name: "evk4-evt21",
    identities: &[],
    simulated: identity(0x04B4, 0x00F5),
    chip: Chip::Imx636,
    format: Format::Evt21(Order::UpperFirst),
};

/// An EVK3-HD with a Gen 4.1 sensor; for simulation only.
pub static EVK3_HD: Prophesee = Prophesee {
    name: "evk3-hd",
    identities: &[],
    simulated: identity(0x04B4, 0x00F4),
    chip: Chip::Gen41,
    format: Format::Evt3,
};

/// An EVK3 with a GenX320; for simulation only.
pub static EVK3_GENX320: Prophesee = Prophesee {
    name: "evk3-genx320",
    identities: &[],
    simulated: identity(0x04B4, 0x00F5),
    chip: Chip::Genx320,
    format: Format::Evt21(Order::Little),
};

/// An EVK2 with an IMX636.
pub static EVK2: Prophesee = Prophesee {
    name: "evk2",
    identities: &[identity(0x03FD, 0x5832)],
    simulated: identity(0x03FD, 0x5832),
    chip: Chip::Evk2Imx636,
    format: Format::Evt3,
};

impl Model for Prophesee {
    fn name(&self) -> &'static str {
        self.name
    }

    fn identities(&self) -> &'static [Identity] {
        self.identities
    }

    fn streams(&self) -> &'static [&'static str] {
        const NAMES: [&str; 3] = [
            Format::ALL[0].name(),
            Format::ALL[1].name(),
            Format::ALL[2].name(),
        ];
        &NAMES
    }

    fn transfers(&self) -> Transfers {
        Transfers {
            endpoint: STREAM_IN,
            interface: 0,
            count: 32,
            bytes: 1 << 17,
            timeout: Duration::from_millis(100),
        }
    }

    fn needs_super_speed(&self) -> bool {
        true
    }

    fn identify(&self, control: &mut dyn Control) -> Result<Info> {
        // Boards of other makers and the EVK2 may refuse this; a refusal is information enough.
        let mut kind = [0; 2];
        let request = Request::vendor_in(KIND_REQUEST, 0, 0);
        let answered = control.control_in(request, &mut kind).unwrap_or(0);
        let kind = (answered > 0).then_some(kind[0]);
        let mut board = Board::new(control);
        let release = board.number(treuzell::RELEASE)?;
        let serial = board.serial()?;
        let found = Found::look(&mut board)?;
        // It may still be streaming for a program that was killed.
        found.stop(&mut board)?;
        let format = found.format(&mut board)?;
        let firmware = format!(
            "{}.{}.{}",
            release >> 16,
            release >> 8 & 0xff,
            release & 0xff
        );
        Ok(Info {
            name: found.chip.camera(kind).to_owned(),
            serial: Some(serial),
            firmware,
            sensor: found.chip.sensor(),
            stream: format.name(),
        })
    }

    fn start(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        let mut board = Board::new(control);
        let found = Found::look(&mut board)?;
        ensure!(
            found.chip.sensor() == info.sensor,
            "{}: the sensor is not the one found before: open the camera again",
            info.name
        );
        found
            .start(&mut board, Format::of(info))
            .with_context(|| format!("{}: cannot start the camera", info.name))
    }

    fn stop(&self, info: &Info, control: &mut dyn Control) -> Result<()> {
        let mut board = Board::new(control);
        let found = Found::look(&mut board)?;
        found
            .stop(&mut board)
            .with_context(|| format!("{}: cannot stop the camera", info.name))
    }

    fn parser(&self, info: &Info) -> Box<dyn Parse> {
        match Format::of(info) {
            Format::Evt3 => Box::new(Evt3Parser::new(info.sensor)),
            Format::Evt21(order) => Box::new(Evt21Parser::new(info.sensor, order)),
        }
    }

    fn writer(&self, sensor: Sensor) -> Option<Box<dyn WriteStream>> {
        let own = self.fits(sensor)?;
        Some(match self.format {
            Format::Evt3 => Box::new(Evt3Stream::new(own)),
            Format::Evt21(order) => Box::new(Evt21Stream::new(own, order)),
        })
    }

    fn camera(&self, sensor: Sensor, stream: Box<dyn Stream>) -> Option<Box<dyn Peripheral>> {
        self.fits(sensor)?;
        let camera = TreuzellCamera::new(self.simulated, self.chip, self.format, stream);
        Some(Box::new(camera))
    }
}

impl Prophesee {
    /// Returns the model's own sensor if a recording of size `sensor` fits into its upper left corner.
    fn fits(&self, sensor: Sensor) -> Option<Sensor> {
        let own = self.chip.sensor();
        (sensor.width <= own.width && sensor.height <= own.height).then_some(own)
    }
}

/// Checks that event number `index` lies inside the sensor.
fn check_inside(index: u64, event: &Event, sensor: Sensor) -> Result<()> {
    ensure!(
        sensor.contains(event.x, event.y),
        "event {index} at x = {}, y = {} is outside the sensor ({}x{})",
        event.x,
        event.y,
        sensor.width,
        sensor.height
    );
    Ok(())
}

/// Returns the message for a time that cannot be reached with time words.
fn time_refused(index: u64, t_us: u64) -> String {
    format!(
        "event {index}: the camera's clock cannot reach {t_us} us (it counts from 0, and steps \
         back and gaps are limited): subtract the recording's first time, or cut the recording \
         there"
    )
}
