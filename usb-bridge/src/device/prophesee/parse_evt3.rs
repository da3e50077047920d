//! EVT 3.0 as it comes from a camera: words of 16 bits, little-endian, the type in the upper four.
//!
//! `host_harness::formats::evt3` has the layout. A file's reader stops at a word outside of the
//! sensor; a camera's counts it and goes on. Time is that of the file's reader but for its wraps,
//! which [`HighTime`] carries, so that no damaged word moves them. After a break events come
//! again once `TIME_HIGH`, `TIME_LOW` and `ADDR_Y` have.
//!
//! Words of the common types cost no branch that cannot be predicted: their type looks up what
//! they change ([`EFFECTS`]), and every word writes an event, over which the next one goes where it
//! was none.

use eecvs_nostd::{Event, Polarity, Sensor};
use host_harness::formats::Skipped;
use host_harness::formats::evt3::{
    ADDR_X, ADDR_Y, TIME_BITS, TIME_HIGH, TIME_LOW, VECT_8, VECT_12, VECT_BASE_X,
};

use super::high_time::HighTime;
use crate::device::Parse;

/// Columns of the longest vector.
const VECTOR: u16 = 12;
/// Words of one run, at the most: what a byte counts.
const RUN_WORDS: usize = 255;
/// Room for the events of a run.
const ROOM: usize = 512;
/// Events of a run that leave room for a vector, and for the event that every word writes.
const ROOM_USED_MAX: usize = ROOM - 16;

/// Lanes of a parser's registers, 16 bits each: the row, the lower time, the vector's column.
const ROW: u32 = 0;
const LOW: u32 = 16;
const BASE: u32 = 32;
/// A word in each lane.
const SPREAD: u64 = 1 << ROW | 1 << LOW | 1 << BASE;
const LANE: u64 = 0xffff;
/// A lane whose value has not come, or that of a vector beyond the last column.
const NONE: u64 = 0xf000;
const COLUMN: u16 = 0x7ff;
/// A column that no sensor has.
const BEYOND: u32 = 1 << 16;
const ON: u16 = 0x800;

/// Counts of a run, a byte each.
const COUNTED: [&str; 8] = [
    "events alone",
    "rows",
    "times, lower bits",
    "vectors' first columns",
    "continued words",
    "other words",
    "triggers",
    "padding",
];

/// What a word does.
#[derive(Clone, Copy)]
struct Effect {
    /// Bits of the registers that stay.
    keep: u64,
    /// Bits that come from the word.
    take: u64,
    /// What it counts as, in the byte of its kind; 0 for a word that is not common.
    count: u64,
    /// 1 for an event.
    event: usize,
}

/// What a word of each type does.
static EFFECTS: [Effect; 16] = {
    let mut effects = [Effect {
        keep: !0,
        take: 0,
        count: 0,
        event: 0,
    }; 16];
    let mut kind = 0;
    while kind < 16 {
        let effect = &mut effects[kind as usize];
        let (count, lane, bits) = match kind {
            ADDR_X => (Some(0), 0, 0),
            ADDR_Y => (Some(1), ROW, COLUMN),
            TIME_LOW => (Some(2), LOW, 0xfff),
            VECT_BASE_X => (Some(3), BASE, 0xfff),
            0x7 | 0xf => (Some(4), 0, 0),
            0xe => (Some(5), 0, 0),
            0xa => (Some(6), 0, 0),
            0x9 => (Some(7), 0, 0),
            _ => (None, 0, 0),
        };
        if let Some(count) = count {
            effect.count = 1 << (8 * count);
        }
        if bits != 0 {
            effect.keep = !(LANE << lane);
            effect.take = (bits as u64) << lane;
        }
        effect.event = (kind == ADDR_X) as usize;
        kind += 1;
    }
    effects
};

/// Parser of EVT 3.0.
pub struct Evt3Parser {
    sensor: Sensor,
    /// First byte of a word whose second has not come.
    half: Option<u8>,
    high: HighTime<TIME_BITS>,
    /// Upper time in microseconds.
    high_us: u64,
    /// The `TIME_HIGH` that changes nothing; 0, which is none, while the next one might.
    same_high: u16,
    /// [`ROW`], [`LOW`] and [`BASE`].
    registers: u64,
    /// [`LOW`] after the first `TIME_HIGH`: 0 at the stream's start, [`NONE`] after a break, as that word
    /// may be one that was repeated in the middle of its time.
    first_low: u64,
    /// The sensor's rows while there is a time, else 0.
    rows: u16,
    /// Where a run puts its events.
    room: Box<[Event; ROOM]>,
    latest_us: Option<u64>,
    events: u64,
    /// As [`COUNTED`].
    counted: [u64; 8],
    times: u64,
    vectors: u64,
    empty_vectors: u64,
    losses: Skipped,
}

impl Evt3Parser {
    const REGISTERS: u64 = NONE << ROW | NONE << BASE;

    /// At the start of a stream of a camera with this sensor.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        Self {
            sensor,
            half: None,
            high: HighTime::new(),
            high_us: 0,
            same_high: 0,
            registers: Self::REGISTERS,
            first_low: 0,
            rows: 0,
            room: Box::new(
                [Event {
                    t_us: 0,
                    x: 0,
                    y: 0,
                    polarity: Polarity::Off,
                }; ROOM],
            ),
            latest_us: None,
            events: 0,
            counted: [0; 8],
            times: 0,
            vectors: 0,
            empty_vectors: 0,
            losses: Skipped::default(),
        }
    }

    /// Words so far, whatever they were. They are those of [`Parse::words`], the single events, the
    /// vectors, and the unknown ones.
    #[must_use]
    pub fn words_seen(&self) -> u64 {
        let named = self.words().iter().map(|(_, count)| count).sum::<u64>();
        let unknown = self.losses.iter().find(|(name, _)| *name == UNKNOWN);
        named + self.counted[0] + self.vectors + unknown.map_or(0, |(_, count)| count)
    }

    /// Takes words up to the first that is not common, or that no run has room for; returns how many.
    fn run(&mut self, words: &[[u8; 2]], events: &mut Vec<Event>) -> usize {
        let (high_us, same_high) = (self.high_us, self.same_high);
        let (width, rows) = (self.sensor.width, self.rows);
        let mut registers = self.registers;
        let room = &mut *self.room;
        let (mut filled, mut counts, mut same, mut vectors) = (0, 0_u64, 0_u64, 0_u64);
        let mut done = 0;
        for word in words.iter().take(RUN_WORDS) {
            let word = u16::from_le_bytes(*word);
            let effect = &EFFECTS[usize::from(word >> 12)];
            registers = registers & effect.keep | (u64::from(word) * SPREAD) & effect.take;
            let row = (registers >> ROW) as u16;
            let column = word & COLUMN;
            room[filled % ROOM] = Event {
                t_us: high_us | (registers >> LOW) & LANE,
                x: column,
                y: row,
                polarity: Polarity::from_bool(word & ON != 0),
            };
            let is_outside = (column >= width) | (row >= rows);
            if (effect.count == 0) | (is_outside & (effect.event != 0)) {
                if word == same_high {
                    same += 1;
                    done += 1;
                    continue;
                }
                let base = (registers >> BASE) as u16;
                let bits = match word >> 12 {
                    VECT_12 => word & 0xfff,
                    VECT_8 => word & 0xff,
                    _ => 0,
                };
                let first = base & COLUMN;
                let step = if word >> 12 == VECT_12 { 12 } else { 8 };
                let fits = base < NONE as u16 && first + step <= width && row < rows;
                if bits == 0 || !fits || filled > ROOM_USED_MAX {
                    break;
                }
                let event = Event {
                    t_us: high_us | (registers >> LOW) & LANE,
                    x: first,
                    y: row,
                    polarity: Polarity::from_bool(base & ON != 0),
                };
                registers = after_vector(registers, step);
                for bit in 0..VECTOR {
                    room[filled % ROOM] = Event {
                        x: first + bit,
                        ..event
                    };
                    filled += usize::from(bits >> bit & 1);
                }
                vectors += 1;
                done += 1;
                continue;
            }
            filled += effect.event;
            counts += effect.count;
            done += 1;
            if filled > ROOM_USED_MAX {
                break;
            }
        }
        self.registers = registers;
        events.extend_from_slice(&room[..filled.min(ROOM)]);
        self.events += filled as u64;
        for (total, count) in self.counted.iter_mut().zip(counts.to_le_bytes()) {
            *total += u64::from(count);
        }
        self.times += same;
        self.vectors += vectors;
        done
    }

    /// Takes a word that a run did not; `false` where a run is to take it now.
    #[cold]
    fn take(&mut self, word: u16, events: &mut Vec<Event>) -> bool {
        match word >> 12 {
            ADDR_X => {
                if self.begin() {
                    return false;
                }
                self.counted[0] += 1;
                self.emit((word & COLUMN).into(), 1, word & ON != 0, events);
            }
            VECT_12 => self.vector(word & 0xfff, 12, events),
            VECT_8 => self.vector(word & 0xff, 8, events),
            TIME_HIGH => {
                self.times += 1;
                let before = self.high.last();
                let high = self.high.extend(u64::from(word & 0xfff));
                self.high_us = high << TIME_BITS;
                self.same_high = if self.high.is_trusted() { word } else { 0 };
                match before {
                    None => self.set(LOW, self.first_low),
                    Some(before) if before != high => self.set(LOW, 0),
                    Some(_) => (),
                }
                self.begin();
            }
            _ => self.losses.add(UNKNOWN, 1),
        }
        true
    }

    /// Whether events have a time from now on and had none before.
    fn begin(&mut self) -> bool {
        let has_time = self.high.last().is_some() && self.lane(LOW) < NONE;
        let begins = has_time && self.rows == 0;
        if begins {
            self.rows = self.sensor.height;
        }
        begins
    }

    fn lane(&self, lane: u32) -> u64 {
        self.registers >> lane & LANE
    }

    fn set(&mut self, lane: u32, value: u64) {
        self.registers = self.registers & !(LANE << lane) | value << lane;
    }

    fn vector(&mut self, bits: u16, step: u16, events: &mut Vec<Event>) {
        self.begin();
        if bits == 0 {
            self.empty_vectors += 1;
        } else {
            self.vectors += 1;
        }
        let base = self.lane(BASE);
        if base == NONE {
            let count = u64::from(bits.count_ones());
            self.losses.add("events before the first column", count);
            return;
        }
        self.registers = after_vector(self.registers, step);
        let column = if base > NONE {
            BEYOND
        } else {
            base as u32 & u32::from(COLUMN)
        };
        self.emit(column, bits, base & u64::from(ON) != 0, events);
    }

    /// Emits what has a time, a row and a pixel of `column + i` for the bits i, and counts the rest.
    fn emit(&mut self, column: u32, bits: u16, is_on: bool, events: &mut Vec<Event>) {
        let row = self.lane(ROW);
        let count = u64::from(bits.count_ones());
        if self.rows == 0 {
            self.losses.add("events before the first time", count);
            return;
        }
        if row >= NONE {
            self.losses.add("events before the first row", count);
            return;
        }
        let mut left = bits;
        while left != 0 {
            let x = u16::try_from(column + left.trailing_zeros()).unwrap_or(u16::MAX);
            left &= left - 1;
            // Below 2^16.
            let y = row as u16;
            if self.sensor.contains(x, y) {
                self.events += 1;
                events.push(Event {
                    t_us: self.high_us | self.lane(LOW),
                    x,
                    y,
                    polarity: Polarity::from_bool(is_on),
                });
            } else {
                self.losses.add("events outside of the sensor", 1);
            }
        }
    }

    fn words_of(&mut self, mut words: &[[u8; 2]], events: &mut Vec<Event>) {
        while !words.is_empty() {
            let done = self.run(words, events);
            words = &words[done..];
            if done == 0
                && let Some((word, rest)) = words.split_first()
                && self.take(u16::from_le_bytes(*word), events)
            {
                words = rest;
            }
        }
    }
}

const UNKNOWN: &str = "unknown words";

/// The registers after a vector: the next one begins `step` columns further, and beyond the last column
/// of any sensor nowhere.
const fn after_vector(registers: u64, step: u16) -> u64 {
    let base = registers >> BASE & LANE;
    let next = (base & COLUMN as u64) + step as u64;
    let next = if base > NONE || next > COLUMN as u64 {
        NONE + 1
    } else {
        base & ON as u64 | next
    };
    registers & !(LANE << BASE) | next << BASE
}

impl Parse for Evt3Parser {
    fn sensor(&self) -> Sensor {
        self.sensor
    }

    fn parse(&mut self, bytes: &[u8], events: &mut Vec<Event>) {
        let mut bytes = bytes;
        if let Some(half) = self.half.take() {
            let Some((second, rest)) = bytes.split_first() else {
                self.half = Some(half);
                return;
            };
            self.words_of(&[[half, *second]], events);
            bytes = rest;
        }
        let (words, rest) = bytes.as_chunks();
        self.words_of(words, events);
        self.half = rest.first().copied();
        if self.high.last().is_some() && self.lane(LOW) < NONE {
            self.latest_us = Some(self.high_us | self.lane(LOW));
        }
    }

    fn resume(&mut self, now_us: Option<u64>) {
        if self.half.take().is_some() {
            self.losses.add("bytes of an incomplete word", 1);
        }
        self.high.resume(now_us.map(|now_us| now_us >> TIME_BITS));
        self.same_high = 0;
        self.rows = 0;
        self.first_low = NONE;
        self.registers = NONE << ROW | NONE << LOW | NONE << BASE;
    }

    fn time_us(&self) -> Option<u64> {
        self.latest_us
    }

    fn events(&self) -> u64 {
        self.events
    }

    fn words(&self) -> Skipped {
        let mut words = Skipped::default();
        for (name, count) in COUNTED.into_iter().zip(self.counted).skip(1) {
            words.add(name, count);
        }
        words.add("times, upper bits", self.times);
        words.add("empty vectors", self.empty_vectors);
        words
    }

    fn losses(&self) -> Skipped {
        self.losses.clone()
    }
}
