//! Register sequences of sensors and boards: make ready, start, stop, shut down.
//!
//! Addresses and values are those that the public drivers write (OpenEB; for the IMX636 they agree with
//! neuromorphic-drivers). Nothing more is known about them here, and none of them was tried on a device.

use std::time::Duration;

use anyhow::Result;

use super::treuzell::Board;

/// A step of a sequence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Write a value to an address.
    Write(u32, u32),
    /// Write only these bits of a value: address, value, bits.
    Bits(u32, u32, u32),
    /// Write the same value to consecutive registers: first address, count, value.
    Fill(u32, u32, u32),
    /// Write a first value plus i times a step to register i: first address, count, value, step.
    Ramp(u32, u32, u32, u32),
    /// Wait for this many microseconds.
    Wait(u64),
}

use Step::{Bits, Fill, Ramp, Wait, Write};

/// The sequences of a kind of sensor.
#[derive(Debug, PartialEq, Eq)]
pub struct Sequences {
    /// Shuts the sensor down from any state.
    pub shut_down: &'static [Step],
    /// Makes the sensor ready.
    pub make_ready: &'static [Step],
    /// Starts the events.
    pub start: &'static [Step],
    /// Stops the events.
    pub stop: &'static [Step],
}

/// Executes the steps of a sequence on a device.
///
/// # Errors
/// The board is gone, or refuses a step.
pub fn take(board: &mut Board<'_>, device: u32, steps: &[Step]) -> Result<()> {
    for step in steps {
        match *step {
            Write(address, value) => board.write(device, address, value)?,
            Bits(address, value, bits) => {
                let before = board.read(device, address)?;
                board.write(device, address, before & !bits | value & bits)?;
            }
            Fill(address, count, value) => {
                for index in 0..count {
                    board.write(device, address + 4 * index, value)?;
                }
            }
            Ramp(address, count, value, step) => {
                for index in 0..count {
                    let value = value.wrapping_add(index.wrapping_mul(step));
                    board.write(device, address + 4 * index, value)?;
                }
            }
            Wait(microseconds) => board.control().wait(Duration::from_micros(microseconds)),
        }
    }
    Ok(())
}

/// Number of the chip.
pub const CHIP: u32 = 0x14;
/// Bits that distinguish an IMX636 (0) from an IMX646.
pub const VARIANT: u32 = 0xF128;
/// Time base; bit 0 enables it.
pub const TIME_BASE: u32 = 0x9008;
/// Readout; bit 1 holds it.
pub const READOUT: u32 = 0x9028;
/// IMX636 and Gen 4.1: register whose bit 10 enables the pixels.
pub const PIXELS: u32 = 0x0004;
/// GenX320: register whose bit 10 enables the pixels.
pub const GENX320_PIXELS: u32 = 0x0000;
/// Bit of [`PIXELS`] and [`GENX320_PIXELS`] that enables the pixels.
pub const PIXELS_GO: u32 = 1 << 10;
/// Stream format of IMX636 and Gen 4.1; bit 1 selects EVT 2.1.
pub const FORMAT: u32 = 0x7000;
/// Bit of [`FORMAT`] that selects EVT 2.1.
pub const FORMAT_EVT21: u32 = 1 << 1;
/// Stream format of the GenX320, in bits 1 and 0: 0 EVT 2, 1 EVT 3, 2 EVT 2.1.
pub const GENX320_FORMAT: u32 = 0x7044;
/// Value of [`GENX320_FORMAT`] for EVT 2.1.
pub const GENX320_EVT21: u32 = 2;
const OUTPUT: u32 = 0x8000;

/// Selects EVT 3.0.
pub const EVT3: &[Step] = &[Bits(FORMAT, 0, FORMAT_EVT21), Bits(OUTPUT, 2 << 6, 3 << 6)];
/// Selects EVT 2.1.
pub const EVT21: &[Step] = &[
    Bits(FORMAT, FORMAT_EVT21, FORMAT_EVT21),
    Bits(OUTPUT, 0, 3 << 6),
];

const IMX636_STOP: &[Step] = &[
    Write(PIXELS, 0xF000_5042),
    Write(0x002C, 0x0022_C324),
    Write(READOUT, 2),
    Wait(1000),
    Bits(TIME_BASE, 0x644, 1),
    Write(0xB000, 0x2F8),
    Wait(300),
];

/// IMX636 and IMX646 on an EVK3 or EVK4.
pub static IMX636: Sequences = Sequences {
    shut_down: &[
        Write(0x0070, 0x0040_0008),
        Write(0x006C, 0x0EE4_7114),
        Wait(500),
        Write(0xA00C, 0x0002_0400),
        Wait(500),
        Write(0xA010, 0x8068),
        Wait(200),
        Write(0x1104, 0),
        Wait(200),
        Write(0xA020, 0x50),
        Wait(200),
        Write(0xA004, 0x000B_0500),
        Wait(200),
        Write(0xA008, 0x2404),
        Wait(200),
        Write(0xA000, 0x000B_0500),
        Write(0xB044, 0),
        Write(0xB004, 0xA),
        Write(0xB040, 0xE),
        Write(0xB0C8, 0),
        Write(0xB040, 6),
        Write(0xB040, 4),
        Write(0x0000, 0x4F00_6442),
        Write(0x0000, 0x0F00_6442),
        Write(0x00B8, 0x401),
        Write(0x00B8, 0x400),
        Write(0xB07C, 0),
    ],
    make_ready: &[
        Write(0x001C, 1),
        Wait(1_000_000),
        Write(0x0040_0004, 1),
        Wait(500_000),
        Write(0x0040_0004, 0),
        Wait(1_000_000),
        Write(0xB000, 0x158),
        Wait(300),
        Write(0xB044, 0),
        Write(0xB004, 0xA),
        Write(0xB040, 0),
        Write(0xB0C8, 0),
        Write(0xB040, 0),
        Write(0xB040, 0),
        Write(0x0000, 0x4F00_6442),
        Write(0x0000, 0x0F00_6442),
        Write(0x00B8, 0x400),
        Write(0x00B8, 0x400),
        Write(0xB07C, 0),
        Write(0xB074, 2),
        Write(0xB078, 0xA0),
        Write(0x00C0, 0x110),
        Write(0x00C0, 0x210),
        Write(0xB120, 1),
        Write(0xE120, 0),
        Write(0xB068, 4),
        Write(0xB07C, 1),
        Wait(10),
        Write(0xB07C, 3),
        Wait(1000),
        Write(0x00B8, 0x401),
        Write(0x00B8, 0x409),
        Write(0x0000, 0x4F00_6442),
        Write(0x0000, 0x4F00_644A),
        Write(0xB080, 0x77),
        Write(0xB084, 0x0F),
        Write(0xB088, 0x37),
        Write(0xB08C, 0x37),
        Write(0xB090, 0xDF),
        Write(0xB094, 0x57),
        Write(0xB098, 0x37),
        Write(0xB09C, 0x67),
        Write(0xB0A0, 0x37),
        Write(0xB0A4, 0x2F),
        Write(0xB0AC, 0x28),
        Write(0xB0CC, 1),
        Write(0xB000, 0x2F8),
        Write(0xB004, 0x8A),
        Write(0xB01C, 0x30),
        Write(0xB020, 0x2000),
        Write(0xB02C, 0xFF),
        Write(0xB030, 0x3E80),
        Write(0xB028, 0xFA0),
        Write(0xA000, 0x000B_0501),
        Wait(200),
        Write(0xA008, 0x2405),
        Wait(200),
        Write(0xA004, 0x000B_0501),
        Wait(200),
        Write(0xA020, 0x150),
        Wait(200),
        Write(0xB040, 7),
        Write(0xB064, 6),
        Write(0xB040, 0xF),
        Wait(100),
        Write(0xB004, 0x8A),
        Wait(200),
        Write(0xB0C8, 3),
        Wait(200),
        Write(0xB044, 1),
        Write(0xB000, 0x2F9),
        Write(0x7008, 1),
        Write(FORMAT, 0x0007_0001),
        Write(OUTPUT, 0x0001_E085),
        Write(TIME_BASE, 0x644),
        Write(PIXELS, 0xF000_5042),
        Write(0x0018, 0x200),
        Write(0x1014, 0x11A1_504D),
        Write(0x9004, 0),
        Wait(1000),
        Write(0x9000, 0x200),
    ],
    start: &[
        Write(0xB000, 0x2F9),
        Write(READOUT, 0),
        Bits(TIME_BASE, 0x645, 1),
        Write(0x002C, 0x0022_C724),
        Write(PIXELS, 0xF000_5442),
    ],
    stop: IMX636_STOP,
};

/// Gen 4.1 on an EVK3.
pub static GEN41: Sequences = Sequences {
    shut_down: &[
        Write(0x0070, 0x0040_0000),
        Write(0x006C, 0x0EE4_7114),
        Wait(500),
        Write(0xA00C, 0x400),
        Wait(500),
        Write(0xA010, 0x8068),
        Wait(200),
        Write(0x1104, 0),
        Wait(200),
        Write(0xA020, 0x60),
        Wait(200),
        Write(0xA004, 0x2A0),
        Wait(200),
        Write(0xA008, 0x2400),
        Wait(200),
        Write(0xA000, 0x2A0),
        Write(0xB044, 0),
        Write(0xB004, 0xA),
        Write(0xB040, 0xE),
        Write(0xB0C8, 0),
        Write(0xB040, 6),
        Write(0xB040, 4),
        Write(0x0000, 0x5000_6442),
        Write(0x0000, 0x1000_6442),
        Write(0xB07C, 0),
    ],
    make_ready: &[
        Write(0x001C, 1),
        Write(0x0064, 1),
        Write(0xB074, 2),
        Write(0xB078, 0xA0),
        Write(0x0000, 0x1000_6402),
        Write(0x0000, 0x1000_1402),
        Write(0x0000, 0x1000_1442),
        Write(0xB068, 4),
        Write(0xB07C, 3),
        Wait(1000),
        Write(0x0000, 0x5000_1442),
        Write(0x0000, 0x5000_144A),
        Write(0x0000, 0x5000_140A),
        Write(0x0000, 0x5000_640A),
        Write(0x0000, 0x5000_644A),
        Write(0xB080, 0x77),
        Write(0xB084, 0x0F),
        Write(0xB088, 0x37),
        Write(0xB08C, 0x37),
        Write(0xB090, 0xDF),
        Write(0xB094, 0x57),
        Write(0xB098, 0x37),
        Write(0xB09C, 0x67),
        Write(0xB0A0, 0x37),
        Write(0xB0A4, 0x2F),
        Write(0xB0AC, 0x28),
        Write(0xB0CC, 1),
        Write(0xB000, 0x2D8),
        Write(0xB004, 0x8A),
        Write(0xB01C, 0x30),
        Write(0xB020, 0x2000),
        Write(0xB02C, 0xFF),
        Write(0xB030, 0x3E80),
        Write(0xB028, 0xFA0),
        Write(0xB040, 7),
        Write(0xA000, 0x101),
        Wait(200),
        Write(0xA008, 0x2405),
        Wait(200),
        Write(0xA004, 0x101),
        Wait(200),
        Write(0xA020, 0x170),
        Wait(200),
        Write(0xB040, 0xF),
        Write(0xB004, 0x8A),
        Wait(200),
        Write(0xB0C8, 3),
        Wait(200),
        Write(0xB044, 1),
        Write(0xB000, 0x2D9),
        Write(TIME_BASE, 0x640),
        Write(OUTPUT, 0x0001_E005),
        Write(0x7008, 1),
        Write(FORMAT, 0x0007_0001),
        // Tables of the event rate controller, which stays off.
        Write(0x6008, 0xC8),
        Write(0x600C, 0xFA0),
        Write(0x6004, 1),
        Write(0x602C, 1),
        Fill(0x6800, 230, 0x0808_0808),
        Write(0x602C, 0),
        Ramp(0x6400, 256, 0x0001_0000, 0x0002_0002),
        Ramp(0x6080, 8, 0x0302_0100, 0x0404_0404),
        Ramp(0x60C0, 8, 0x0302_0100, 0x0404_0404),
        Write(0x6028, 3),
        Write(0x6050, 0),
        Write(0x6060, 0),
        Write(0x6070, 0),
        Write(0x6000, 0x0015_5401),
        Write(0xD000, 5),
        Write(0xC000, 5),
        Write(0x9000, 0x208),
        Write(0x7008, 1),
        Write(FORMAT, 0x0007_0001),
        Write(OUTPUT, 0x0001_E085),
        Write(TIME_BASE, 0x644),
        Write(PIXELS, 0xF000_5442),
        Write(PIXELS, 0xF000_5042),
        Write(0x002C, 0x0020_0224),
        Write(0xA000, 0x101),
        Write(0xA000, 0xA1),
        Wait(200),
        Write(0xA008, 0x2405),
        Wait(200),
        Write(0xA004, 0x101),
        Write(0xA004, 0xA1),
        Wait(200),
        Write(0xA020, 0x170),
        Write(0xA020, 0x160),
        Wait(200),
        Write(0xA008, 0x0008_2401),
        Write(0x004C, 0x7141),
        Write(0x0054, 0x210),
        Write(0x0008, 0x6000_0000),
        Write(0x1104, 1),
        Write(0xA010, 0xA06B),
        Wait(300),
        Write(0x1100, 4),
        Wait(200),
        Write(0xA010, 0x0180_A063),
        Write(0xA00C, 0x404),
        Write(0xA00C, 0x405),
        Wait(1000),
        Write(0xA00C, 0x0002_0401),
        Wait(300),
        Write(0x0070, 0x0040_0000),
        Write(0x006C, 0x0EE4_7117),
        Wait(100),
        Write(0x006C, 0x0EE4_711F),
        Wait(100),
        Write(0x0070, 0x0048_0000),
        Wait(1000),
        // Biases.
        Write(0x1044, 0x01A9_8A7C),
        Write(0x1040, 0x01A9_8A94),
        Write(0x1048, 0x01A9_8B94),
        Write(0x101C, 0x01A1_575B),
        Write(0x1050, 0x01A1_B251),
        Write(0x1020, 0x01A9_CD44),
        Write(0x100C, 0x01A1_FF00),
        Write(0x1018, 0x01A1_3734),
        Write(0x1010, 0x01A1_6373),
        Write(0x1014, 0x01A1_5050),
        Write(0x1004, 0x01A1_E84A),
        Write(0x1008, 0x0121_0000),
        Write(0x1000, 0x01A1_C469),
        Write(0x104C, 0x01A1_9278),
        Write(0x1100, 5),
        Write(0x002C, 0x0022_C724),
        Write(0x0018, 0x200),
    ],
    start: &[
        Write(0xB000, 0x2D9),
        Write(READOUT, 0),
        Bits(TIME_BASE, 0x645, 1),
        Write(0x002C, 0x0022_C724),
        Bits(PIXELS, 0xF000_5442, PIXELS_GO),
    ],
    stop: &[
        Bits(PIXELS, 0xF000_5042, PIXELS_GO),
        Write(0x002C, 0x0022_C324),
        Write(0xC000, 2),
        Write(READOUT, 2),
        Write(0xC000, 5),
        Wait(1000),
        Bits(TIME_BASE, 0x644, 1),
        Write(0xB000, 0x2D8),
        Wait(300),
    ],
};

/// GenX320 on an EVK3. The sequence that makes it ready is not public under terms that this project can use, so the
/// sensor stays as its firmware or another program has set it up.
pub static GENX320: Sequences = Sequences {
    shut_down: &[],
    make_ready: &[],
    start: &[
        Write(0xB000, 0x1000_8803),
        Write(READOUT, 0),
        Bits(TIME_BASE, 0x195, 1),
        Write(0x002C, 0x0022_C724),
        Write(GENX320_PIXELS, 0xC02),
    ],
    stop: &[
        Write(GENX320_PIXELS, 0x802),
        Write(0x002C, 0x0020_0624),
        Write(READOUT, 2),
        Wait(1000),
        Bits(TIME_BASE, 0x194, 1),
        Write(0xB000, 0x1000_8804),
    ],
};
