//! 10,000 seeded faults per model, each followed by a `resume` with the host's time: nothing panics,
//! and from the next word of time on every event is right again.

use std::ops::Range;

use eecvs_nostd::Event;

use crate::scene::{MODELS, Numbers, parser, scene, sensor, sorted_frames, write};

const FAULTS: u64 = 10_000;

/// A multiple of every word.
const TRANSFER: usize = 512;

/// A stream in transfers, and what is in each of them.
struct Clean {
    transfers: Vec<Vec<u8>>,
    events: Vec<Vec<Event>>,
    /// Time at each transfer's end.
    times: Vec<u64>,
}

impl Clean {
    fn new(name: &str, width: u16, height: u16, seed: u64) -> Self {
        let sensor = sensor(width, height);
        let scene = scene(sensor, 12_000, seed);
        let bytes = write(name, sensor, &scene);
        let transfers: Vec<_> = bytes.chunks(TRANSFER).map(<[u8]>::to_vec).collect();
        let mut parser = parser(name, sensor);
        let (mut events, mut times) = (Vec::new(), Vec::new());
        for transfer in &transfers {
            let mut some = Vec::new();
            parser.parse(transfer, &mut some);
            events.push(some);
            times.push(parser.time_us().unwrap_or(0));
        }
        assert_eq!(events.concat(), sorted_frames(name, scene));
        Self {
            transfers,
            events,
            times,
        }
    }

    /// The host's idea of the device's time before transfer `next`: off by less than `off_us`, where no
    /// wrap stands between it and the next word of time.
    fn host_time(&self, next: usize, period_us: u64, off_us: u64, numbers: &mut Numbers) -> u64 {
        let now = self.times[next - 1];
        let later = |event: &&Event| period_us < 1000 << 20 && event.t_us > now;
        match self.events[next].iter().find(later) {
            Some(event) if event.t_us / period_us == now / period_us => {
                (event.t_us + numbers.below(off_us)).saturating_sub(numbers.below(off_us))
            }
            _ => now,
        }
    }
}

/// Feeds transfer `at` with a fault; returns the transfer to go on with.
fn feed(
    kind: u64,
    clean: &Clean,
    at: usize,
    numbers: &mut Numbers,
    feed: &mut dyn FnMut(&[u8]),
) -> usize {
    let mut transfer = clean.transfers[at].clone();
    match kind {
        // Dropped.
        0 => {}
        // Bits flipped.
        1 => {
            for _ in 0..=numbers.below(8) {
                let bit = numbers.below(8 * transfer.len() as u64) as usize;
                transfer[bit / 8] ^= 1 << (bit % 8);
            }
            feed(&transfer);
        }
        // Twice.
        2 => {
            feed(&transfer);
            feed(&transfer);
        }
        // In another order.
        3 => {
            feed(&clean.transfers[at + 1]);
            feed(&transfer);
            return at + 2;
        }
        // Short.
        4 => feed(&transfer[..numbers.below(transfer.len() as u64) as usize]),
        // Without its first bytes.
        5 => feed(&transfer[numbers.below(9) as usize..]),
        // Something else.
        _ => {
            transfer.fill_with(|| numbers.below(256) as u8);
            feed(&transfer);
        }
    }
    at + 1
}

#[test]
fn events_are_right_from_the_next_word_of_time_on() {
    check(17, 0..FAULTS, 900);
}

/// `cargo test --release -p usb-bridge --test inivation -- --ignored`: 20 scenes, 1,400,000 faults.
#[test]
#[ignore = "takes a minute"]
fn events_are_right_after_many_more_faults() {
    for scene in 100..120 {
        check(scene, scene * FAULTS..(scene + 1) * FAULTS, 1);
    }
}

/// `off_us` is how far the host's time may be off. A forged reset and another damaged time right after
/// it look like a true reset, where the host's time is nearer to what they make of it: with a host that
/// is right there is no such case.
fn check(scene: u64, faults: Range<u64>, off_us: u64) {
    for (name, width, height) in MODELS {
        let clean = Clean::new(name, width, height, scene);
        let sensor = sensor(width, height);
        let last = clean.transfers.len() as u64;
        let (period_us, word_us) = match name {
            "dvs128" => (1 << 14, 1),
            "dvxplorer-mipi" => (1000 << 22, 1000),
            _ => (1 << 15, 1),
        };
        let mut missed = 0;
        let mut found = 0;
        for fault in faults.clone() {
            let mut numbers = Numbers::new(fault);
            let at = (2 + numbers.below(last - 6)) as usize;
            let mut parser = parser(name, sensor);
            let mut events = Vec::new();
            parser.resume(Some(clean.host_time(
                at - 1,
                period_us,
                off_us,
                &mut numbers,
            )));
            parser.parse(&clean.transfers[at - 1], &mut events);
            let next = feed(fault % 7, &clean, at, &mut numbers, &mut |bytes| {
                parser.parse(bytes, &mut events);
            });
            parser.resume(Some(clean.host_time(next, period_us, off_us, &mut numbers)));
            assert!(events.iter().all(|event| sensor.contains(event.x, event.y)));
            events.clear();
            for transfer in &clean.transfers[next..next + 2] {
                parser.parse(transfer, &mut events);
            }
            let wanted = clean.events[next..next + 2].concat();
            let lost = wanted.len().checked_sub(events.len());
            let place = || {
                format!(
                    "{name}, fault {fault} at transfer {at}: {:?}",
                    parser.losses()
                )
            };
            let lost = lost.unwrap_or_else(|| panic!("{}", place()));
            assert!(wanted[lost..] == events[..], "{}", place());
            let word = wanted.first().map_or(0, |event| event.t_us / word_us);
            assert!(
                wanted[..lost]
                    .iter()
                    .all(|event| event.t_us / word_us == word),
                "{}: {lost} events were missed",
                place()
            );
            missed += lost;
            found += usize::from(parser.losses().iter().count() > 0);
        }
        println!("{name}: {missed} events missed after {FAULTS} faults, {found} left losses");
        assert!(
            found > FAULTS as usize / 10,
            "{name}: losses are not counted"
        );
    }
}
