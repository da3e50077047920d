//! Registers of the cameras' logic, for both ends: the host that uses them, and the simulated camera.
//!
//! | vendor request | value | index | data |
//! |---|---|---|---|
//! | 0xBF, in or out | module | register | 4 bytes, big-endian |
//! | 0xC2, out | number of entries | 0 | 6 bytes per entry: module, register, 4 bytes big-endian |
//! | 0xB1, out | log level of the firmware | 0 | none |
//! | 0xC6, out | 0 | 0 | none: drops what waits to be sent |
//!
//! Firmware of the MIPI variant from version 10 on has registers of 8 bytes in place of 4.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};

use crate::link::control::{Control, Request};
use crate::peripheral::Reply;

/// Module and number of a register.
pub type Register = (u16, u16);

/// Endpoint of the stream.
pub const ENDPOINT: u8 = 0x82;

/// Endpoint of the firmware's messages, which are not read.
pub const DEBUG_ENDPOINT: u8 = 0x81;

/// USB vendor ID of every camera.
pub const VENDOR: u16 = 0x152A;

/// Enables the multiplexer of the stream.
pub const MUX_RUN: Register = (0, 0);
/// Enables the multiplexer's clock.
pub const MUX_TIME_RUN: Register = (0, 1);
/// Sets the clock to 0 when it is written with another value than 0.
pub const MUX_TIME_RESET: Register = (0, 2);
/// Enables power and biases of the sensor.
pub const MUX_CHIP_RUN: Register = (0, 3);
/// External inputs are dropped when the host is slow.
pub const MUX_DROP_INPUTS: Register = (0, 4);
/// Events are dropped when the host is slow.
pub const MUX_DROP_EVENTS: Register = (0, 5);
/// Number of columns of the sensor.
pub const DVS_COLUMNS: Register = (1, 0);
/// Number of rows of the sensor.
pub const DVS_ROWS: Register = (1, 1);
/// Orientation; bit 2: columns and rows are exchanged.
pub const DVS_ORIENTATION: Register = (1, 2);
/// Enables the readout of events.
pub const DVS_RUN: Register = (1, 3);
/// Whether the logic drops the events of single pixels.
pub const DVS_HAS_PIXEL_FILTER: Register = (1, 10);
/// Whether the logic filters background activity.
pub const DVS_HAS_BACKGROUND_FILTER: Register = (1, 30);
/// Whether the logic keeps a region alone.
pub const DVS_HAS_REGION_FILTER: Register = (1, 40);
/// Whether the logic leaves out every n-th event.
pub const DVS_HAS_SKIP_FILTER: Register = (1, 50);
/// Whether the logic drops a polarity.
pub const DVS_HAS_POLARITY_FILTER: Register = (1, 60);
/// Number of columns of frames.
pub const APS_COLUMNS: Register = (2, 0);
/// Number of rows of frames.
pub const APS_ROWS: Register = (2, 1);
/// Orientation of frames, as of events.
pub const APS_ORIENTATION: Register = (2, 2);
/// Whether frames have a global shutter.
pub const APS_HAS_GLOBAL_SHUTTER: Register = (2, 6);
/// Enables the readout of frames.
pub const APS_RUN: Register = (2, 4);
/// Kind of the inertial sensor: 0 none, 1 MPU-6050 or 6150, 2 MPU-9250.
pub const IMU_KIND: Register = (3, 0);
/// Enables the readout of the accelerometer.
pub const IMU_ACCELEROMETER_RUN: Register = (3, 2);
/// Enables the readout of the gyroscope.
pub const IMU_GYROSCOPE_RUN: Register = (3, 3);
/// Enables the readout of the thermometer.
pub const IMU_TEMPERATURE_RUN: Register = (3, 4);
/// Enables the readout of external inputs.
pub const INPUT_RUN: Register = (4, 0);
/// Version of the logic.
pub const LOGIC_VERSION: Register = (6, 0);
/// Number of the chip.
pub const CHIP: Register = (6, 1);
/// Whether the camera's clock is its own, and not another camera's.
pub const IS_MASTER: Register = (6, 2);
/// Clock of the logic, in MHz.
pub const LOGIC_CLOCK: Register = (6, 3);
/// Clock of the analogue-to-digital converter, in MHz.
pub const ADC_CLOCK: Register = (6, 4);
/// Clock of the USB side, in MHz.
pub const USB_CLOCK: Register = (6, 5);
/// True rate of the clocks, in thousandths of the nominal rate.
pub const CLOCK_DEVIATION: Register = (6, 6);
/// Patch level of the logic.
pub const LOGIC_PATCH: Register = (6, 7);
/// Enables the output to the endpoint.
pub const USB_RUN: Register = (9, 0);

/// How long the USB side waits for more data before it sends a packet that is not full, in its clock's ticks.
pub const EARLY_PACKET_DELAY: Register = (9, 1);

/// Delay of a packet that is not full, in us: a transfer ends with such a packet, so that large ones wait no longer.
const EARLY_PACKET_US: u32 = 1000;

/// The only version of the logic whose stream is known.
pub const LOGIC_KNOWN: u32 = 18;

/// Number of modules that a camera has.
const MODULES: u16 = 10;

/// The module that describes the camera; its registers are read-only.
const SYSTEM: u16 = 6;

/// Request that sets how much the firmware logs; the value is the level.
pub const LOG_LEVEL: u8 = 0xB1;
/// Request that drops what waits to be sent.
pub const DROP_DATA: u8 = 0xC6;

const REGISTER: u8 = 0xBF;
const REGISTERS: u8 = 0xC2;

/// Bytes per register in a request for several registers.
const ENTRY: usize = 6;

/// Returns whether the registers of a camera with this `bcdDevice` have 8 bytes: those of the MIPI variant, major number
/// 4, from firmware 10 on.
#[must_use]
pub const fn are_long(release: u16) -> bool {
    release >> 8 == 4 && release & 0xFF >= 10
}

/// Reads a register.
///
/// # Errors
/// The camera does not answer, or not with as many bytes as its registers have.
pub fn read(control: &mut dyn Control, (module, register): Register) -> Result<u32> {
    let wanted = if are_long(control.release()) { 8 } else { 4 };
    let mut data = [0; 8];
    let request = Request::vendor_in(REGISTER, module, register);
    let got = control
        .control_in(request, &mut data[..wanted])
        .with_context(|| format!("register {module}/{register:#x} cannot be read"))?;
    ensure!(
        got == wanted,
        "{}: register {module}/{register:#x} was answered with {got} bytes instead of {wanted}: \
         reconnect the camera",
        control.name()
    );
    let value = data[..wanted].last_chunk().copied().unwrap_or_default();
    Ok(u32::from_be_bytes(value))
}

/// Writes a register.
///
/// # Errors
/// The camera refuses the request.
pub fn write(control: &mut dyn Control, (module, register): Register, value: u32) -> Result<()> {
    let request = Request::vendor_out(REGISTER, module, register);
    let long = u64::from(value).to_be_bytes();
    let data = if are_long(control.release()) {
        &long[..]
    } else {
        &long[4..]
    };
    control
        .control_out(request, data)
        .with_context(|| format!("register {module}/{register:#x} cannot be set"))
}

/// Sets [`EARLY_PACKET_DELAY`] to 1 ms by the camera's own clock.
///
/// # Errors
/// The camera refuses a request.
pub fn end_transfers_early(control: &mut dyn Control) -> Result<()> {
    let clock_mhz = read(control, USB_CLOCK)?;
    // Its register has 16 bits or more; a clock that none has leaves the delay as it is.
    match clock_mhz {
        1..=1000 => write(control, EARLY_PACKET_DELAY, EARLY_PACKET_US * clock_mhz),
        _ => Ok(()),
    }
}

/// Writes registers in the given order.
///
/// # Errors
/// The camera refuses one of them.
pub fn write_all(control: &mut dyn Control, values: &[(Register, u32)]) -> Result<()> {
    values
        .iter()
        .try_for_each(|(register, value)| write(control, *register, *value))
}

/// Writes 0 to registers in the given order.
///
/// # Errors
/// The camera refuses one of them.
pub fn clear_all(control: &mut dyn Control, registers: &[Register]) -> Result<()> {
    registers
        .iter()
        .try_for_each(|register| write(control, *register, 0))
}

/// Registers of a simulated camera.
#[derive(Debug, Clone)]
pub struct RegisterFile {
    values: BTreeMap<Register, u32>,
    /// Values of read-only registers.
    fixed: BTreeMap<Register, u32>,
    /// Whether registers of 8 bytes are answered as well as those of 4.
    takes_long: bool,
    /// Whether the host has reset the clock since [`RegisterFile::take_time_reset`].
    is_time_reset: bool,
}

impl RegisterFile {
    /// Creates registers that are all 0, except the read-only ones in `fixed`.
    pub fn new(fixed: &[(Register, u32)]) -> Self {
        Self {
            values: BTreeMap::new(),
            fixed: fixed.iter().copied().collect(),
            takes_long: false,
            is_time_reset: false,
        }
    }

    /// Also answers requests for registers of 8 bytes, whose upper half is 0.
    #[must_use]
    pub fn with_long(mut self) -> Self {
        self.takes_long = true;
        self
    }

    /// Returns the value of a register.
    pub fn get(&self, register: Register) -> u32 {
        let value = self.fixed.get(&register);
        value
            .or_else(|| self.values.get(&register))
            .copied()
            .unwrap_or(0)
    }

    /// Returns whether all of `registers` are non-zero.
    pub fn all_set(&self, registers: &[Register]) -> bool {
        registers.iter().all(|register| self.get(*register) != 0)
    }

    /// Returns whether the host has reset the clock since the last call.
    pub fn take_time_reset(&mut self) -> bool {
        std::mem::take(&mut self.is_time_reset)
    }

    /// Resets the registers that can be written to 0.
    pub fn reset(&mut self) {
        self.values.clear();
    }

    /// Answers a control request with at most `length` bytes; stalls unknown requests and modules.
    pub fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        let register = (request.value, request.index);
        match (request.kind, request.request) {
            (Request::VENDOR_IN, REGISTER) if register.0 < MODULES => {
                let value = u64::from(self.get(register)).to_be_bytes();
                let short = if self.takes_long && length >= 8 { 0 } else { 4 };
                let mut value = value[short..].to_vec();
                value.truncate(length);
                Reply::Data(value)
            }
            (Request::VENDOR_OUT, REGISTER) if register.0 < MODULES => {
                let value = data.last_chunk().copied();
                let Some(value) =
                    value.filter(|_| data.len() == 4 || self.takes_long && data.len() == 8)
                else {
                    return Reply::Stall;
                };
                self.set(register, u32::from_be_bytes(value));
                Reply::Data(Vec::new())
            }
            (Request::VENDOR_OUT, REGISTERS)
                if data.len() == ENTRY * usize::from(request.value)
                    && data
                        .chunks_exact(ENTRY)
                        .all(|entry| u16::from(entry[0]) < MODULES) =>
            {
                for entry in data.chunks_exact(ENTRY) {
                    let value = u32::from_be_bytes([entry[2], entry[3], entry[4], entry[5]]);
                    self.set((entry[0].into(), entry[1].into()), value);
                }
                Reply::Data(Vec::new())
            }
            // No data waits here: it is made when the host takes it.
            (Request::VENDOR_OUT, LOG_LEVEL | DROP_DATA) if data.is_empty() => {
                Reply::Data(Vec::new())
            }
            _ => Reply::Stall,
        }
    }

    fn set(&mut self, register: Register, value: u32) {
        // A host may set and clear this register in one request.
        self.is_time_reset |= register == MUX_TIME_RESET && value != 0;
        if register.0 != SYSTEM && !self.fixed.contains_key(&register) {
            self.values.insert(register, value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registers_are_read_as_written_and_refused_where_there_are_none() {
        let mut file = RegisterFile::new(&[(CHIP, 5)]);
        let out = |value, index| Request::vendor_out(REGISTER, value, index);
        let done = Reply::Data(Vec::new());
        assert_eq!(file.control(out(0, 3), &[0, 0, 1, 2], 0), done);
        assert_eq!(
            file.control(Request::vendor_in(REGISTER, 0, 3), &[], 4),
            Reply::Data(vec![0, 0, 1, 2])
        );
        assert_eq!(file.control(out(6, 1), &[9; 4], 0), done);
        assert_eq!(file.get(CHIP), 5);
        assert_eq!(file.control(out(0, 3), &[0, 0, 1], 0), Reply::Stall);
        assert_eq!(file.control(out(10, 3), &[0; 4], 0), Reply::Stall);
        let many = Request::vendor_out(REGISTERS, 2, 0);
        let data = [0, 0, 0, 0, 0, 1, 9, 0, 0, 0, 0, 7];
        assert_eq!(file.control(many, &data, 0), done);
        assert_eq!((file.get(MUX_RUN), file.get(USB_RUN)), (1, 7));
        assert_eq!(file.control(many, &data[1..], 0), Reply::Stall);
        file.reset();
        assert!(!file.all_set(&[MUX_RUN]));
    }
}
