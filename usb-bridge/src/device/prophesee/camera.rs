//! A simulated camera: it answers a host through Treuzell, keeps the values written to its registers, and streams
//! while they enable it.

use std::collections::HashMap;

use event_types::evt21::Order;

use super::registers::{
    CHIP, FORMAT, FORMAT_EVT21, GENX320_EVT21, GENX320_FORMAT, PIXELS_GO, READOUT, TIME_BASE,
};
use super::sensor::{Chip, EVK2_SYSTEM, EVK2_WITH_IMX636, STREAMER};
use super::treuzell::{
    BUILD_DATE, COMPATIBLE, DEVICES, FAILED, FRAME_BYTES_MAX, IN, NAME, OUT, REGISTERS, RELEASE,
    SERIAL, STREAM, WRITE, frame, number, parse, payload,
};
use super::{Format, KIND_REQUEST, STREAM_IN};
use crate::device::stream_endpoint::StreamEndpoint;
use crate::device::{Identity, Stream};
use crate::link::control::Request;
use crate::peripheral::descriptors::{Device, Endpoint, Interface};
use crate::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

/// Firmware release that it reports: 3.9.0.
const FIRMWARE: u32 = 0x0003_0900;
/// Build date that it reports, in seconds since 1970.
const BUILT: u64 = 1_700_000_000;
const SERIAL_NUMBER: u64 = 0x0005_0567;
/// Most registers that are kept, more than any sequence writes.
const KEPT_MAX: usize = 4096;
/// Most bytes of answers that wait to be fetched.
const ANSWERS_BYTES_MAX: usize = 16 * FRAME_BYTES_MAX;
/// Error numbers of the system.
const INVALID: u32 = 22;
const NO_DEVICE: u32 = 19;
const NO_MEMORY: u32 = 12;

/// Properties of older boards: a register of the board to read or to write, and whether its logic is ready.
const BOARD_READ: u32 = 0x55;
const BOARD_WRITE: u32 = 0x56;
const LOGIC_STATE: u32 = 0x71;
/// Requests of older boards: the version of the firmware, and whether the logic is ready.
const VERSION_REQUEST: u8 = 0x70;
const LOGIC_STATE_REQUEST: u8 = 0x71;
/// Version of the boards that have a Gen 4.1.
const VERSION: u8 = 3;

/// What the sensors' registers hold after the camera was switched on, as hosts ask for it: factory values of biases, which
/// hosts add to, and measurements, each with the bit that says it is valid. The values are plausible; those of a device
/// are not known here.
const IMX636_STATE: &[(u32, u32)] = &[
    // Biases: pr, fo, hpf, diff_on, diff, diff_off, inv, refr.
    (0x1000, 0x7D),
    (0x1004, 0x4A),
    (0x100C, 0x00),
    (0x1010, 0x66),
    (0x1014, 0x4D),
    (0x1018, 0x49),
    (0x101C, 0x5B),
    (0x1020, 0x14),
    // Illumination: about 300 lx.
    (0x0010, 1 << 29 | 2849),
    // Dead time of a pixel: 20 us.
    (0x0020, 1 << 28 | 4000),
    // Temperature: 30 degrees Celsius.
    (0x0050, 1 << 11 | 453),
    // The filters of flicker and of trails are ready.
    (0xC0C4, 1 << 2),
    (0xD0C4, 1 << 2),
];
const GENX320_STATE: &[(u32, u32)] = &[
    (GENX320_FORMAT, GENX320_EVT21),
    // Biases: pr, fo, fes, hpf, diff_on, each in bits 6..0.
    (0x1000, 0x3D),
    (0x1004, 0x27),
    (0x1008, 0x3F),
    (0x100C, 0x00),
    (0x1010, 0x18),
];

const fn sensor_state(chip: Chip) -> &'static [(u32, u32)] {
    match chip {
        Chip::Genx320 => GENX320_STATE,
        _ => IMX636_STATE,
    }
}

/// A simulated camera of Prophesee.
pub struct TreuzellCamera {
    descriptors: Descriptors,
    chip: Chip,
    registers: HashMap<u32, u32>,
    /// Whether the streamer runs, if the board has one.
    is_streaming: bool,
    answers: std::collections::VecDeque<Vec<u8>>,
    stream: StreamEndpoint,
}

impl TreuzellCamera {
    /// Creates a camera with this sensor that sends `stream`, which has the given format.
    #[must_use]
    pub fn new(identity: Identity, chip: Chip, format: Format, stream: Box<dyn Stream>) -> Self {
        let is_evk2 = chip == Chip::Evk2Imx636;
        let serial = format!("{SERIAL_NUMBER:08}");
        let product = match chip {
            Chip::Imx636 | Chip::Imx646 => "EVK4",
            Chip::Gen41 | Chip::Genx320 => "EVK3",
            Chip::Evk2Imx636 => "EVKv2",
        };
        // In the order in which drivers look for them.
        let endpoints = [IN, OUT, STREAM_IN].map(Endpoint::bulk);
        let interface = Interface {
            class: [0xFF, 0x19, 0],
            ..Interface::vendor(0, &endpoints)
        };
        let descriptors = Device {
            speed: Speed::Super,
            vendor: identity.vendor,
            product: identity.product,
            release: 0x0309,
            names: ["Prophesee", product, if is_evk2 { "" } else { &serial }],
            interfaces: &[interface],
            ..Device::default()
        }
        .describe();
        let mut camera = Self {
            descriptors,
            chip,
            registers: HashMap::new(),
            is_streaming: false,
            answers: std::collections::VecDeque::new(),
            stream: StreamEndpoint::new(stream),
        };
        for (address, value) in [(CHIP, chip.number()), (READOUT, 2)]
            .iter()
            .chain(sensor_state(chip))
        {
            camera.registers.insert(chip.base() + address, *value);
        }
        if chip == Chip::Evk2Imx636 {
            camera.registers.insert(EVK2_SYSTEM, EVK2_WITH_IMX636);
        }
        if format == Format::Evt21(Order::UpperFirst) {
            let format = chip.base() + FORMAT;
            camera.registers.insert(format, FORMAT_EVT21);
        }
        camera
    }

    fn register(&self, address: u32) -> u32 {
        let value = self.registers.get(&address);
        value.copied().unwrap_or(0)
    }

    /// Writes a register; returns `false` if no more are kept.
    fn write(&mut self, address: u32, value: u32) -> bool {
        // The chip's number is read-only.
        if address == self.chip.base() + CHIP {
            return true;
        }
        let is_new = !self.registers.contains_key(&address);
        let is_kept = !is_new || self.registers.len() < KEPT_MAX;
        if is_kept {
            self.registers.insert(address, value);
        }
        is_kept
    }

    /// Returns whether events are sent: readout, time base, pixels and streamer are all enabled.
    #[must_use]
    pub fn is_started(&self) -> bool {
        let at = |address| self.register(self.chip.base() + address);
        at(READOUT) & 2 == 0
            && at(TIME_BASE) & 1 != 0
            && at(self.chip.pixels()) & PIXELS_GO != 0
            && (self.is_streaming || !self.chip.has_streamer())
    }

    /// Returns the number of devices; the sensor's is the last.
    const fn devices(&self) -> u32 {
        1 + self.chip.has_streamer() as u32
    }

    fn answer(&mut self, question: &[u8]) -> Vec<u8> {
        // Such questions have the register's address where others have their length.
        let numbers = [0, 1, 2].map(|at| number(question, at));
        match numbers {
            [Some(BOARD_READ), Some(address), None] if self.chip == Chip::Gen41 => {
                return frame(BOARD_READ, &payload(&[self.register(address)]));
            }
            [Some(BOARD_WRITE), Some(address), Some(value)] if self.chip == Chip::Gen41 => {
                return if self.write(address, value) {
                    frame(BOARD_WRITE, &payload(&[address]))
                } else {
                    frame(FAILED, &[])
                };
            }
            _ => {}
        }
        let Some((property, content)) = parse(question) else {
            return frame(FAILED, &[]);
        };
        let device = number(content, 0).unwrap_or(0);
        let failed = |mut numbers: Vec<u32>, why| {
            numbers.push(why);
            frame(property | FAILED, &payload(&numbers))
        };
        let is_device = device < self.devices();
        let is_sensor = device + 1 == self.devices();
        match property {
            RELEASE => frame(property, &payload(&[FIRMWARE])),
            BUILD_DATE => frame(property, &BUILT.to_le_bytes()),
            SERIAL => frame(property, &SERIAL_NUMBER.to_le_bytes()),
            DEVICES => frame(property, &payload(&[self.devices()])),
            NAME | COMPATIBLE if content.len() < 4 || !is_device => failed(vec![device], NO_DEVICE),
            NAME | COMPATIBLE => {
                let text = match (is_sensor, property) {
                    (false, _) => STREAMER,
                    (true, NAME) => "CCam5 event-based camera",
                    (true, _) => self.chip.compatible(),
                };
                let mut content = device.to_le_bytes().to_vec();
                content.extend(text.bytes());
                content.push(0);
                frame(property, &content)
            }
            REGISTERS => {
                let address = number(content, 1).unwrap_or(0);
                match number(content, 2) {
                    Some(count) if is_sensor && count as usize <= FRAME_BYTES_MAX / 4 - 4 => {
                        let mut numbers = vec![device, address];
                        let addresses = (0..count).map(|at| address.wrapping_add(4 * at));
                        numbers.extend(addresses.map(|address| self.register(address)));
                        frame(property, &payload(&numbers))
                    }
                    Some(_) if !is_sensor => failed(vec![device, address], NO_DEVICE),
                    _ => failed(vec![device, address], INVALID),
                }
            }
            _ if property == REGISTERS | WRITE => {
                let address = number(content, 1).unwrap_or(0);
                let values = content.as_chunks::<4>().0.get(2..).unwrap_or_default();
                if !is_sensor || values.is_empty() {
                    return failed(vec![device, address], INVALID);
                }
                for (index, value) in (0..).zip(values) {
                    let address = address.wrapping_add(4 * index);
                    if !self.write(address, u32::from_le_bytes(*value)) {
                        return failed(vec![device, address], NO_MEMORY);
                    }
                }
                frame(property, &payload(&[device, address]))
            }
            _ if property == STREAM | WRITE && !is_sensor && is_device => {
                let on = number(content, 1).unwrap_or(0);
                self.is_streaming = on != 0;
                frame(property, &payload(&[device, on]))
            }
            STREAM if !is_sensor && is_device => {
                frame(property, &payload(&[device, self.is_streaming.into()]))
            }
            LOGIC_STATE if self.chip == Chip::Gen41 => frame(property, &payload(&[1])),
            _ => frame(FAILED, &[]),
        }
    }
}

impl Peripheral for TreuzellCamera {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, _: &[u8], length: usize) -> Reply {
        let answer = match (request.kind, request.request, self.chip.kind()) {
            (Request::VENDOR_IN, KIND_REQUEST, Some(kind)) => [kind, 0],
            (Request::VENDOR_IN, VERSION_REQUEST, Some(_)) if self.chip == Chip::Gen41 => {
                [VERSION, 0]
            }
            (Request::VENDOR_IN, LOGIC_STATE_REQUEST, Some(_)) if self.chip == Chip::Gen41 => {
                [1, 0]
            }
            _ => return Reply::Stall,
        };
        Reply::Data(answer[..length.min(2)].to_vec())
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        if endpoint != OUT {
            return false;
        }
        let waiting: usize = self.answers.iter().map(Vec::len).sum();
        if waiting < ANSWERS_BYTES_MAX {
            let answer = self.answer(data);
            self.stream.set_running(self.is_started());
            self.answers.push_back(answer);
        }
        true
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        match endpoint {
            IN => match self.answers.pop_front() {
                Some(mut answer) => {
                    answer.truncate(room);
                    data.extend(answer);
                    Bulk::Data
                }
                None => Bulk::Wait,
            },
            STREAM_IN => self.stream.send(room, data),
            _ => Bulk::Stall,
        }
    }

    fn clear_halt(&mut self, endpoint: u8) {
        if endpoint == STREAM_IN {
            self.stream.clear_halt();
        }
    }

    fn reset(&mut self) {
        self.answers.clear();
        // A new host finds a silent camera.
        self.registers.insert(self.chip.base() + READOUT, 2);
        self.is_streaming = false;
        self.stream.set_running(false);
        self.stream.clear_halt();
    }
}
