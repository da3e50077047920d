//! The link over the real libusb, against a device that libumockdev mocks: enumeration, control
//! requests, the stream, and everything that can go wrong with it.
//!
//! Each test runs twice: once as the device, and once more in a process that sees its USB.

mod umockdev;

use std::time::{Duration, Instant};

use umockdev::usbfs::Fault;
use umockdev::{Mocked, under_umockdev};
use usb_bridge::device::Transfers;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::link::usb::{Attached, Bus, Change, Use, Watch};
use usb_bridge::link::{Link, LinkError, Loss, Received};
use usb_bridge::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

const ENDPOINT: u8 = 0x82;
const START: u8 = 0xB3;
const STOP: u8 = 0xB4;
const NUMBER: u8 = 0xB0;
const LIMIT: u8 = 0xB5;

const TRANSFERS: Transfers = Transfers {
    endpoint: ENDPOINT,
    interface: 0,
    count: 8,
    bytes: 8192,
    timeout: Duration::ZERO,
};

/// Sends the numbers 0, 1, 2, ... as words while it is started, in transfers of changing size, and keeps
/// what it is told.
struct Counter {
    descriptors: Descriptors,
    started: bool,
    next: u32,
    /// It pauses before this number.
    limit: u32,
    turn: usize,
    told: Vec<u8>,
}

impl Counter {
    fn boxed() -> Box<Self> {
        let device = vec![
            18, 1, 0, 2, 0xFF, 0, 0, 64, 0x09, 0x12, 0x02, 0x00, 0x10, 0x04, 1, 2, 3, 1,
        ];
        let mut configuration = vec![9, 2, 0, 0, 1, 1, 0, 0x80, 50];
        configuration.extend([9, 4, 0, 0, 2, 0xFF, 0, 0, 0]);
        configuration.extend([7, 5, ENDPOINT, 2, 0, 2, 0]);
        configuration.extend([7, 5, 0x02, 2, 0, 2, 0]);
        configuration[2] = configuration.len() as u8;
        Box::new(Self {
            descriptors: Descriptors {
                device,
                configuration,
                bos: Vec::new(),
                strings: ["EECVS", "Counter", "C0001"].map(str::to_owned).to_vec(),
                speed: Speed::High,
            },
            started: false,
            next: 0,
            limit: u32::MAX,
            turn: 0,
            told: Vec::new(),
        })
    }
}

impl Peripheral for Counter {
    fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    fn control(&mut self, request: Request, data: &[u8], _length: usize) -> Reply {
        match (request.is_in(), request.request) {
            (false, START) => self.started = true,
            (false, STOP) => self.started = false,
            (false, LIMIT) => {
                self.limit = u32::from_le_bytes(data.try_into().unwrap());
            }
            (true, NUMBER) => return Reply::Data(self.next.to_le_bytes().to_vec()),
            (true, 0x72) => return Reply::Data(self.told.clone()),
            _ => return Reply::Stall,
        }
        Reply::Data(Vec::new())
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> bool {
        self.told.extend(data);
        endpoint == 2
    }

    fn bulk_in(&mut self, endpoint: u8, room: usize, data: &mut Vec<u8>) -> Bulk {
        if endpoint != ENDPOINT || !self.started || self.next >= self.limit {
            return Bulk::Wait;
        }
        self.turn += 1;
        // Full, a word, half, none.
        let words = [room / 4, 1, room / 8, 0][self.turn % 4];
        for _ in 0..words.min((self.limit - self.next) as usize) {
            data.extend(self.next.to_le_bytes());
            self.next += 1;
        }
        Bulk::Data
    }

    fn clear_halt(&mut self, _endpoint: u8) {}

    fn reset(&mut self) {
        self.started = false;
    }
}

/// The device's side: a [`Counter`] as `prepare` leaves it, the test again as its host, and a look at it.
fn mocked(name: &str, prepare: impl FnOnce(&mut Mocked), check: impl FnOnce(&mut Mocked)) {
    if let Some(mut mocked) = Mocked::new(Counter::boxed()) {
        prepare(&mut mocked);
        mocked.run_test(name);
        check(&mut mocked);
    }
}

fn attached() -> Attached {
    let mut all = Bus::new().unwrap().all().unwrap();
    assert_eq!(all.len(), 1);
    all.remove(0)
}

/// Bytes and losses until nothing comes for a while, or the link fails.
struct Got {
    words: Vec<u32>,
    losses: Vec<(usize, Loss)>,
    error: Option<LinkError>,
}

fn receive(link: &mut dyn Link, words: usize) -> Got {
    let mut got = Got {
        words: Vec::new(),
        losses: Vec::new(),
        error: None,
    };
    while got.words.len() < words {
        match link.receive(Duration::from_millis(300)) {
            Ok(Received::Bytes { bytes, at }) => {
                assert!(!bytes.is_empty() && at <= Instant::now());
                let (whole, rest) = bytes.as_chunks::<4>();
                assert!(rest.is_empty());
                got.words
                    .extend(whole.iter().map(|word| u32::from_le_bytes(*word)));
            }
            Ok(Received::Lost { cause, .. }) => got.losses.push((got.words.len(), cause)),
            Ok(Received::Nothing | Received::Ended) => break,
            Err(error) => {
                got.error = Some(error);
                break;
            }
        }
    }
    got
}

fn counts_from_zero(words: &[u32]) {
    assert!(
        words
            .iter()
            .enumerate()
            .all(|(index, &word)| index as u32 == word),
        "out of order"
    );
}

#[test]
fn a_device_is_found_asked_and_told() {
    if !under_umockdev() {
        return mocked("a_device_is_found_asked_and_told", |_| {}, |_| {});
    }
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

    let device = attached.open(0).unwrap();
    let mut control = device.control();
    assert_eq!(control.release(), 0x0410);
    assert_eq!(control.serial().as_deref(), Some("C0001"));
    let mut number = [0xFF; 4];
    let request = Request::vendor_in(NUMBER, 0, 0);
    assert_eq!(control.control_in(request, &mut number).unwrap(), 4);
    assert_eq!(number, [0; 4]);
    control.bulk_out(2, b"!E2\n").unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    link.send(b"E+\n").unwrap();
    let mut told = [0; 16];
    let request = Request::vendor_in(0x72, 0, 0);
    let length = control.control_in(request, &mut told).unwrap();
    assert_eq!(&told[..length], b"!E2\nE+\n");
    let none = Transfers {
        endpoint: 0x81,
        ..TRANSFERS
    };
    assert_eq!(
        device.stream(&none).err().unwrap().to_string(),
        "usb 1-4 1209:0002: has no bulk endpoint 0x81: another model, or another firmware"
    );
    let refused = control.control_out(Request::vendor_out(0x99, 7, 0), &[]);
    assert_eq!(
        refused.unwrap_err().to_string(),
        "usb 1-4 1209:0002: request 0x99 (value 0x0007, index 0x0000): the device refuses it"
    );
}

#[test]
fn every_byte_comes_in_order_and_the_stop_loses_none() {
    if !under_umockdev() {
        return mocked(
            "every_byte_comes_in_order_and_the_stop_loses_none",
            |_| {},
            |mocked| {
                let (most, taken_back) =
                    mocked.with_usbfs(|usbfs| (usbfs.waiting_max, usbfs.discarded));
                assert_eq!(most, TRANSFERS.count);
                // Those that were in flight when the stream was dropped, and no others.
                assert_eq!(taken_back, TRANSFERS.count);
            },
        );
    }
    let device = attached().open(0).unwrap();
    let mut control = device.control();
    let mut link = device.stream(&TRANSFERS).unwrap();
    assert_eq!(link.in_flight(), TRANSFERS.count);
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let mut got = receive(&mut link, 500_000).words;
    control
        .control_out(Request::vendor_out(STOP, 0, 0), &[])
        .unwrap();
    got.extend(receive(&mut link, usize::MAX).words);
    counts_from_zero(&got);
    let mut number = [0; 4];
    control
        .control_in(Request::vendor_in(NUMBER, 0, 0), &mut number)
        .unwrap();
    assert_eq!(got.len(), u32::from_le_bytes(number) as usize);
}

#[test]
fn transfers_are_whole_packets() {
    if !under_umockdev() {
        return mocked("transfers_are_whole_packets", |_| {}, |_| {});
    }
    let device = attached().open(0).unwrap();
    let mut control = device.control();
    let transfers = Transfers {
        bytes: 1000,
        ..TRANSFERS
    };
    let mut link = device.stream(&transfers).unwrap();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let mut longest = 0;
    for _ in 0..10 {
        if let Received::Bytes { bytes, .. } = link.receive(Duration::from_secs(1)).unwrap() {
            longest = longest.max(bytes.len());
        }
    }
    assert_eq!(longest, 1024);
}

#[test]
fn a_pause_hands_over_by_the_oldest_transfer_alone() {
    if !under_umockdev() {
        return mocked(
            "a_pause_hands_over_by_the_oldest_transfer_alone",
            |_| {},
            |mocked| {
                let taken_back = mocked.with_usbfs(|usbfs| usbfs.discarded);
                // One each 20 ms of the pause, and the rest at the end.
                let paused = taken_back - TRANSFERS.count;
                assert!((1..=15).contains(&paused), "{paused}");
            },
        );
    }
    let device = attached().open(0).unwrap();
    let mut control = device.control();
    let transfers = Transfers {
        timeout: Duration::from_millis(20),
        ..TRANSFERS
    };
    let mut link = device.stream(&transfers).unwrap();
    let mut limit = |words: u32| {
        control
            .control_out(Request::vendor_out(LIMIT, 0, 0), &words.to_le_bytes())
            .unwrap();
        control
            .control_out(Request::vendor_out(START, 0, 0), &[])
            .unwrap();
    };
    limit(10_000);
    let mut got = receive(&mut link, 10_000).words;
    assert!(receive(&mut link, 1).words.is_empty());
    limit(20_000);
    got.extend(receive(&mut link, 10_000).words);
    counts_from_zero(&got);
    assert_eq!(got.len(), 20_000);
}

#[test]
fn an_unplugged_device_gives_what_it_sent_and_then_says_so() {
    if !under_umockdev() {
        return mocked(
            "an_unplugged_device_gives_what_it_sent_and_then_says_so",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.unplug_after = Some(100)),
            |_| {},
        );
    }
    let device = attached().open(0).unwrap();
    let mut control = device.control();
    let mut link = device.stream(&TRANSFERS).unwrap();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let got = receive(&mut link, usize::MAX);
    counts_from_zero(&got.words);
    assert_eq!(got.words.len(), 25 * (2048 + 1 + 1024));
    let unplugged = "usb 1-4 1209:0002: unplugged; connect it again and start anew";
    assert_eq!(got.error.unwrap().to_string(), unplugged);
    let again = link.receive(Duration::ZERO).unwrap_err().to_string();
    assert_eq!(again, unplugged);
    let stop = control.control_out(Request::vendor_out(STOP, 0, 0), &[]);
    assert_eq!(stop.unwrap_err().to_string(), unplugged);
}

#[test]
fn a_halt_is_ended_once_and_told() {
    if !under_umockdev() {
        return mocked(
            "a_halt_is_ended_once_and_told",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.faults.push_back(Some(Fault::Stall))),
            |mocked| assert_eq!(mocked.with_usbfs(|usbfs| usbfs.halts_ended), 1),
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let mut control = device.control();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let got = receive(&mut link, 50_000);
    counts_from_zero(&got.words);
    assert_eq!(got.losses, [(0, Loss::Stalled)]);
    assert!(got.error.is_none());
}

#[test]
fn an_endpoint_that_stays_halted_ends_the_stream() {
    if !under_umockdev() {
        return mocked(
            "an_endpoint_that_stays_halted_ends_the_stream",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.faults.push_back(Some(Fault::Stall))),
            |_| {},
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let got = receive(&mut link, usize::MAX);
    // One halt, ended; the device is not started, so nothing follows.
    assert_eq!(got.losses, [(0, Loss::Stalled)]);
    assert!(got.error.is_none());
}

#[test]
fn a_halt_that_comes_again_at_once_is_an_error() {
    if !under_umockdev() {
        return mocked(
            "a_halt_that_comes_again_at_once_is_an_error",
            |mocked| {
                mocked.with_usbfs(|usbfs| usbfs.faults.extend([Some(Fault::Stall); 2]));
            },
            |_| {},
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let got = receive(&mut link, usize::MAX);
    assert_eq!(got.losses, [(0, Loss::Stalled)]);
    assert_eq!(
        got.error.unwrap().to_string(),
        "usb 1-4 1209:0002: endpoint 0x82 is stalled and stays so; reconnect the device"
    );
}

#[test]
fn overflows_and_errors_of_the_wire_are_told_and_too_many_end_it() {
    if !under_umockdev() {
        return mocked(
            "overflows_and_errors_of_the_wire_are_told_and_too_many_end_it",
            |mocked| {
                mocked.with_usbfs(|usbfs| {
                    usbfs
                        .faults
                        .extend([Fault::Overflow, Fault::Wire].map(Some));
                });
            },
            |mocked| {
                mocked.with_usbfs(|usbfs| usbfs.faults.extend([Some(Fault::Wire); 200]));
                mocked.run_test("a_wire_that_fails_on_and_on_is_a_device_that_has_gone");
            },
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let mut control = device.control();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let got = receive(&mut link, 50_000);
    counts_from_zero(&got.words);
    assert_eq!(got.losses, [(0, Loss::Overflow), (0, Loss::Damaged)]);
    assert!(got.error.is_none());
}

#[test]
fn faults_within_a_stream_keep_its_order() {
    // Bytes come between any two of them: a transfer without, as the device has them too, is one of four.
    let script = (0..200usize).map(|turn| match turn % 20 {
        9 => Some([Fault::Stall, Fault::Overflow, Fault::Wire][turn / 20 % 3]),
        _ => None,
    });
    if !under_umockdev() {
        return mocked(
            "faults_within_a_stream_keep_its_order",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.faults.extend(script)),
            |mocked| assert_eq!(mocked.with_usbfs(|usbfs| usbfs.halts_ended), 4),
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let mut control = device.control();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    let got = receive(&mut link, 400_000);
    assert!(got.error.is_none());
    counts_from_zero(&got.words);
    // What the device sends between faults stays between them.
    let sent = |transfers: usize| {
        (1..=transfers)
            .map(|turn| [2048, 1, 1024, 0][turn % 4])
            .sum()
    };
    let told = script
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
}

#[test]
fn a_wire_that_fails_on_and_on_is_a_device_that_has_gone() {
    if !under_umockdev() {
        return;
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    let got = receive(&mut link, usize::MAX);
    assert!(got.losses.len() >= 64, "{}", got.losses.len());
    assert!(matches!(got.error, Some(LinkError::Unplugged { .. })));
}

#[test]
fn a_kernel_without_memory_for_all_transfers_has_fewer_in_flight() {
    if !under_umockdev() {
        return mocked(
            "a_kernel_without_memory_for_all_transfers_has_fewer_in_flight",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.urbs_max = 3),
            |mocked| {
                mocked.with_usbfs(|usbfs| usbfs.urbs_max = 0);
                mocked.run_test("a_kernel_without_memory_for_any_transfer_is_an_error");
            },
        );
    }
    let device = attached().open(0).unwrap();
    let mut link = device.stream(&TRANSFERS).unwrap();
    assert_eq!(link.in_flight(), 3);
    let mut control = device.control();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    counts_from_zero(&receive(&mut link, 50_000).words);
}

#[test]
fn a_kernel_without_memory_for_any_transfer_is_an_error() {
    if !under_umockdev() {
        return;
    }
    let device = attached().open(0).unwrap();
    let told = device.stream(&TRANSFERS).err().unwrap().to_string();
    assert!(told.contains("usbfs_memory_mb"), "{told}");
}

#[test]
fn a_device_in_use_is_left_alone() {
    if !under_umockdev() {
        return mocked(
            "a_device_in_use_is_left_alone",
            |mocked| mocked.with_usbfs(|usbfs| usbfs.taken = true),
            |_| {},
        );
    }
    let attached = attached();
    assert_eq!(Use::of(&attached.try_open(0)), Use::Taken);
    assert_eq!(
        attached.open(0).unwrap_err().to_string(),
        "usb 1-4 1209:0002: in use by another program or driver; stop that one first"
    );
}

#[test]
fn a_device_without_permission_says_which_rule_to_install() {
    let name = "a_device_without_permission_says_which_rule_to_install";
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
    // Root may open everything: another user then, who must be able to run this program.
    let program = std::env::current_exe().unwrap();
    let other = |command: &mut std::process::Command| {
        command.args(["--reuid=65534", "--regid=65534", "--clear-groups"]);
        command.arg(&program).args([name, "--exact", "--nocapture"]);
        command.output()
    };
    let mut command = mocked.command_for("setpriv");
    match other(command.env("EECVS_TEST_UNDER_UMOCKDEV", "1")) {
        Err(error) => eprintln!("skipped: setpriv: {error}"),
        Ok(output) => {
            let told = String::from_utf8_lossy(&output.stderr);
            if told.contains("setpriv: ") {
                eprintln!("skipped: {}", told.trim());
            } else {
                assert!(output.status.success(), "{told}");
                assert!(String::from_utf8_lossy(&output.stdout).contains("1 passed"));
            }
        }
    }
}

#[test]
fn streams_are_dropped_at_any_moment() {
    if !under_umockdev() {
        return mocked("streams_are_dropped_at_any_moment", |_| {}, |_| {});
    }
    let device = attached().open(0).unwrap();
    let mut control = device.control();
    control
        .control_out(Request::vendor_out(START, 0, 0), &[])
        .unwrap();
    for round in 0..20 {
        let mut link = device.stream(&TRANSFERS).unwrap();
        for _ in 0..round {
            let received = link.receive(Duration::from_millis(300)).unwrap();
            assert!(matches!(received, Received::Bytes { .. }));
        }
        if round % 2 == 0 {
            control
                .control_in(Request::vendor_in(NUMBER, 0, 0), &mut [0; 4])
                .unwrap();
        }
    }
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
            .args(["removals_are_told", "--exact", "--nocapture"])
            .env("EECVS_TEST_UNDER_UMOCKDEV", "1")
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines =
            std::io::BufRead::lines(std::io::BufReader::new(host.stdout.take().unwrap()));
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
