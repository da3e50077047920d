//! The known sensors, and how a board's sensor is found, started and stopped.

use anyhow::{Result, bail, ensure};
use eecvs_nostd::Sensor;
use event_types::evt21::Order;

use super::Format;
use super::registers::{self, CHIP, FORMAT, FORMAT_EVT21, Sequences, Step, VARIANT, take};
use super::registers_evk2::{EVK2_IMX636, SENSOR};
use super::treuzell::{self, Board};

/// Most devices of a board; it bounds the loop if a board reports a wrong number.
const DEVICES_MAX: u32 = 16;

/// A sensor; for the EVK2 together with its board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chip {
    /// IMX636.
    Imx636,
    /// IMX646.
    Imx646,
    /// Gen 4.1.
    Gen41,
    /// GenX320.
    Genx320,
    /// IMX636 behind the FPGA of an EVK2.
    Evk2Imx636,
}

/// Register of an EVK2's FPGA with the number of the system.
pub const EVK2_SYSTEM: u32 = 0x800;
/// Number of a system with an IMX636.
pub const EVK2_WITH_IMX636: u32 = 0x32;

impl Chip {
    /// Returns the size of the sensor.
    #[must_use]
    pub const fn sensor(self) -> Sensor {
        match self {
            Self::Genx320 => Sensor {
                width: 320,
                height: 320,
            },
            _ => Sensor {
                width: 1280,
                height: 720,
            },
        }
    }

    /// Returns the name of a camera with this sensor; `kind` is the kind that its board reports.
    #[must_use]
    pub const fn camera(self, kind: Option<u8>) -> &'static str {
        match (self, kind) {
            (Self::Imx636, Some(0x31)) => "EVK4 IMX636",
            (Self::Imx636, _) => "EVK3 IMX636",
            (Self::Imx646, _) => "EVK4 IMX646",
            (Self::Gen41, _) => "EVK3-HD Gen 4.1",
            (Self::Genx320, _) => "EVK3 GenX320",
            (Self::Evk2Imx636, _) => "EVK2 IMX636",
        }
    }

    /// Returns the kind that a board with this sensor reports: 0x31 for an EVK4, 0x35 with an IMX646, 0x30 for an
    /// EVK3-HD.
    #[must_use]
    pub const fn kind(self) -> Option<u8> {
        match self {
            Self::Imx636 => Some(0x31),
            Self::Imx646 => Some(0x35),
            Self::Gen41 => Some(0x30),
            Self::Genx320 | Self::Evk2Imx636 => None,
        }
    }

    /// Returns the compatibility string of the sensor's device.
    #[must_use]
    pub const fn compatible(self) -> &'static str {
        match self {
            Self::Imx636 => "psee,ccam5_imx636",
            Self::Imx646 => "psee,ccam5_imx646",
            Self::Gen41 => "psee,ccam5_gen41",
            Self::Genx320 => "psee,cx3_genx320",
            Self::Evk2Imx636 => "psee,video_imx636",
        }
    }

    /// Returns the chip number in [`CHIP`].
    #[must_use]
    pub const fn number(self) -> u32 {
        match self {
            Self::Imx636 | Self::Imx646 | Self::Evk2Imx636 => 0xA040_1806,
            Self::Gen41 => 0xA030_1003,
            Self::Genx320 => 0xB060_2003,
        }
    }

    fn sequences(self) -> &'static Sequences {
        match self {
            Self::Imx636 | Self::Imx646 => &registers::IMX636,
            Self::Gen41 => &registers::GEN41,
            Self::Genx320 => &registers::GENX320,
            Self::Evk2Imx636 => &EVK2_IMX636,
        }
    }

    /// Returns the address at which the sensor's registers begin.
    #[must_use]
    pub const fn base(self) -> u32 {
        match self {
            Self::Evk2Imx636 => SENSOR,
            _ => 0,
        }
    }

    /// Returns the address of the register whose bit [`registers::PIXELS_GO`] enables the pixels.
    #[must_use]
    pub const fn pixels(self) -> u32 {
        match self {
            Self::Genx320 => registers::GENX320_PIXELS,
            _ => registers::PIXELS,
        }
    }

    /// Returns whether a separate device moves the sensor's stream.
    #[must_use]
    pub const fn has_streamer(self) -> bool {
        matches!(self, Self::Evk2Imx636)
    }
}

/// The sensor found on a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// Type of the sensor.
    pub chip: Chip,
    /// Number of its device.
    device: u32,
    /// Number of the device that moves its stream, if the board has one.
    streamer: Option<u32>,
}

/// Name of the device that forwards the events of an EVK2.
pub const STREAMER: &str = "treuzell,streamer";

impl Found {
    /// Searches a board's devices for a known sensor.
    ///
    /// # Errors
    /// The board is gone, or has no known sensor.
    pub fn look(board: &mut Board<'_>) -> Result<Self> {
        let devices = board.number(treuzell::DEVICES)?;
        let name = board.control().name().to_owned();
        ensure!(
            (1..=DEVICES_MAX).contains(&devices),
            "{name}: reports an impossible number of devices, {devices}: reconnect it"
        );
        let (mut streamer, mut seen) = (None, Vec::new());
        for device in 0..devices {
            let names = match board.strings(treuzell::COMPATIBLE, device) {
                Ok(names) => names,
                // Old firmware reports the compatibility strings as names.
                Err(_) => board.strings(treuzell::NAME, device)?,
            };
            if names.iter().any(|name| name == STREAMER) {
                streamer = Some(device);
            } else if let Some(chip) = Self::chip(board, device, &names)? {
                return Ok(Self {
                    chip,
                    device,
                    streamer,
                });
            }
            seen.extend(names);
        }
        bail!(
            "{name}: no known sensor among {}: known are IMX636, IMX646, Gen 4.1 and GenX320",
            seen.join(", ")
        )
    }

    fn chip(board: &mut Board<'_>, device: u32, names: &[String]) -> Result<Option<Chip>> {
        let has = |compatible: &str| names.iter().any(|name| name == compatible);
        if has(Chip::Evk2Imx636.compatible()) {
            // Boards with other sensors have other numbers.
            let system = board.read(device, EVK2_SYSTEM)?;
            return Ok((system == EVK2_WITH_IMX636).then_some(Chip::Evk2Imx636));
        }
        let families = ["psee,ccam5_", "psee,cx3_"];
        let is_sensor = |name: &String| families.iter().any(|family| name.starts_with(family));
        if !names.iter().any(is_sensor) {
            return Ok(None);
        }
        // The chip's own number decides, because boards list several sensors that they may have.
        Ok(match board.read(device, CHIP)? {
            0xA040_1806 if board.read(device, VARIANT)? & 3 == 0 => Some(Chip::Imx636),
            0xA040_1806 => Some(Chip::Imx646),
            0xA030_1002 | 0xA030_1003 => Some(Chip::Gen41),
            0x3050_1C01 | 0xB060_2003 => Some(Chip::Genx320),
            _ => None,
        })
    }

    /// Returns the stream format that the sensor is set to.
    ///
    /// # Errors
    /// The board is gone.
    pub fn format(self, board: &mut Board<'_>) -> Result<Format> {
        Ok(match self.chip {
            Chip::Genx320 => Format::Evt21(Order::Little),
            Chip::Evk2Imx636 => Format::Evt3,
            Chip::Imx636 | Chip::Imx646 | Chip::Gen41 => {
                if board.read(self.device, FORMAT)? & FORMAT_EVT21 != 0 {
                    Format::Evt21(Order::UpperFirst)
                } else {
                    Format::Evt3
                }
            }
        })
    }

    /// Initialises the sensor and starts its events.
    ///
    /// # Errors
    /// The board is gone, or refuses a step.
    pub fn start(self, board: &mut Board<'_>, format: Format) -> Result<()> {
        let sequences = self.chip.sequences();
        let steps: &[Step] = match format {
            _ if matches!(self.chip, Chip::Genx320 | Chip::Evk2Imx636) => &[],
            Format::Evt3 => registers::EVT3,
            Format::Evt21(_) => registers::EVT21,
        };
        for steps in [
            sequences.stop,
            sequences.shut_down,
            sequences.make_ready,
            steps,
            sequences.start,
        ] {
            take(board, self.device, steps)?;
        }
        if let Some(streamer) = self.streamer {
            board.stream(streamer, true)?;
        }
        Ok(())
    }

    /// Stops the events.
    ///
    /// # Errors
    /// The board is gone.
    pub fn stop(self, board: &mut Board<'_>) -> Result<()> {
        take(board, self.device, self.chip.sequences().stop)?;
        if let Some(streamer) = self.streamer {
            // A board that does not stream may refuse to stop.
            let _ = board.stream(streamer, false);
        }
        Ok(())
    }
}
