//! A device that counts, and both sides of a test with it.

use std::any::type_name;
use std::time::{Duration, Instant};

use usb_bridge::device::Transfers;
use usb_bridge::link::control::{Control, Request};
use usb_bridge::link::usb::{Attached, Bus, Device, UsbControl, UsbLink};
use usb_bridge::link::{Link, LinkError, Loss, Received};
use usb_bridge::peripheral::{Bulk, Descriptors, Peripheral, Reply, Speed};

use crate::umockdev::{Mocked, under_umockdev};
use usb_bridge::peripheral::usbfs::kernel::Usbfs;

pub const ENDPOINT: u8 = 0x82;
pub const START: u8 = 0xB3;
pub const STOP: u8 = 0xB4;
pub const NUMBER: u8 = 0xB0;
pub const LIMIT: u8 = 0xB5;

pub const TRANSFERS: Transfers = Transfers {
    endpoint: ENDPOINT,
    interface: 0,
    count: 8,
    bytes: 8192,
    timeout: Duration::ZERO,
};

/// Sends the numbers 0, 1, 2, ... as words while it is started, in transfers of changing size, and keeps
/// what it is told.
pub struct Counter {
    descriptors: Descriptors,
    started: bool,
    next: u32,
    /// It pauses before this number.
    limit: u32,
    turn: usize,
    told: Vec<u8>,
}

impl Counter {
    pub fn boxed() -> Box<Self> {
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

/// A test's both sides: a [`Counter`] behind a usbfs as `prepare` leaves it, the same test again as its
/// `host`, in a process that sees it, and a look at it afterwards.
pub fn both<H: FnOnce()>(
    prepare: impl FnOnce(&mut Usbfs),
    host: H,
    check: impl FnOnce(&mut Mocked),
) {
    if under_umockdev() {
        return host();
    }
    if let Some(mut mocked) = Mocked::new(Counter::boxed()) {
        mocked.with_usbfs(prepare);
        mocked.run_test(test_of::<H>());
        check(&mut mocked);
    }
}

/// Name of the test that a closure stands in.
pub fn test_of<H>() -> &'static str {
    let closure = type_name::<H>();
    let name = closure.strip_suffix("::{{closure}}").unwrap_or(closure);
    name.split_once("::").map_or(name, |(_program, test)| test)
}

/// The only device on the mocked USB.
pub fn attached() -> Attached {
    let mut all = Bus::new().unwrap().all().unwrap();
    assert_eq!(all.len(), 1);
    all.remove(0)
}

/// The counter, opened, with transfers in flight.
pub struct Host {
    pub link: UsbLink,
    pub control: UsbControl,
    pub device: Device,
}

impl Host {
    pub fn open() -> Self {
        Self::with(&TRANSFERS)
    }

    pub fn with(transfers: &Transfers) -> Self {
        let device = attached().open(0).unwrap();
        Self {
            link: device.stream(transfers).unwrap(),
            control: device.control(),
            device,
        }
    }

    pub fn started() -> Self {
        let mut host = Self::open();
        host.tell(START, &[]).unwrap();
        host
    }

    pub fn tell(&mut self, request: u8, data: &[u8]) -> Result<(), LinkError> {
        self.control
            .control_out(Request::vendor_out(request, 0, 0), data)
    }

    /// The number that it sends next.
    pub fn next(&mut self) -> u32 {
        let mut number = [0; 4];
        let request = Request::vendor_in(NUMBER, 0, 0);
        self.control.control_in(request, &mut number).unwrap();
        u32::from_le_bytes(number)
    }

    pub fn receive(&mut self, words: usize) -> Got {
        receive(&mut self.link, words)
    }
}

/// Bytes and losses until nothing comes for a while, or the link fails.
pub struct Got {
    pub words: Vec<u32>,
    pub losses: Vec<(usize, Loss)>,
    pub error: Option<LinkError>,
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

pub fn counts_from_zero(words: &[u32]) {
    assert!(
        words
            .iter()
            .enumerate()
            .all(|(index, &word)| index as u32 == word),
        "out of order"
    );
}
