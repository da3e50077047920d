//! Bias currents and settings of the DAVIS chips, without which their pixels do not respond.
//!
//! | kind | value of the register |
//! |---|---|
//! | current | coarse * 2^12 + fine * 2^4 + normal level 8 + normal type 4 + N 2 + enabled 1 |
//! | voltage | current * 2^6 + voltage |
//! | shifted source | regulator * 2^10 + reference * 2^4 |
//!
//! The values are the vendor's defaults.

use crate::device::inivation::registers::Register;

/// Module of the chip's configuration registers.
const CHIP: u16 = 5;

const fn n_type(register: u16, coarse: u32, fine: u32) -> (Register, u32) {
    ((CHIP, register), coarse << 12 | fine << 4 | 0b1111)
}

const fn n_type_off(register: u16, coarse: u32, fine: u32) -> (Register, u32) {
    ((CHIP, register), coarse << 12 | fine << 4 | 0b1110)
}

const fn n_type_cascode(register: u16, coarse: u32, fine: u32) -> (Register, u32) {
    ((CHIP, register), coarse << 12 | fine << 4 | 0b1011)
}

const fn p_type(register: u16, coarse: u32, fine: u32) -> (Register, u32) {
    ((CHIP, register), coarse << 12 | fine << 4 | 0b1101)
}

const fn voltage(register: u16, voltage: u32, current: u32) -> (Register, u32) {
    ((CHIP, register), current << 6 | voltage)
}

const fn shifted(register: u16, reference: u32, regulator: u32) -> (Register, u32) {
    ((CHIP, register), regulator << 10 | reference << 4)
}

const fn setting(register: u16, value: u32) -> (Register, u32) {
    ((CHIP, register), value)
}

static DAVIS240: [(Register, u32); 35] = [
    n_type(0, 4, 39),
    n_type(1, 5, 255),
    n_type(2, 4, 0),
    n_type_cascode(3, 5, 185),
    n_type_cascode(4, 5, 115),
    n_type(5, 6, 219),
    n_type(6, 5, 164),
    n_type(7, 5, 129),
    p_type(8, 2, 58),
    p_type(9, 1, 16),
    p_type(10, 4, 25),
    n_type(11, 6, 91),
    n_type(12, 5, 49),
    p_type(13, 4, 80),
    p_type(14, 7, 152),
    n_type(15, 5, 255),
    n_type(16, 5, 255),
    n_type(17, 7, 215),
    n_type(18, 6, 253),
    n_type(19, 5, 254),
    shifted(20, 1, 33),
    shifted(21, 1, 33),
    setting(128, 0),
    setting(129, 0),
    setting(130, 0),
    setting(131, 0),
    setting(132, 0),
    setting(133, 0),
    setting(134, 0),
    setting(135, 0),
    setting(136, 1),
    setting(137, 0),
    setting(138, 1),
    setting(140, 0),
    setting(141, 0),
];

static DAVIS346: [(Register, u32); 44] = [
    voltage(0, 27, 6),
    voltage(1, 21, 6),
    voltage(2, 32, 7),
    voltage(3, 1, 7),
    voltage(4, 21, 7),
    n_type(8, 5, 164),
    n_type_off(9, 7, 215),
    n_type(10, 4, 39),
    n_type(11, 5, 255),
    n_type(12, 4, 1),
    n_type(13, 5, 129),
    p_type(14, 2, 58),
    p_type(15, 1, 16),
    p_type(16, 4, 25),
    p_type(17, 6, 20),
    n_type(18, 6, 219),
    p_type(19, 5, 20),
    n_type(20, 0, 1),
    p_type(21, 6, 60),
    n_type(22, 5, 49),
    n_type(23, 6, 91),
    p_type(24, 4, 80),
    p_type(25, 7, 152),
    n_type(26, 5, 255),
    n_type(27, 5, 255),
    n_type(34, 5, 254),
    shifted(35, 1, 33),
    shifted(36, 1, 33),
    setting(128, 0),
    setting(129, 0),
    setting(130, 0),
    setting(131, 0),
    setting(132, 0),
    setting(133, 0),
    setting(134, 0),
    setting(135, 0),
    setting(136, 1),
    setting(137, 0),
    setting(138, 1),
    setting(140, 0),
    setting(141, 0),
    setting(142, 0),
    setting(143, 1),
    setting(144, 0),
];

/// Returns the name of a chip by its number; `None` if its settings are not known.
pub fn chip_name(chip: u32) -> Option<&'static str> {
    match chip {
        0 => Some("DAVIS240A"),
        1 => Some("DAVIS240B"),
        2 => Some("DAVIS240C"),
        4 | 5 | 9 => Some("DAVIS346"),
        _ => None,
    }
}

/// Returns the settings for a camera of this name; empty if they are not known, so that the logic keeps its own.
pub fn of(name: &str) -> &'static [(Register, u32)] {
    match name {
        "DAVIS240A" | "DAVIS240B" | "DAVIS240C" => &DAVIS240,
        "DAVIS346" => &DAVIS346,
        _ => &[],
    }
}
