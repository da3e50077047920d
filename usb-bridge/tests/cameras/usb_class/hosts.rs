//! Hosts that do anything at all. `PROPTEST_CASES=100000 cargo test -p usb-bridge --test cameras usb_class::` is the
//! long run.

use eecvs_usb_class::{FROM_HOST, PACKET_BYTES, TO_HOST};
use proptest::collection::vec;
use proptest::prelude::*;
use usb_bridge::link::control::Request;
use usb_bridge::peripheral::class_bus::ClassBus;
use usb_bridge::peripheral::{Bulk, Peripheral};

use super::script::{
    SERIAL_FROM_HOST, Script, counts, message, setup_packet, transfers, with_device,
};

/// What a host may do.
#[derive(Debug, Clone)]
enum Act {
    Control(Request, Vec<u8>, usize),
    /// A setup packet, and what comes of it is left.
    Setup([u8; 8]),
    ControlPacket(Vec<u8>),
    ControlAsk,
    Out(u8, Vec<u8>),
    In(u8, usize),
    Packet(u8, Vec<u8>),
    Ask(u8),
    ClearHalt(u8),
    Reset,
    Suspend,
    Resume,
    Message(usize),
    Busy(bool),
    Run,
}

fn requests() -> impl Strategy<Value = Request> {
    // The kinds, requests and values that mean something are as likely as those that do not.
    let kind = prop_oneof![
        any::<u8>(),
        Just(0x80),
        Just(0),
        Just(2),
        Just(1),
        Just(0x81),
        Just(0x82),
        Just(0xC0),
        Just(0x40),
        Just(0xC1),
        Just(0x21),
        Just(0xA1)
    ];
    let request = prop_oneof![any::<u8>(), 0_u8..13, Just(0x20), Just(0x21), Just(0x22)];
    let value = prop_oneof![
        any::<u16>(),
        0_u16..4,
        (1_u16..16).prop_map(|kind| kind << 8)
    ];
    let index = prop_oneof![any::<u16>(), 0_u16..8, 0x80_u16..0x86];
    (kind, request, value, index).prop_map(|(kind, request, value, index)| Request {
        kind,
        request,
        value,
        index,
    })
}

fn acts() -> impl Strategy<Value = Act> {
    let endpoint = || prop_oneof![0_u8..5, 0x80_u8..0x85, any::<u8>()];
    prop_oneof![
        8 => (requests(), vec(any::<u8>(), 0..300), 0_usize..600)
            .prop_map(|(request, data, length)| Act::Control(request, data, length)),
        2 => any::<[u8; 8]>().prop_map(Act::Setup),
        3 => (requests(), 0_u16..300).prop_map(|(request, length)| {
            let [value, index, length] =
                [request.value, request.index, length].map(u16::to_le_bytes);
            Act::Setup([
                request.kind, request.request, value[0], value[1], index[0], index[1], length[0],
                length[1],
            ])
        }),
        2 => vec(any::<u8>(), 0..65).prop_map(Act::ControlPacket),
        2 => Just(Act::ControlAsk),
        3 => (endpoint(), vec(any::<u8>(), 0..300)).prop_map(|(at, data)| Act::Out(at, data)),
        1 => prop_oneof![Just(FROM_HOST), Just(SERIAL_FROM_HOST)]
            .prop_map(|at| Act::Out(at, setup_packet())),
        3 => (endpoint(), 0_usize..2000).prop_map(|(at, room)| Act::In(at, room)),
        2 => (endpoint(), vec(any::<u8>(), 0..70)).prop_map(|(at, data)| Act::Packet(at, data)),
        2 => endpoint().prop_map(Act::Ask),
        1 => endpoint().prop_map(Act::ClearHalt),
        1 => Just(Act::Reset),
        1 => Just(Act::Suspend),
        1 => Just(Act::Resume),
        4 => (0_usize..1500).prop_map(Act::Message),
        1 => any::<bool>().prop_map(Act::Busy),
        2 => Just(Act::Run),
    ]
}

fn act(device: &mut ClassBus<'_, Script>, act: Act) {
    match act {
        Act::Control(request, data, length) => {
            device.control(request, &data, length);
        }
        Act::Setup(setup) => device.wire().setup(setup),
        Act::ControlPacket(packet) => {
            device.wire().give(0, &packet);
        }
        Act::ControlAsk => {
            device.wire().ask(0x80, &mut Vec::new());
        }
        Act::Out(endpoint, data) => {
            device.bulk_out(endpoint, &data);
        }
        Act::In(endpoint, room) => {
            let mut data = Vec::new();
            device.bulk_in(endpoint, room, &mut data);
            assert!(data.len() <= room);
        }
        Act::Packet(endpoint, packet) => {
            device.wire().give(endpoint, &packet);
        }
        Act::Ask(endpoint) => {
            let mut packet = Vec::new();
            device.wire().ask(endpoint, &mut packet);
            assert!(packet.len() <= PACKET_BYTES || endpoint & 0x7F == 0);
        }
        Act::ClearHalt(endpoint) => device.clear_halt(endpoint),
        Act::Reset => device.reset(),
        Act::Suspend => device.wire().suspend_bus(),
        Act::Resume => device.wire().resume_bus(),
        Act::Message(len) => {
            let message = message(len, len as u8);
            device.application().messages.push_back(message);
        }
        Act::Busy(busy) => device.application().busy = busy,
        Act::Run => device.run(),
    }
}

proptest! {
    /// Whatever a host does, the device goes on, its memory is bounded, every byte is accounted for, and
    /// after a reset it is as new.
    #[test]
    fn no_host_disturbs_the_device(host in vec(acts(), 0..60), rude in any::<bool>()) {
        let script = Script { rude, ..Script::default() };
        with_device(script, |device| {
            let mut told = 0;
            for each in host {
                if let Act::Message(len) = each {
                    told += len;
                }
                act(device, each);
                device.run();
                prop_assert!(device.inbox().len() <= 1024);
            }
            device.application().busy = false;
            device.reset();
            transfers(device, TO_HOST, 4096);
            let counts = counts(device);
            prop_assert_eq!(counts.bytes_sent as usize + counts.bytes_dropped as usize, told);
            device.application().received.clear();
            device.application().messages = [message(128, 1)].into();
            prop_assert!(device.bulk_out(FROM_HOST, &[7; 65]));
            prop_assert_eq!(&device.application().received, &vec![7; 65]);
            prop_assert_eq!(transfers(device, TO_HOST, 4096), [message(128, 1)]);
            Ok(())
        })?;
    }

    /// Messages of any length, with a host that reads now and then and in transfers of any size: all
    /// bytes come in order.
    #[test]
    fn messages_arrive_whole(
        lens in vec(1_usize..700, 1..20),
        rooms in vec(1_usize..12, 1..10),
    ) {
        with_device(Script::default(), |device| {
            let messages: Vec<_> = lens.iter().map(|len| message(*len, *len as u8)).collect();
            device.application().messages = messages.clone().into();
            let mut received = Vec::new();
            let mut idle = 0;
            for room in rooms.iter().cycle() {
                let mut data = Vec::new();
                match device.bulk_in(TO_HOST, room * PACKET_BYTES, &mut data) {
                    Bulk::Data => received.extend(data),
                    _ => idle += 1,
                }
                if idle > 3 {
                    break;
                }
            }
            prop_assert_eq!(received, messages.concat());
            Ok(())
        })?;
    }
}
