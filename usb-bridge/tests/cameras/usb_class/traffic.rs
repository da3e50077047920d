//! Messages, packets and requests, one case each.

use eecvs_usb_class::{COUNTS, DESCRIPTORS, FROM_HOST, RESTART, TO_HOST};
use usb_bridge::link::control::Request;
use usb_bridge::peripheral::wire::Handshake;
use usb_bridge::peripheral::{Bulk, Peripheral, Reply};

use super::script::{
    SERIAL_FROM_HOST, SERIAL_TO_HOST, Script, counts, message, setup_packet, transfers, with_device,
};

#[test]
fn a_message_is_a_transfer_and_ends_with_a_short_packet() {
    with_device(Script::default(), |device| {
        let lens = [1, 63, 64, 65, 127, 128, 192, 700, 64, 64, 1];
        let messages: Vec<_> = lens.map(|len| message(len, len as u8)).into();
        device.application().messages = messages.clone().into();
        assert_eq!(transfers(device, TO_HOST, 16384), messages);
        let counts = counts(device);
        assert_eq!(counts.messages_sent as usize, lens.len());
        assert_eq!(counts.bytes_sent as usize, lens.iter().sum::<usize>());
        assert_eq!((counts.messages_dropped, counts.bytes_dropped), (0, 0));

        // Packet by packet, as the wire has them.
        device.application().messages = [message(128, 1), message(5, 2)].into();
        device.run();
        let mut packets = Vec::new();
        loop {
            let mut packet = Vec::new();
            if device.wire().ask(TO_HOST, &mut packet) == Handshake::Nak {
                break;
            }
            packets.push(packet.len());
            device.run();
        }
        assert_eq!(packets, [64, 64, 0, 5]);
    });
}

#[test]
fn packets_from_the_host_arrive_in_any_cut() {
    with_device(Script::default(), |device| {
        let sent = message(5000, 9);
        for cut in [1, 63, 64, 65, 512, 5000] {
            for part in sent.chunks(cut) {
                assert!(device.bulk_out(FROM_HOST, part));
            }
            assert_eq!(
                std::mem::take(&mut device.application().received),
                sent,
                "{cut}"
            );
        }
        assert_eq!(counts(device).bytes_received, 6 * 5000);
        assert!(!device.bulk_out(0x03, &[1]) && !device.bulk_out(TO_HOST, &[1]));
    });
}

#[test]
fn a_busy_encoder_holds_the_host_and_loses_nothing() {
    let script = Script {
        busy: true,
        ..Script::default()
    };
    with_device(script, |device| {
        let sent = message(4000, 3);
        assert!(device.bulk_out(FROM_HOST, &sent));
        assert_eq!(device.inbox().len(), 1024);
        // Requests are answered all the same.
        assert_eq!(counts(device).bytes_received, 1024);
        device.application().busy = false;
        device.bulk_in(TO_HOST, 64, &mut Vec::new());
        assert_eq!(device.application().received, sent);
        assert_eq!(device.bytes_refused(), 0);
    });
}

#[test]
fn a_host_that_stops_reading_costs_counted_messages_and_no_time() {
    let script = Script {
        rude: true,
        ..Script::default()
    };
    with_device(script, |device| {
        let messages: Vec<_> = (0..200).map(|seed| message(100, seed)).collect();
        device.application().messages = messages.clone().into();
        device.run();
        let (sent, refused) = (device.application().sent, device.application().refused);
        assert_eq!(sent + refused, 200);
        assert!(refused > 160, "{refused}");
        let before = counts(device);
        assert_eq!(before.messages_dropped as usize, refused);
        // It reads again: what was queued comes, the first messages whole.
        let received = transfers(device, TO_HOST, 16384);
        assert_eq!(received[..30], messages[..30]);
        let after = counts(device);
        let bytes: usize = received.iter().map(Vec::len).sum();
        assert_eq!(after.bytes_sent as usize, bytes);
        assert_eq!(after.bytes_sent + after.bytes_dropped, 200 * 100);
    });
}

#[test]
fn a_reset_in_the_middle_of_a_message_begins_anew() {
    with_device(Script::default(), |device| {
        for way in 0..3 {
            let restarts = device.application().restarts;
            let before = counts(device);
            device.application().messages = [message(600, 1), message(100, 2)].into();
            device.run();
            let mut first = Vec::new();
            assert_eq!(device.wire().ask(TO_HOST, &mut first), Handshake::Ack);
            assert_eq!(first, message(600, 1)[..64]);
            device.run();
            match way {
                0 => device.reset(),
                1 => {
                    let restart = Request::vendor_out(RESTART, 0, 0);
                    assert_eq!(device.control(restart, &[], 0), Reply::Data(Vec::new()));
                }
                _ => {
                    let configure = Request {
                        kind: 0,
                        request: 9,
                        value: 1,
                        index: 0,
                    };
                    assert_eq!(device.control(configure, &[], 0), Reply::Data(Vec::new()));
                    let mut renumbered = std::mem::take(&mut device.inbox().renumbered);
                    renumbered.sort_unstable();
                    assert!(
                        [1, 2, 0x81, 0x82, 0x83]
                            .iter()
                            .all(|at| renumbered.contains(at))
                    );
                }
            }
            assert!(device.application().restarts > restarts);
            device.application().messages.push_back(message(70, 3));
            let received = transfers(device, TO_HOST, 16384);
            // Without a reset the packet that the controller had is still there.
            let last = received.last().unwrap();
            assert!(last.ends_with(&message(70, 3)), "{way}");
            assert_eq!(received.len(), 1);
            assert_eq!(last.len(), if way == 0 { 70 } else { 64 + 70 }, "{way}");
            let after = counts(device);
            let dropped = after.bytes_dropped - before.bytes_dropped;
            let sent = after.bytes_sent - before.bytes_sent;
            assert_eq!(sent + dropped, 600 + 100 + 70, "{way}");
            assert_eq!(after.messages_dropped - before.messages_dropped, 2);
            assert_eq!(after.messages_sent - before.messages_sent, 1);
        }
    });
}

#[test]
fn a_setup_gives_the_encoder_to_the_function_it_comes_on() {
    with_device(Script::default(), |device| {
        assert!(device.bulk_out(FROM_HOST, &[1, 2, 3]));
        // A modem manager knocks.
        assert!(device.bulk_out(SERIAL_FROM_HOST, b"AT\r\n"));
        assert_eq!(device.application().received, [1, 2, 3]);
        let counts_before = counts(device);
        assert_eq!(
            (counts_before.bytes_refused, counts_before.packets_refused),
            (4, 1)
        );
        assert!(!counts_before.serial);

        let setup = setup_packet();
        assert!(device.bulk_out(SERIAL_FROM_HOST, &setup));
        assert!(device.application().received.ends_with(&setup));
        assert!(counts(device).serial);
        device.application().messages = [message(64, 4)].into();
        assert_eq!(transfers(device, TO_HOST, 512), Vec::<Vec<u8>>::new());
        assert_eq!(transfers(device, SERIAL_TO_HOST, 512), [message(64, 4)]);

        // And back.
        assert!(device.bulk_out(FROM_HOST, &[9; 70]));
        assert!(device.bulk_out(FROM_HOST, &setup));
        assert!(!counts(device).serial);
        assert_eq!(counts(device).packets_refused, 3);
        device.application().messages = [message(65, 5)].into();
        assert_eq!(transfers(device, TO_HOST, 512), [message(65, 5)]);
    });
}

#[test]
fn the_serial_port_keeps_its_line_coding() {
    with_device(Script::default(), |device| {
        let class = |kind, request| Request {
            kind,
            request,
            value: 0,
            index: 1,
        };
        let coding = [0x00, 0xC2, 0x01, 0x00, 0, 0, 8];
        let reply = device.control(class(0x21, 0x20), &coding, 0);
        assert_eq!(reply, Reply::Data(Vec::new()));
        let reply = device.control(class(0xA1, 0x21), &[], 7);
        assert_eq!(reply, Reply::Data(coding.to_vec()));
    });
}

#[test]
fn unknown_requests_are_stalled_and_known_ones_go_on() {
    with_device(Script::default(), |device| {
        let unknown = [
            Request::vendor_in(0x55, 0, 0),
            Request::vendor_in(RESTART, 0, 0),
            Request::vendor_in(DESCRIPTORS, 0, 4),
            Request::vendor_in(DESCRIPTORS, 0, 5),
            Request::vendor_out(0x55, 0, 0),
            Request::vendor_out(COUNTS, 0, 0),
            // To an interface of the other function.
            Request {
                kind: 0xC1,
                request: COUNTS,
                value: 0,
                index: 1,
            },
            // A descriptor that is not there.
            Request {
                kind: 0x80,
                request: 6,
                value: 0x0A00,
                index: 0,
            },
            Request {
                kind: 0,
                request: 9,
                value: 2,
                index: 0,
            },
        ];
        for request in unknown {
            assert_eq!(
                device.control(request, &[], 64),
                Reply::Stall,
                "{request:?}"
            );
            counts(device);
        }
        let restart = Request::vendor_out(RESTART, 0, 0);
        assert_eq!(device.control(restart, &[1], 0), Reply::Stall);
        // To the vendor's own interface.
        let request = Request {
            kind: 0xC1,
            request: COUNTS,
            value: 0,
            index: 0,
        };
        assert!(matches!(device.control(request, &[], 64), Reply::Data(data) if data.len() == 40));
    });
}

#[test]
fn transfers_that_send_too_much_end_with_a_stall() {
    with_device(Script::default(), |device| {
        let before = counts(device).controls_refused;
        for len in [257, 300, 4096, 65535, 65536] {
            let request = Request::vendor_out(RESTART, 0, 0);
            assert_eq!(
                device.control(request, &vec![0; len], 0),
                Reply::Stall,
                "{len}"
            );
            // Nothing is stuck.
            counts(device);
            assert!(device.bulk_out(FROM_HOST, &[1, 2, 3]));
        }
        assert_eq!(device.application().received, [1, 2, 3].repeat(5));
        assert_eq!(counts(device).controls_refused - before, 4);
    });
}

#[test]
fn an_answer_that_is_left_in_its_middle_does_not_mix_with_the_next() {
    with_device(Script::default(), |device| {
        let configuration = device.descriptors().configuration.clone();
        for packets in 0..3 {
            let [low, high] = 178_u16.to_le_bytes();
            device
                .wire()
                .setup([0xC0, DESCRIPTORS, 0, 0, 7, 0, low, high]);
            device.run();
            for _ in 0..packets {
                device.wire().ask(0x80, &mut Vec::new());
                device.run();
            }
            let request = Request {
                kind: 0x80,
                request: 6,
                value: 0x0200,
                index: 0,
            };
            let reply = device.control(request, &[], 1024);
            assert_eq!(reply, Reply::Data(configuration.clone()), "{packets}");
        }
    });
}

#[test]
fn a_halt_ends_with_the_hosts_request() {
    with_device(Script::default(), |device| {
        let halt = |request, index| Request {
            kind: 2,
            request,
            value: 0,
            index,
        };
        device.control(halt(3, u16::from(TO_HOST)), &[], 0);
        let mut data = Vec::new();
        assert_eq!(device.bulk_in(TO_HOST, 64, &mut data), Bulk::Stall);
        device.clear_halt(TO_HOST);
        assert_eq!(device.inbox().renumbered.last(), Some(&TO_HOST));
        device.application().messages = [message(3, 0)].into();
        assert_eq!(transfers(device, TO_HOST, 64), [message(3, 0)]);
    });
}

#[test]
fn a_sleeping_bus_keeps_what_waits() {
    with_device(Script::default(), |device| {
        device.wire().suspend_bus();
        device.run();
        device.application().messages = [message(100, 8)].into();
        device.run();
        device.wire().resume_bus();
        assert_eq!(transfers(device, TO_HOST, 512), [message(100, 8)]);
    });
}
