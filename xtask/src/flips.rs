//! Faults of the microcontroller itself: bits flipped in its memory and its registers, peripherals that stop, a stack that
//! leaves its place. What becomes of the sensor's events, and does the board come back?

use std::path::Path;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use eecvs_bench::marks::Marks;
use event_types::stream::Result as HostResult;
use mcu_link::debugger::Debugger;
use mcu_link::image;
use mcu_link::sensor::{Disturbed, End, Scene};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, elf};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::sensor::{self, Board, MACHINE};
use crate::tree;

const MARKS: Marks = Marks {
    name: "flips",
    command: "cargo xtask flips --save",
};
const DOCUMENT: &str = "docs/boards.md";
const RECORD: &str = "firmware/flips.json";
/// Number of faults after which the record is saved.
const SAVE_FAULTS: u64 = 100;

/// Number of faults unless another is given.
pub const FAULTS: u64 = 10_000;
/// Events of the scene, and per microsecond.
const EVENTS: usize = 60_000;
const RATE: f64 = 4.0;
/// Longer than the watchdog's half a second of the machine's time takes to emulate.
const PATIENCE: Duration = Duration::from_secs(40);
/// Registers r0 to pc, and the processor's status.
const REGISTERS: [u8; 17] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 25];
const STACK_POINTER: u8 = 13;
/// What stops: address, value, name.
const PERIPHERALS: [(u32, u32, &str); 4] = [
    (0x4000_0000, 0, "the sensor's transfer"),
    (0xe000_e010, 0, "the timer"),
    // Its mask of interrupt 8.
    (0xe000_e180, 1 << 8, "the transfer's interrupt"),
    (0xe000_ed08, 0x2000_2800, "the vector table"),
];

/// Where a fault is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Place {
    /// Blocks, windows and the frame: events before their checksum is made.
    Events,
    /// All other variables.
    Variables,
    Stack,
    Register,
    StackPointer,
    Peripheral,
}

impl Place {
    /// With how many of a hundred faults each.
    const ALL: [(Self, u64, &'static str); 6] = [
        (Self::Events, 25, "a bit of the memory of events"),
        (Self::Variables, 25, "a bit of another variable"),
        (Self::Stack, 15, "a bit of the stack"),
        (Self::Register, 30, "a bit of a register"),
        (Self::StackPointer, 2, "a stack that leaves its place"),
        (Self::Peripheral, 3, "a peripheral that stops"),
    ];
}

/// Addresses of memory, from the image.
struct Memory {
    events: Vec<(u32, u32)>,
    variables: Vec<(u32, u32)>,
    stack: (u32, u32),
    /// The end of the machine's memory, far from the image's.
    scratch: u32,
}

impl Memory {
    fn read(image: &Path) -> Result<Self> {
        let bytes = std::fs::read(image)?;
        let file = object::File::parse(&*bytes)?;
        let mut events = Vec::new();
        for symbol in file.symbols() {
            let name = symbol.name().unwrap_or_default();
            // The memory that a setup divides, and the blocks, the largest of what `sensor::start` makes.
            let is_blocks = name.contains("6sensor5start") && symbol.size() > 4096;
            if name.contains("6memory6MEMORY") || is_blocks {
                events.push((symbol.address() as u32, symbol.size() as u32));
            }
        }
        // What stands for the sensor and the world around it.
        let simulated: Vec<_> = file
            .symbols()
            .filter(|symbol| symbol.name().is_ok_and(|name| name.contains("9simulated")))
            .map(|symbol| (symbol.address() as u32, symbol.size() as u32))
            .collect();
        ensure!(
            events.len() == 2,
            "the image has other variables: {events:?}"
        );
        let mut variables = Vec::new();
        for section in file.sections() {
            let SectionFlags::Elf { sh_flags, .. } = section.flags() else {
                continue;
            };
            let has = |flag: elf::SectionFlags| sh_flags & flag == flag;
            if has(elf::SHF_ALLOC) && has(elf::SHF_WRITE) && section.size() > 0 {
                let mut from = section.address() as u32;
                let end = from + section.size() as u32;
                let mut inside: Vec<_> = events
                    .iter()
                    .chain(&simulated)
                    .filter(|(at, _)| (from..end).contains(at))
                    .collect();
                inside.sort();
                for (at, size) in inside {
                    variables.push((from, at.saturating_sub(from)));
                    from = from.max(at + size);
                }
                variables.push((from, end - from));
            }
        }
        let address = |name: &str| {
            let mut symbols = file.symbols();
            let symbol = symbols.find(|symbol| symbol.name() == Ok(name));
            Ok(symbol.with_context(|| format!("no {name}"))?.address() as u32)
        };
        let [start, end]: [Result<u32>; 2] = [address("_stack_end"), address("_stack_start")];
        let (start, end) = (start?, end?);
        Ok(Self {
            events,
            variables,
            stack: (start, end - start),
            scratch: 0x203f_fff0,
        })
    }
}

/// Numbers that a seed decides.
struct Dice(u64);

impl Dice {
    /// From 0 to below `end`.
    fn below(&mut self, end: u64) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (bits ^ (bits >> 31)) % end.max(1)
    }

    /// An address of one of these ranges.
    fn address(&mut self, ranges: &[(u32, u32)]) -> u32 {
        let mut at = self.below(ranges.iter().map(|(_, size)| u64::from(*size)).sum()) as u32;
        for (from, size) in ranges {
            if at < *size {
                return from + at;
            }
            at -= size;
        }
        0
    }
}

/// What was changed, for a person.
fn change(
    debugger: &mut Debugger,
    memory: &Memory,
    place: Place,
    dice: &mut Dice,
) -> HostResult<String> {
    let ranges = match place {
        Place::Events => &memory.events[..],
        Place::Variables => &memory.variables[..],
        Place::Stack => {
            // The part that is in use.
            let (from, size) = memory.stack;
            let end = from + size;
            let pointer = debugger.register(STACK_POINTER)?.clamp(from, end - 4);
            &[(pointer, end - pointer)][..]
        }
        Place::Register => {
            let number = REGISTERS[dice.below(REGISTERS.len() as u64) as usize];
            let bit = dice.below(32);
            let word = debugger.register(number)?;
            debugger.set_register(number, word ^ (1 << bit))?;
            return Ok(format!("register {number}, bit {bit}"));
        }
        Place::StackPointer => {
            let to = memory.stack.0.wrapping_sub(8 * dice.below(64) as u32);
            debugger.set_register(STACK_POINTER, to)?;
            return Ok(format!("stack pointer {to:#x}"));
        }
        Place::Peripheral => {
            let (address, word, name) = PERIPHERALS[dice.below(PERIPHERALS.len() as u64) as usize];
            debugger.store(address, word, memory.scratch)?;
            return Ok(name.to_owned());
        }
    };
    let address = dice.address(ranges);
    let bit = dice.below(8);
    let byte = debugger.byte(address)?;
    debugger.set_byte(address, byte ^ (1 << bit))?;
    Ok(format!("{address:#x}, bit {bit}"))
}

/// What became of a fault, as the table has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Became {
    Right,
    Lost,
    Noticed,
    Record,
    NoRecord,
    Outside,
    Wrong,
    GoesOn,
}

impl Became {
    const ALL: [(Self, &'static str); 8] = [
        (Self::Right, "right"),
        (Self::Lost, "right, losses counted"),
        (Self::Noticed, "noticed by the host"),
        (Self::Record, "restart with a record"),
        (Self::NoRecord, "restart without one"),
        (Self::Outside, "outside of the chip"),
        (Self::Wrong, "wrong events"),
        (Self::GoesOn, "goes on for ever"),
    ];

    fn of(end: &End) -> Self {
        match end {
            End::Done(Disturbed::Right { lost: 0 }) => Self::Right,
            End::Done(Disturbed::Right { .. }) => Self::Lost,
            // An image that cannot write its frames has said so.
            End::Done(Disturbed::Noticed(_)) | End::Failed(_) => Self::Noticed,
            End::Done(Disturbed::Wrong { .. }) => Self::Wrong,
            End::Restarted(_) => Self::Record,
            End::RestartedSilently | End::LockedUp => Self::NoRecord,
            End::Outside { .. } => Self::Outside,
            End::GoesOn { .. } => Self::GoesOn,
        }
    }
}

/// What came of the faults so far.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Record {
    /// SHA-256 of the image.
    image: String,
    /// Number of faults, which is the next one's seed.
    faults: u64,
    /// How often each end was seen, by place.
    ends: Vec<(Place, Became, u64)>,
}

impl Record {
    /// The record of an image; an empty one if there is none of it.
    fn read(image: &Path) -> Result<Self> {
        let digest = Sha256::digest(std::fs::read(image)?);
        let hash = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        let saved = std::fs::read_to_string(tree::path(RECORD)).unwrap_or_default();
        let saved: Self = serde_json::from_str(&saved).unwrap_or_default();
        if saved.image == hash {
            return Ok(saved);
        }
        Ok(Self {
            image: hash,
            ..Self::default()
        })
    }

    fn add(&mut self, place: Place, became: Became) {
        self.faults += 1;
        let is_it = |end: &&mut (Place, Became, u64)| (end.0, end.1) == (place, became);
        match self.ends.iter_mut().find(is_it) {
            Some((.., count)) => *count += 1,
            None => self.ends.push((place, became, 1)),
        }
        self.ends.sort();
    }

    fn count(&self, place: Place, became: Became) -> u64 {
        let ends = self.ends.iter();
        ends.filter(|end| (end.0, end.1) == (place, became))
            .map(|end| end.2)
            .sum()
    }

    fn save(&self) -> Result<()> {
        let text = serde_json::to_string(self)? + "\n";
        let path = tree::path(RECORD);
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    }
}

/// Makes faults, each in a run of its own, until there are `count`, and prints what became of them. To be saved, the record
/// goes on where it ended, if the image is the same, and the table is written into the document.
pub fn run(count: u64, save: bool) -> Result<ExitCode> {
    let image = image::build(MACHINE, "sensor")?;
    let memory = Memory::read(&image)?;
    let events = sensor::at_rate(&sensor::scene(EVENTS)?, RATE)?;
    let scene = Board::QUICK.scene(&events);
    let duration = duration(&image, &scene)?;
    let record = match save {
        true => Record::read(&image)?,
        false => Record::default(),
    };
    let next = AtomicU64::new(record.faults);
    let record = Mutex::new(record);
    let work = || -> Result<()> {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= count {
                return Ok(());
            }
            let (place, what, end) = fault(&image, &scene, &memory, duration, seed)
                .with_context(|| format!("fault {seed}"))?;
            let became = Became::of(&end);
            if !matches!(became, Became::Right | Became::Lost) {
                println!("{seed}: {place:?}, {what}: {end:?}");
            }
            let mut record = record.lock().unwrap_or_else(PoisonError::into_inner);
            record.add(place, became);
            if save && record.faults.is_multiple_of(SAVE_FAULTS) {
                record.save()?;
            }
        }
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..thread::available_parallelism().map_or(1, usize::from))
            .map(|_| scope.spawn(work))
            .collect();
        for worker in workers {
            match worker.join() {
                Ok(result) => result?,
                Err(_) => bail!("a worker panicked"),
            }
        }
        Ok(())
    })?;
    let record = record.into_inner().unwrap_or_else(PoisonError::into_inner);
    let table = table(&record);
    print!("{table}");
    if save {
        record.save()?;
        MARKS.write(&tree::path(DOCUMENT), &table)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn table(record: &Record) -> String {
    let mut table = format!("| {} faults |", record.faults);
    for (_, name) in Became::ALL {
        table += &format!(" {name} |");
    }
    table += "\n|---|";
    table += &"---|".repeat(Became::ALL.len());
    table += "\n";
    for (place, _, name) in Place::ALL {
        table += &format!("| {name} |");
        for (became, _) in Became::ALL {
            table += &format!(" {} |", record.count(place, became));
        }
        table += "\n";
    }
    table
}

/// How long a run takes that nothing disturbs.
fn duration(image: &Path, scene: &Scene<'_>) -> Result<Duration> {
    let started = Instant::now();
    let end = scene.disturb(MACHINE, image, Board::QUICK.shift, PATIENCE, |debugger| {
        debugger.go_on()?;
        Ok(true)
    })?;
    ensure!(
        end == Some(End::Done(Disturbed::Right { lost: 0 })),
        "without a fault: {end:?}"
    );
    Ok(started.elapsed())
}

/// Makes the fault of a seed, in a run that is not over by then.
fn fault(
    image: &Path,
    scene: &Scene<'_>,
    memory: &Memory,
    duration: Duration,
    seed: u64,
) -> Result<(Place, String, End)> {
    let mut dice = Dice(seed);
    let mut share = dice.below(100);
    let place = Place::ALL
        .into_iter()
        .find(|(_, weight, _)| {
            let is_it = share < *weight;
            share = share.saturating_sub(*weight);
            is_it
        })
        .map_or(Place::Register, |(place, ..)| place);
    loop {
        let after = duration.mul_f64(dice.below(1000) as f64 / 1000.0);
        let mut what = String::new();
        let end = scene.disturb(MACHINE, image, Board::QUICK.shift, PATIENCE, |debugger| {
            debugger.go_on()?;
            thread::sleep(after);
            if !debugger.stop()? {
                return Ok(false);
            }
            what = change(debugger, memory, place, &mut dice)?;
            debugger.go_on()?;
            Ok(true)
        })?;
        if let Some(end) = end {
            return Ok((place, what, end));
        }
    }
}
