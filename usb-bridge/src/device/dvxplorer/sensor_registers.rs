//! Start values of the DVXplorer's sensor registers (module 5): biases, a system clock of 50 MHz, time in
//! microseconds, masks of two groups, no crop and no filter.

use crate::device::inivation::registers::Register;

const fn byte(register: u16, value: u32) -> (Register, u32) {
    ((5, register), value)
}

/// Registers and values, in the order in which they are written.
pub static SENSOR_REGISTERS: [(Register, u32); 57] = [
    // Biases: reset, pins, ranges, levels, currents.
    byte(0x000D, 0x24),
    byte(0x000F, 0x07),
    byte(0x0010, 0xFF),
    byte(0x0013, 0x03),
    byte(0x0014, 0x7F),
    byte(0x0015, 0x00),
    byte(0x000B, 0x00),
    byte(0x000C, 0x14),
    byte(0x0012, 0x6F),
    byte(0x0018, 4),
    byte(0x001C, 8),
    byte(0x001E, 8),
    // Clock divided by 10, parallel output, two groups in a word.
    byte(0x3011, 0xA0),
    byte(0x3019, 0x00),
    byte(0x301E, 0x01),
    byte(0x3067, 0x80),
    byte(0x3255, 0x0C),
    byte(0x3266, 0x08),
    // Reference of 1000 us, and fine counts of 50 ticks per microsecond.
    byte(0x3235, 0x03),
    byte(0x3236, 0xE7),
    byte(0x3234, 49),
    byte(0x323D, 50),
    byte(0x3243, 50),
    byte(0x3247, 50),
    byte(0x3259, 50),
    // Histogram, activity and crop are off.
    byte(0x3600, 0x01),
    byte(0x3500, 0x01),
    byte(0x3300, 0x01),
    // No trigger, no reset during the readout, no binning; held during the readout.
    byte(0x3260, 0x00),
    byte(0x3248, 0x00),
    byte(0x3200, 0x06),
    byte(0x3202, 0x00),
    byte(0x3204, 0x00),
    byte(0x3255, 0x0D),
    byte(0x325C, 0x00),
    // Timing of the readout.
    byte(0x3240, 0),
    byte(0x3241, 0),
    byte(0x3242, 2),
    byte(0x3244, 0),
    byte(0x3245, 0),
    byte(0x3246, 0),
    byte(0x3256, 0),
    byte(0x3257, 0),
    byte(0x3258, 1),
    byte(0x323C, 4),
    byte(0x324C, 6),
    byte(0x324E, 4),
    byte(0x324F, 6),
    byte(0x3253, 8),
    byte(0x3254, 10),
    byte(0x3261, 0),
    byte(0x3262, 15),
    byte(0x324B, 4),
    byte(0x325D, 45_000 >> 8),
    byte(0x325E, 45_000 & 0xFF),
    // Restart of the counter of the sensor's time.
    byte(0x3201, 0x01),
    byte(0x3201, 0x02),
];
