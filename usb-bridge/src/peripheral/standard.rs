//! The requests that every device answers (USB 2.0 and USB 3.2, chapter 9), from its descriptors.

use super::descriptors::{CONFIGURATION, DescribedEndpoint, Layout, kind};
use super::{Descriptors, Peripheral, Reply};
use crate::link::control::Request;

/// Most interfaces that a device may have.
const INTERFACES_MAX: usize = 32;

/// English (United States), the only language of strings.
const LANGUAGE: u16 = 0x0409;

/// Most UTF-16 units of a string, because its descriptor's length is one byte.
const STRING_UNITS_MAX: usize = 126;

/// `bRequest` of the standard requests.
mod request {
    pub const GET_STATUS: u8 = 0;
    pub const CLEAR_FEATURE: u8 = 1;
    pub const SET_FEATURE: u8 = 3;
    pub const SET_ADDRESS: u8 = 5;
    pub const GET_DESCRIPTOR: u8 = 6;
    pub const GET_CONFIGURATION: u8 = 8;
    pub const SET_CONFIGURATION: u8 = 9;
    pub const GET_INTERFACE: u8 = 10;
    pub const SET_INTERFACE: u8 = 11;
    pub const SET_SEL: u8 = 48;
    pub const SET_ISOCHRONOUS_DELAY: u8 = 49;
}

/// `bmRequestType` of the standard requests.
mod of {
    pub const DEVICE: u8 = 0x00;
    pub const INTERFACE: u8 = 0x01;
    pub const ENDPOINT: u8 = 0x02;
    pub const IN: u8 = 0x80;
}

/// Feature `ENDPOINT_HALT` of an endpoint.
const HALT: u16 = 0;
/// Feature `FUNCTION_SUSPEND` of a SuperSpeed interface.
const FUNCTION_SUSPEND: u16 = 0;
/// Features `U1_ENABLE` to `LTM_ENABLE` of a SuperSpeed device.
const POWER: std::ops::RangeInclusive<u16> = 48..=50;

/// State of a device on the bus: address, configuration, settings, halts.
#[derive(Debug, Clone)]
pub struct Standard {
    layout: Layout,
    is_super: bool,
    address: u8,
    configuration: u8,
    settings: [u8; INTERFACES_MAX],
    /// One bit per halted endpoint, at its number, plus 16 for endpoints to the host.
    halted: u32,
}

impl Standard {
    /// Creates the state after a reset.
    #[must_use]
    pub fn new(descriptors: &Descriptors) -> Self {
        Self {
            layout: Layout::of(&descriptors.configuration),
            is_super: descriptors.speed == super::Speed::Super,
            address: 0,
            configuration: 0,
            settings: [0; INTERFACES_MAX],
            halted: 0,
        }
    }

    /// Returns the interfaces and endpoints of the configuration.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Returns the address that the host has assigned; 0 if none.
    #[must_use]
    pub fn address(&self) -> u8 {
        self.address
    }

    /// Returns the value of the active configuration; 0 if none.
    #[must_use]
    pub fn configuration(&self) -> u8 {
        self.configuration
    }

    /// Returns the setting of an interface; `None` if there is no such interface.
    #[must_use]
    pub fn setting(&self, interface: u8) -> Option<u8> {
        let is_there = |one: &super::descriptors::DescribedInterface| one.number == interface;
        self.layout.interfaces.iter().find(|one| is_there(one))?;
        self.settings.get(usize::from(interface)).copied()
    }

    /// Returns an endpoint of the active settings; always `None` without a configuration.
    #[must_use]
    pub fn endpoint(&self, address: u8) -> Option<&DescribedEndpoint> {
        let configured = self.configuration != 0;
        self.layout.endpoints.iter().find(|one| {
            configured && one.address == address && self.setting(one.interface) == Some(one.setting)
        })
    }

    /// Returns whether an endpoint is halted.
    #[must_use]
    pub fn is_halted(&self, address: u8) -> bool {
        self.halted & bit(address) != 0
    }

    /// Halts an endpoint until the host clears the halt.
    pub fn halt(&mut self, address: u8) {
        self.halted |= bit(address);
    }

    /// Resets the state and the device, as after a reset of the bus.
    pub fn reset(&mut self, peripheral: &mut dyn Peripheral) {
        self.address = 0;
        self.unconfigure();
        peripheral.reset();
    }

    /// Answers a control request with at most `length` bytes: standard requests from the descriptors, all others
    /// through `peripheral`.
    pub fn control(
        &mut self,
        peripheral: &mut dyn Peripheral,
        request: Request,
        data: &[u8],
        length: u16,
    ) -> Reply {
        let reply = if request.kind & 0x60 == 0 {
            self.answer(peripheral, request)
                .map_or(Reply::Stall, Reply::Data)
        } else {
            peripheral.control(request, data, usize::from(length))
        };
        match reply {
            Reply::Data(mut bytes) if request.is_in() => {
                bytes.truncate(usize::from(length));
                Reply::Data(bytes)
            }
            Reply::Data(_) => Reply::Data(Vec::new()),
            Reply::Stall => Reply::Stall,
        }
    }

    /// Answers a standard request; `None` refuses it.
    fn answer(&mut self, peripheral: &mut dyn Peripheral, asked: Request) -> Option<Vec<u8>> {
        let Request {
            kind,
            request,
            value,
            index,
        } = asked;
        let [low, high] = value.to_le_bytes();
        let recipient = index as u8;
        const DEVICE_IN: u8 = of::IN | of::DEVICE;
        const INTERFACE_IN: u8 = of::IN | of::INTERFACE;
        const ENDPOINT_IN: u8 = of::IN | of::ENDPOINT;
        match (kind, request) {
            (DEVICE_IN, request::GET_DESCRIPTOR) => descriptor(peripheral.descriptors(), high, low),
            (DEVICE_IN, request::GET_CONFIGURATION) => Some(vec![self.configuration]),
            // Bus-powered, without remote wake-up.
            (DEVICE_IN, request::GET_STATUS) => Some(vec![0, 0]),
            (INTERFACE_IN, request::GET_STATUS) => self.setting(recipient).map(|_| vec![0, 0]),
            (INTERFACE_IN, request::GET_INTERFACE) if self.configuration != 0 => {
                self.setting(recipient).map(|setting| vec![setting])
            }
            (ENDPOINT_IN, request::GET_STATUS) => {
                self.has(recipient)?;
                Some(vec![u8::from(self.is_halted(recipient)), 0])
            }
            (of::DEVICE, request::SET_ADDRESS) if value < 128 => {
                self.address = low;
                Some(Vec::new())
            }
            (of::DEVICE, request::SET_CONFIGURATION) => {
                if value != 0 && value != u16::from(CONFIGURATION) {
                    return None;
                }
                self.unconfigure();
                self.configuration = low;
                peripheral.reset();
                Some(Vec::new())
            }
            (of::INTERFACE, request::SET_INTERFACE) if self.configuration != 0 => {
                self.set_interface(peripheral, recipient, low)
            }
            (of::ENDPOINT, request::CLEAR_FEATURE) if value == HALT => {
                self.has(recipient)?;
                self.halted &= !bit(recipient);
                if recipient & 0x0F != 0 {
                    peripheral.clear_halt(recipient);
                }
                Some(Vec::new())
            }
            (of::ENDPOINT, request::SET_FEATURE) if value == HALT => {
                self.has(recipient)?;
                // Endpoint 0 recovers with the next request.
                if recipient & 0x0F != 0 {
                    self.halt(recipient);
                }
                Some(Vec::new())
            }
            // These power states have no effect here, but some hosts insist on them.
            (of::DEVICE, request::SET_FEATURE | request::CLEAR_FEATURE)
                if self.is_super && POWER.contains(&value) =>
            {
                Some(Vec::new())
            }
            (of::INTERFACE, request::SET_FEATURE | request::CLEAR_FEATURE)
                if self.is_super && value == FUNCTION_SUSPEND =>
            {
                self.setting(recipient).map(|_| Vec::new())
            }
            (of::DEVICE, request::SET_SEL | request::SET_ISOCHRONOUS_DELAY) if self.is_super => {
                Some(Vec::new())
            }
            _ => None,
        }
    }

    fn set_interface(
        &mut self,
        peripheral: &mut dyn Peripheral,
        interface: u8,
        setting: u8,
    ) -> Option<Vec<u8>> {
        self.layout
            .interfaces
            .iter()
            .find(|one| one.number == interface && one.setting == setting)?;
        *self.settings.get_mut(usize::from(interface))? = setting;
        // A setting begins without halts.
        for endpoint in &self.layout.endpoints {
            if endpoint.interface == interface && endpoint.setting == setting {
                self.halted &= !bit(endpoint.address);
                peripheral.clear_halt(endpoint.address);
            }
        }
        Some(Vec::new())
    }

    /// Returns `Some` for endpoint 0 and for endpoints of the active settings.
    fn has(&self, address: u8) -> Option<()> {
        (address & 0x7F == 0 || self.endpoint(address).is_some()).then_some(())
    }

    fn unconfigure(&mut self) {
        self.configuration = 0;
        self.settings = [0; INTERFACES_MAX];
        self.halted = 0;
    }
}

/// Returns an endpoint's bit: its number, plus 16 for endpoints to the host.
fn bit(address: u8) -> u32 {
    1 << (address & 0x0F | (address & 0x80) >> 3)
}

/// Returns a descriptor. The device connects at one speed only, so a request for its qualifier is an error (9.6.2).
fn descriptor(descriptors: &Descriptors, what: u8, number: u8) -> Option<Vec<u8>> {
    match (what, number) {
        (kind::DEVICE, 0) => Some(descriptors.device.clone()),
        (kind::CONFIGURATION, 0) => Some(descriptors.configuration.clone()),
        (kind::BOS, 0) if !descriptors.bos.is_empty() => Some(descriptors.bos.clone()),
        (kind::STRING, 0) => Some(string(&[LANGUAGE])),
        (kind::STRING, number) => {
            let text = descriptors.strings.get(usize::from(number) - 1)?;
            let mut units = Vec::new();
            for character in text.chars() {
                let mut pair = [0; 2];
                let pair = character.encode_utf16(&mut pair);
                if units.len() + pair.len() > STRING_UNITS_MAX {
                    break;
                }
                units.extend_from_slice(pair);
            }
            (!units.is_empty()).then(|| string(&units))
        }
        _ => None,
    }
}

fn string(units: &[u16]) -> Vec<u8> {
    let mut bytes = vec![(2 + 2 * units.len()) as u8, kind::STRING];
    bytes.extend(units.iter().flat_map(|unit| unit.to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::Speed;
    use super::super::sequence::SequenceDevice;
    use super::*;

    fn ask(kind: u8, request: u8, value: u16, index: u16) -> Request {
        Request {
            kind,
            request,
            value,
            index,
        }
    }

    fn device(speed: Speed) -> (SequenceDevice, Standard) {
        let device = SequenceDevice::new(speed);
        let standard = Standard::new(device.descriptors());
        (device, standard)
    }

    #[test]
    fn a_device_is_enumerated() {
        let (mut device, mut standard) = device(Speed::Super);
        let mut get = |what: u16, number: u16, length| {
            let request = ask(0x80, 6, what << 8 | number, 0);
            standard.control(&mut device, request, &[], length)
        };
        let Reply::Data(bytes) = get(1, 0, 8) else {
            panic!("no device descriptor");
        };
        assert_eq!(bytes.len(), 8);
        let Reply::Data(bytes) = get(2, 0, 0xFFFF) else {
            panic!("no configuration");
        };
        assert_eq!(
            usize::from(u16::from_le_bytes([bytes[2], bytes[3]])),
            bytes.len()
        );
        assert_eq!(get(3, 0, 255), Reply::Data(vec![4, 3, 9, 4]));
        assert!(matches!(get(3, 2, 255), Reply::Data(bytes) if bytes[2] == b'S'));
        assert_eq!(get(3, 0xEE, 255), Reply::Stall);
        assert!(matches!(get(15, 0, 5), Reply::Data(bytes) if bytes.len() == 5));
        assert_eq!(get(6, 0, 10), Reply::Stall);
    }

    #[test]
    fn configuration_settings_and_halts_follow_the_requests() {
        let (mut device, mut standard) = device(Speed::High);
        let mut send = |standard: &mut Standard, kind, request, value, index| {
            standard.control(&mut device, ask(kind, request, value, index), &[], 2)
        };
        let done = Reply::Data(Vec::new());
        assert_eq!(send(&mut standard, 0, 5, 7, 0), done);
        assert_eq!(standard.address(), 7);
        assert!(standard.endpoint(0x81).is_none());
        assert_eq!(send(&mut standard, 2, 3, 0, 0x81), Reply::Stall);
        assert_eq!(send(&mut standard, 0, 9, 2, 0), Reply::Stall);
        assert_eq!(send(&mut standard, 0, 9, 1, 0), done);
        assert_eq!(send(&mut standard, 0x80, 8, 0, 0), Reply::Data(vec![1]));
        assert_eq!(standard.endpoint(0x81).map(|one| one.packet), Some(512));
        assert_eq!(send(&mut standard, 2, 3, 0, 0x81), done);
        assert!(standard.is_halted(0x81) && !standard.is_halted(0x01));
        assert_eq!(
            send(&mut standard, 0x82, 0, 0, 0x81),
            Reply::Data(vec![1, 0])
        );
        assert_eq!(send(&mut standard, 2, 1, 0, 0x81), done);
        assert!(!standard.is_halted(0x81));
        assert_eq!(send(&mut standard, 1, 11, 0, 0), done);
        assert_eq!(send(&mut standard, 1, 11, 1, 0), Reply::Stall);
        assert_eq!(send(&mut standard, 1, 11, 0, 200), Reply::Stall);
        standard.halt(0x81);
        assert_eq!(send(&mut standard, 0, 9, 0, 0), done);
        assert!(!standard.is_halted(0x81) && standard.configuration() == 0);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]
        #[test]
        fn every_request_is_answered_within_its_length(
            requests in prop::collection::vec(any::<(u8, u8, u16, u16, u16)>(), 1..40),
        ) {
            let (mut device, mut standard) = device(Speed::Super);
            for (kind, request, value, index, length) in requests {
                let asked = ask(kind, request % 64, value, index);
                if let Reply::Data(bytes) = standard.control(&mut device, asked, &[], length) {
                    prop_assert!(bytes.len() <= usize::from(length));
                    prop_assert!(asked.is_in() || bytes.is_empty());
                }
            }
        }
    }
}
