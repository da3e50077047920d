//! Devices as they are found, named, asked and refused.

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::time::Duration;

use usb_bridge::device::Transfers;
use usb_bridge::link::Link;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::link::usb::{Change, Use, Watch};

use crate::counter::{Counter, Host, TRANSFERS, attached, both};
use crate::umockdev::{Mocked, UNDER, under_umockdev};

#[test]
fn a_device_is_found_asked_and_told() {
    both(
        |_| {},
        || {
            let attached = attached();
            assert_eq!(attached.id(), "usb:1-4");
            assert_eq!((attached.bus, attached.address), (1, 7));
            assert_eq!((attached.vendor, attached.product), (0x1209, 0x0002));
            assert_eq!(attached.release, 0x0410);
            assert_eq!(attached.product_name.as_deref(), Some("Counter"));
            assert_eq!(attached.serial.as_deref(), Some("C0001"));
            let told = attached.require_super_speed().unwrap_err().to_string();
            assert!(
                told.contains("is connected at 480 Mbit/s; it needs USB 3"),
                "{told}"
            );
            assert_eq!(Use::of(&attached.try_open(0)), Use::Free);

            let mut host = Host::open();
            assert_eq!(host.control.release(), 0x0410);
            assert_eq!(host.control.serial().as_deref(), Some("C0001"));
            assert_eq!(host.next(), 0);
            host.control.bulk_out(2, b"!E2\n").unwrap();
            host.link.send(b"E+\n").unwrap();
            let mut told = [0; 16];
            let request = Request::vendor_in(0x72, 0, 0);
            let length = host.control.control_in(request, &mut told).unwrap();
            assert_eq!(&told[..length], b"!E2\nE+\n");
            let none = Transfers {
                endpoint: 0x81,
                ..TRANSFERS
            };
            assert_eq!(
                host.device.stream(&none).err().unwrap().to_string(),
                "usb 1-4 1209:0002: has no bulk endpoint 0x81: it is another model, or has other firmware"
            );
            let refused = host
                .control
                .control_out(Request::vendor_out(0x99, 7, 0), &[]);
            assert_eq!(
                refused.unwrap_err().to_string(),
                "usb 1-4 1209:0002: request 0x99 (value 0x0007, index 0x0000): the device refused it"
            );
        },
        |_| {},
    );
}

#[test]
fn a_device_in_use_is_left_alone() {
    both(
        |usbfs| usbfs.taken = true,
        || {
            let attached = attached();
            assert_eq!(Use::of(&attached.try_open(0)), Use::Taken);
            assert_eq!(
                attached.open(0).unwrap_err().to_string(),
                "usb 1-4 1209:0002: in use by another program or driver; stop that one first"
            );
        },
        |_| {},
    );
}

#[test]
fn a_device_without_permission_says_which_rule_to_install() {
    let name = "attached::a_device_without_permission_says_which_rule_to_install";
    if under_umockdev() {
        let attached = attached();
        assert_eq!(attached.serial.as_deref(), Some("C0001"));
        assert_eq!(Use::of(&attached.try_open(0)), Use::Forbidden);
        let told = attached.open(0).unwrap_err().to_string();
        assert!(
            told.contains(
                "SUBSYSTEM==\"usb\", ATTR{idVendor}==\"1209\", ATTR{idProduct}==\"0002\""
            ),
            "{told}"
        );
        return;
    }
    let Some(mocked) = Mocked::new(Counter::boxed()) else {
        return;
    };
    mocked.forbid();
    let mut command = mocked.command_for_nobody(std::env::current_exe().unwrap());
    command
        .args([name, "--exact", "--nocapture"])
        .env(UNDER, "1");
    let Some(output) = crate::umockdev::output_of_nobody(&mut command) else {
        return;
    };
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("1 passed"));
}

#[test]
fn removals_are_told() {
    if !under_umockdev() {
        // Without a daemon of udev the mocked USB tells nobody: the list is compared.
        let Some(mut mocked) = Mocked::new(Counter::boxed()) else {
            return;
        };
        let mut host = mocked
            .command_for(std::env::current_exe().unwrap())
            .args(["attached::removals_are_told", "--exact", "--nocapture"])
            .env(UNDER, "1")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(host.stdout.take().unwrap()).lines();
        assert!(lines.any(|line| line.unwrap().contains("arrived usb:1-4")));
        mocked.unplug();
        assert!(lines.any(|line| line.unwrap().contains("left usb:1-4")));
        assert!(host.wait().unwrap().success());
        return;
    }
    // The kernel's announcements have no way through the mock; what is there already is told.
    let mut told = Watch::new().unwrap();
    let change = told.next(Duration::from_secs(5)).unwrap();
    assert!(matches!(change, Some(Change::Arrived(attached)) if attached.id() == "usb:1-4"));
    assert!(told.next(Duration::from_millis(10)).unwrap().is_none());
    drop(told);
    let mut watch = Watch::polling();
    let change = watch.next(Duration::from_secs(5)).unwrap();
    let Some(Change::Arrived(attached)) = change else {
        panic!("nothing arrived");
    };
    println!("\narrived {}", attached.id());
    let change = watch.next(Duration::from_secs(10)).unwrap();
    let Some(Change::Left { id }) = change else {
        panic!("nothing left");
    };
    println!("\nleft {id}");
    assert!(watch.next(Duration::from_millis(10)).unwrap().is_none());
}

#[test]
fn list_names_no_device_that_it_does_not_know() {
    let Some(mocked) = Mocked::new(Counter::boxed()) else {
        return;
    };
    let mut command = mocked.command_for(env!("CARGO_BIN_EXE_eecvs-usb"));
    let output = command.arg("list").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert_eq!(output.stdout, b"No known camera or MCU is attached.\n");
}
