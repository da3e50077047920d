//! Registers of the cameras' logic, for both ends: the host that uses them, and the simulated camera.
//!
//! | vendor request | value | index | data |
//! |---|---|---|---|
//! | 0xBF, in or out | module | register | 4 bytes, big-endian |
//! | 0xC2, out | number of entries | 0 | 6 bytes per entry: module, register, 4 bytes big-endian |

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
/// Enables the readout of frames.
pub const APS_RUN: Register = (2, 4);
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

/// The only version of the logic whose stream is known.
pub const LOGIC_KNOWN: u32 = 18;

/// Number of modules that a camera has.
const MODULES: u16 = 10;

/// The module that describes the camera; its registers are read-only.
const SYSTEM: u16 = 6;

const REGISTER: u8 = 0xBF;
const REGISTERS: u8 = 0xC2;

/// Bytes per register in a request for several registers.
const ENTRY: usize = 6;

/// Reads a register.
///
/// # Errors
/// The camera does not answer, or not with 4 bytes.
pub fn read(control: &mut dyn Control, (module, register): Register) -> Result<u32> {
    let mut data = [0; 4];
    let request = Request::vendor_in(REGISTER, module, register);
    let got = control
        .control_in(request, &mut data)
        .with_context(|| format!("register {module}/{register:#x} cannot be read"))?;
    ensure!(
        got == data.len(),
        "{}: register {module}/{register:#x} came with {got} bytes, not 4: reconnect the camera",
        control.name()
    );
    Ok(u32::from_be_bytes(data))
}

/// Writes a register.
///
/// # Errors
/// The camera refuses the request.
pub fn write(control: &mut dyn Control, (module, register): Register, value: u32) -> Result<()> {
    let request = Request::vendor_out(REGISTER, module, register);
    control
        .control_out(request, &value.to_be_bytes())
        .with_context(|| format!("register {module}/{register:#x} cannot be set"))
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
}

impl RegisterFile {
    /// Creates registers that are all 0, except the read-only ones in `fixed`.
    pub fn new(fixed: &[(Register, u32)]) -> Self {
        Self {
            values: BTreeMap::new(),
            fixed: fixed.iter().copied().collect(),
        }
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

    /// Resets the registers that can be written to 0.
    pub fn reset(&mut self) {
        self.values.clear();
    }

    /// Answers a control request with at most `length` bytes; stalls unknown requests and modules.
    pub fn control(&mut self, request: Request, data: &[u8], length: usize) -> Reply {
        let register = (request.value, request.index);
        match (request.kind, request.request) {
            (Request::VENDOR_IN, REGISTER) if register.0 < MODULES => {
                let mut value = self.get(register).to_be_bytes().to_vec();
                value.truncate(length);
                Reply::Data(value)
            }
            (Request::VENDOR_OUT, REGISTER) if register.0 < MODULES => {
                let Ok(value) = data.try_into() else {
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
            _ => Reply::Stall,
        }
    }

    fn set(&mut self, register: Register, value: u32) {
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
