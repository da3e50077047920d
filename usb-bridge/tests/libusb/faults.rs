//! What goes wrong on the wire and with the device.

use std::time::Duration;

use usb_bridge::link::{Link, LinkError, Loss};

use crate::counter::{Host, STOP, both, counts_from_zero};
use usb_bridge::peripheral::usbfs::kernel::Fault;

#[test]
fn an_unplugged_device_gives_what_it_sent_and_then_says_so() {
    both(
        |usbfs| usbfs.unplug_after = Some(100),
        || {
            let mut host = Host::started();
            let got = host.receive(usize::MAX);
            counts_from_zero(&got.words);
            assert_eq!(got.words.len(), 25 * (2048 + 1 + 1024));
            let unplugged = "usb 1-4 1209:0002: unplugged; connect it again and rerun the command";
            assert_eq!(got.error.unwrap().to_string(), unplugged);
            let again = host.link.receive(Duration::ZERO).unwrap_err().to_string();
            assert_eq!(again, unplugged);
            let stop = host.tell(STOP, &[]);
            assert_eq!(stop.unwrap_err().to_string(), unplugged);
        },
        |_| {},
    );
}

#[test]
fn a_halt_is_ended_once_and_told() {
    both(
        |usbfs| usbfs.faults.push_back(Some(Fault::Stall)),
        || {
            let got = Host::started().receive(50_000);
            counts_from_zero(&got.words);
            assert_eq!(got.losses, [(0, Loss::Stalled)]);
            assert!(got.error.is_none());
        },
        |mocked| assert_eq!(mocked.with_usbfs(|usbfs| usbfs.halts_ended), 1),
    );
}

#[test]
fn a_halt_of_a_silent_device_is_ended_too() {
    both(
        |usbfs| usbfs.faults.push_back(Some(Fault::Stall)),
        || {
            let got = Host::open().receive(usize::MAX);
            // One halt, ended; the device is not started, so nothing follows.
            assert_eq!(got.losses, [(0, Loss::Stalled)]);
            assert!(got.error.is_none());
        },
        |_| {},
    );
}

#[test]
fn a_halt_that_comes_again_at_once_is_an_error() {
    both(
        |usbfs| usbfs.faults.extend([Some(Fault::Stall); 2]),
        || {
            let got = Host::open().receive(usize::MAX);
            assert_eq!(got.losses, [(0, Loss::Stalled)]);
            assert_eq!(
                got.error.unwrap().to_string(),
                "usb 1-4 1209:0002: endpoint 0x82 remains stalled; reconnect the device"
            );
        },
        |_| {},
    );
}

#[test]
fn overflows_and_errors_of_the_wire_are_told() {
    both(
        |usbfs| {
            let faults = [Fault::Overflow, Fault::Wire].map(Some);
            usbfs.faults.extend(faults);
        },
        || {
            let got = Host::started().receive(50_000);
            counts_from_zero(&got.words);
            assert_eq!(got.losses, [(0, Loss::Overflow), (0, Loss::Damaged)]);
            assert!(got.error.is_none());
        },
        |_| {},
    );
}

#[test]
fn a_wire_that_fails_on_and_on_is_a_device_that_has_gone() {
    both(
        |usbfs| usbfs.faults.extend([Some(Fault::Wire); 200]),
        || {
            let got = Host::open().receive(usize::MAX);
            assert!(got.losses.len() >= 64, "{}", got.losses.len());
            assert!(matches!(got.error, Some(LinkError::Unplugged { .. })));
        },
        |_| {},
    );
}

#[test]
fn faults_within_a_stream_keep_its_order() {
    // Bytes come between any two of them: a transfer without, as the device has them too, is one of four.
    let script = (0..200usize).map(|turn| match turn % 20 {
        9 => Some([Fault::Stall, Fault::Overflow, Fault::Wire][turn / 20 % 3]),
        _ => None,
    });
    let told = script.clone();
    both(
        |usbfs| usbfs.faults.extend(script),
        || {
            let got = Host::started().receive(400_000);
            assert!(got.error.is_none());
            counts_from_zero(&got.words);
            // What the device sends between faults stays between them.
            let sent = |transfers: usize| {
                (1..=transfers)
                    .map(|turn| [2048, 1, 1024, 0][turn % 4])
                    .sum()
            };
            let told = told
                .scan(0, |passed, fault| {
                    *passed += usize::from(fault.is_none());
                    Some((sent(*passed), fault))
                })
                .filter_map(|(at, fault)| match fault? {
                    Fault::Stall => Some((at, Loss::Stalled)),
                    Fault::Overflow => Some((at, Loss::Overflow)),
                    Fault::Wire => Some((at, Loss::Damaged)),
                });
            assert_eq!(got.losses, told.collect::<Vec<_>>());
        },
        |mocked| assert_eq!(mocked.with_usbfs(|usbfs| usbfs.halts_ended), 4),
    );
}
