//! The stream while nothing is wrong with it.

use std::time::Duration;

use usb_bridge::device::Transfers;
use usb_bridge::link::{Link, Received};

use crate::counter::{Host, LIMIT, START, STOP, TRANSFERS, both, counts_from_zero};

#[test]
fn every_byte_comes_in_order_and_the_stop_loses_none() {
    both(
        |_| {},
        || {
            let mut host = Host::open();
            assert_eq!(host.link.in_flight(), TRANSFERS.count);
            host.tell(START, &[]).unwrap();
            let mut got = host.receive(500_000).words;
            host.tell(STOP, &[]).unwrap();
            got.extend(host.receive(usize::MAX).words);
            counts_from_zero(&got);
            assert_eq!(got.len(), host.next() as usize);
        },
        |mocked| {
            let (most, taken_back) =
                mocked.with_usbfs(|usbfs| (usbfs.waiting_max, usbfs.discarded));
            assert_eq!(most, TRANSFERS.count);
            // Those that were in flight when the stream was dropped, and no others.
            assert_eq!(taken_back, TRANSFERS.count);
        },
    );
}

#[test]
fn transfers_are_whole_packets() {
    both(
        |_| {},
        || {
            let mut host = Host::with(&Transfers {
                bytes: 1000,
                ..TRANSFERS
            });
            host.tell(START, &[]).unwrap();
            let mut longest = 0;
            for _ in 0..10 {
                let received = host.link.receive(Duration::from_secs(1)).unwrap();
                if let Received::Bytes { bytes, .. } = received {
                    longest = longest.max(bytes.len());
                }
            }
            assert_eq!(longest, 1024);
        },
        |_| {},
    );
}

#[test]
fn a_pause_hands_over_by_the_oldest_transfer_alone() {
    both(
        |_| {},
        || {
            let mut host = Host::with(&Transfers {
                timeout: Duration::from_millis(20),
                ..TRANSFERS
            });
            host.tell(LIMIT, &10_000u32.to_le_bytes()).unwrap();
            host.tell(START, &[]).unwrap();
            let mut got = host.receive(10_000).words;
            assert!(host.receive(1).words.is_empty());
            host.tell(LIMIT, &20_000u32.to_le_bytes()).unwrap();
            got.extend(host.receive(10_000).words);
            counts_from_zero(&got);
            assert_eq!(got.len(), 20_000);
        },
        |mocked| {
            let taken_back = mocked.with_usbfs(|usbfs| usbfs.discarded);
            // One each 20 ms of the pause, and the rest at the end.
            let paused = taken_back - TRANSFERS.count;
            assert!((1..=15).contains(&paused), "{paused}");
        },
    );
}

#[test]
fn streams_are_dropped_at_any_moment() {
    both(
        |_| {},
        || {
            let Host {
                link,
                mut control,
                device,
            } = Host::started();
            drop(link);
            for round in 0..20 {
                let mut host = Host {
                    link: device.stream(&TRANSFERS).unwrap(),
                    control,
                    device: device.clone(),
                };
                for _ in 0..round {
                    let received = host.link.receive(Duration::from_millis(300)).unwrap();
                    assert!(matches!(received, Received::Bytes { .. }));
                }
                if round % 2 == 0 {
                    host.next();
                }
                control = host.control;
            }
        },
        |_| {},
    );
}

#[test]
fn a_kernel_without_memory_for_all_transfers_has_fewer_in_flight() {
    both(
        |usbfs| usbfs.urbs_max = 3,
        || {
            let mut host = Host::started();
            assert_eq!(host.link.in_flight(), 3);
            counts_from_zero(&host.receive(50_000).words);
        },
        |_| {},
    );
}

#[test]
fn a_kernel_without_memory_for_any_transfer_is_an_error() {
    both(
        |usbfs| usbfs.urbs_max = 0,
        || {
            let device = crate::counter::attached().open(0).unwrap();
            let told = device.stream(&TRANSFERS).err().unwrap().to_string();
            assert!(told.contains("usbfs_memory_mb"), "{told}");
        },
        |_| {},
    );
}
