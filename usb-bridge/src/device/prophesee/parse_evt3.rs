//! Parses EVT 3.0 as a camera sends it: 16-bit little-endian words with their type in the upper four bits.
//!
//! `event_files::evt::evt3` describes the layout. The reader of files stops at a word outside the sensor; this
//! parser counts it and goes on. Time is decoded as by the reader of files, except for its wraps, which
//! `high_time.rs` extends so that no damaged word shifts them. After a break, events are decoded again once
//! `TIME_HIGH`, `TIME_LOW` and `ADDR_Y` have arrived.
//!
//! Most words come in groups: an optional repeated `TIME_HIGH`, an optional `TIME_LOW`, an optional `ADDR_Y`, and
//! an `ADDR_X`. Which of the optional words are present cannot be predicted, so a group of any shape is decoded in
//! one step without a branch on it (`Evt3Parser::run`).

use std::hint::select_unpredictable as pick;

use eecvs_nostd::{Event, Polarity, Sensor};
use event_files::Skipped;
use event_files::evt::evt3::{
    ADDR_X, ADDR_Y, TIME_BITS, TIME_HIGH, TIME_LOW, VECT_8, VECT_12, VECT_BASE_X,
};

use super::high_time::HighTime;
use crate::device::Parse;

/// Columns of the longest vector.
const VECTOR: u16 = 12;
/// Size of the buffer for the events of a run.
const ROOM: usize = 512;
/// Most events in the buffer that leave room for a vector.
const ROOM_USED_MAX: usize = ROOM - 16;

/// Marks a row, a lower time or a first column that is unknown; larger than all real values.
const NONE: u16 = 0xf000;
/// Marks the first column of a vector that begins beyond the last column of any sensor.
const OVER: u16 = NONE + 1;
const COLUMN: u16 = 0x7ff;
const ON: u16 = 0x800;
const TIME: u16 = 0xfff;
/// No word of 16 bits; 0 would be a word of row 0.
const NO_WORD: u32 = 1 << 16;
/// A column that no sensor has.
const BEYOND: u32 = 1 << 16;

/// Names of the words that are only counted.
const COUNTED: [&str; 4] = ["continued words", "other words", "triggers", "padding"];

/// Returns the index in [`COUNTED`] of a word type.
const fn counted(kind: u16) -> Option<usize> {
    match kind {
        0x7 | 0xf => Some(0),
        0xe => Some(1),
        0xa => Some(2),
        0x9 => Some(3),
        _ => None,
    }
}

const UNKNOWN: &str = "unknown words";

/// Parser of EVT 3.0.
pub struct Evt3Parser {
    sensor: Sensor,
    /// First byte of a word whose second byte has not arrived.
    half: Option<u8>,
    high: HighTime<TIME_BITS>,
    /// Upper time, in microseconds.
    high_us: u64,
    /// The `TIME_HIGH` word that changes nothing; [`NO_WORD`] while the next one may change something.
    same_high: u32,
    /// Lower time, or [`NONE`].
    low: u16,
    /// Value of [`Evt3Parser::low`] after the first `TIME_HIGH`: 0 at the start of the stream, [`NONE`] after a
    /// break, because that word may be a repetition in the middle of its period.
    first_low: u16,
    /// Row, or [`NONE`].
    row: u16,
    /// First column and polarity of the next vector, or [`NONE`] or [`OVER`].
    base: u16,
    /// Number of rows of the sensor, or 0 while no time is known.
    rows: u16,
    /// Buffer for the events of a run.
    room: Box<[Event; ROOM]>,
    latest_us: Option<u64>,
    events: u64,
    /// Counts of the words in [`COUNTED`].
    counted: [u64; 4],
    highs: u64,
    lows: u64,
    row_words: u64,
    bases: u64,
    singles: u64,
    vectors: u64,
    empty_vectors: u64,
    losses: Skipped,
}

impl Evt3Parser {
    /// Starts at the beginning of the stream of a camera with this sensor.
    #[must_use]
    pub fn new(sensor: Sensor) -> Self {
        let nothing = Event {
            t_us: 0,
            x: 0,
            y: 0,
            polarity: Polarity::Off,
        };
        Self {
            sensor,
            half: None,
            high: HighTime::new(),
            high_us: 0,
            same_high: NO_WORD,
            low: 0,
            first_low: 0,
            row: NONE,
            base: NONE,
            rows: 0,
            room: Box::new([nothing; ROOM]),
            latest_us: None,
            events: 0,
            counted: [0; 4],
            highs: 0,
            lows: 0,
            row_words: 0,
            bases: 0,
            singles: 0,
            vectors: 0,
            empty_vectors: 0,
            losses: Skipped::default(),
        }
    }

    /// Returns the number of words so far, of whatever kind: those in [`Parse::words`], single events, vectors and
    /// unknown words.
    #[must_use]
    pub fn words_seen(&self) -> u64 {
        let named = self.words().iter().map(|(_, count)| count).sum::<u64>();
        let unknown = self.losses.iter().find(|(name, _)| *name == UNKNOWN);
        named + self.singles + self.vectors + unknown.map_or(0, |(_, count)| count)
    }

    /// Decodes words as long as they are regular, four of them are available and there is room for their events.
    /// Returns the number of words decoded.
    fn run(&mut self, words: &[[u8; 2]], events: &mut Vec<Event>) -> usize {
        let (high_us, same_high) = (self.high_us, self.same_high);
        let (width, rows) = (self.sensor.width, self.rows);
        let (mut low, mut row) = (u64::from(self.low), self.row);
        let room = &mut *self.room;
        let (mut highs, mut lows, mut row_words, mut singles) = (0, 0, 0, 0);
        let (mut at, mut filled) = (0, 0);
        while filled <= ROOM_USED_MAX
            && let Some(four) = words.get(at..).and_then(<[_]>::first_chunk::<4>)
        {
            let first = u64::from_le_bytes(four.as_flattened().try_into().unwrap_or_default());
            // Finds which of the optional words are present; each one is shifted out.
            let has_high = u32::from(first as u16) == same_high;
            let second = pick(has_high, first >> 16, first);
            let has_low = second >> 12 & 0xf == u64::from(TIME_LOW);
            let third = pick(has_low, second >> 16, second);
            let has_row = third >> 12 & 0xf == u64::from(ADDR_Y);
            let event = pick(has_row, third >> 16, third) as u16;
            let new_low = pick(has_low, second & u64::from(TIME), low);
            let new_row = pick(has_row, third as u16 & COLUMN, row);
            let x = event & COLUMN;
            if (event >> 12 == ADDR_X) & (x < width) & (new_row < rows) {
                (low, row) = (new_low, new_row);
                room[filled % ROOM] = Event {
                    t_us: high_us | low,
                    x,
                    y: row,
                    polarity: Polarity::from_bool(event & ON != 0),
                };
                filled += 1;
                singles += 1;
                highs += u64::from(has_high);
                lows += u64::from(has_low);
                row_words += u64::from(has_row);
                at += 1 + usize::from(has_high) + usize::from(has_low) + usize::from(has_row);
                continue;
            }
            // Not such a group: take one word by itself.
            let word = first as u16;
            match word >> 12 {
                TIME_HIGH if has_high => highs += 1,
                TIME_LOW => {
                    low = u64::from(word & TIME);
                    lows += 1;
                }
                ADDR_Y => {
                    row = word & COLUMN;
                    row_words += 1;
                }
                VECT_BASE_X => {
                    self.base = word & TIME;
                    self.bases += 1;
                }
                kind @ (VECT_12 | VECT_8) => {
                    let step = if kind == VECT_12 { 12 } else { 8 };
                    let bits = word & ((1 << step) - 1);
                    let column = self.base & COLUMN;
                    if self.base >= NONE || column + step > width || row >= rows || bits == 0 {
                        break;
                    }
                    for bit in 0..VECTOR {
                        room[filled % ROOM] = Event {
                            t_us: high_us | low,
                            x: column + bit,
                            y: row,
                            polarity: Polarity::from_bool(self.base & ON != 0),
                        };
                        filled += usize::from(bits >> bit & 1);
                    }
                    self.base = after_vector(self.base, step);
                    self.vectors += 1;
                }
                kind => match counted(kind) {
                    Some(kind) => self.counted[kind] += 1,
                    None => break,
                },
            }
            at += 1;
        }
        // `low` is below 2^16.
        (self.low, self.row) = (low as u16, row);
        self.highs += highs;
        self.lows += lows;
        self.row_words += row_words;
        self.singles += singles;
        self.events += filled as u64;
        events.extend_from_slice(&room[..filled.min(ROOM)]);
        at
    }

    /// Decodes a word of any kind.
    fn take(&mut self, word: u16, events: &mut Vec<Event>) {
        // A run may have found the lower time that was missing.
        self.look_for_time();
        match word >> 12 {
            ADDR_X => {
                self.singles += 1;
                self.emit((word & COLUMN).into(), 1, word & ON != 0, events);
            }
            ADDR_Y => {
                self.row_words += 1;
                self.row = word & COLUMN;
            }
            VECT_BASE_X => {
                self.bases += 1;
                self.base = word & TIME;
            }
            VECT_12 => self.vector(word & 0xfff, 12, events),
            VECT_8 => self.vector(word & 0xff, 8, events),
            TIME_LOW => {
                self.lows += 1;
                self.low = word & TIME;
            }
            TIME_HIGH => {
                self.highs += 1;
                let before = self.high.last();
                let high = self.high.extend(u64::from(word & TIME));
                self.high_us = high << TIME_BITS;
                self.same_high = if self.high.is_trusted() {
                    u32::from(word)
                } else {
                    NO_WORD
                };
                match before {
                    None => self.low = self.first_low,
                    Some(before) if before != high => self.low = 0,
                    Some(_) => (),
                }
            }
            kind => match counted(kind) {
                Some(kind) => self.counted[kind] += 1,
                None => self.losses.add(UNKNOWN, 1),
            },
        }
        self.look_for_time();
    }

    fn look_for_time(&mut self) {
        let has_time = self.high.last().is_some() && self.low < NONE;
        self.rows = if has_time { self.sensor.height } else { 0 };
    }

    fn vector(&mut self, bits: u16, step: u16, events: &mut Vec<Event>) {
        if bits == 0 {
            self.empty_vectors += 1;
        } else {
            self.vectors += 1;
        }
        let base = self.base;
        if base == NONE {
            let count = u64::from(bits.count_ones());
            self.losses.add("events before the first column", count);
            return;
        }
        let column = match base {
            OVER => BEYOND,
            _ => u32::from(base & COLUMN),
        };
        self.base = after_vector(base, step);
        self.emit(column, bits, base & ON != 0, events);
    }

    /// Emits events at `column + i` for each bit i that have a time, a row and a pixel; counts the others as lost.
    fn emit(&mut self, column: u32, bits: u16, is_on: bool, events: &mut Vec<Event>) {
        let count = u64::from(bits.count_ones());
        if self.rows == 0 {
            self.losses.add("events before the first time", count);
            return;
        }
        if self.row == NONE {
            self.losses.add("events before the first row", count);
            return;
        }
        let mut left = bits;
        while left != 0 {
            let x = u16::try_from(column + left.trailing_zeros()).unwrap_or(u16::MAX);
            left &= left - 1;
            if self.sensor.contains(x, self.row) {
                self.events += 1;
                events.push(Event {
                    t_us: self.high_us | u64::from(self.low),
                    x,
                    y: self.row,
                    polarity: Polarity::from_bool(is_on),
                });
            } else {
                self.losses.add("events outside of the sensor", 1);
            }
        }
    }

    fn words_of(&mut self, mut words: &[[u8; 2]], events: &mut Vec<Event>) {
        while let Some((word, rest)) = words.split_first() {
            let done = self.run(words, events);
            if done == 0 {
                self.take(u16::from_le_bytes(*word), events);
                words = rest;
            } else {
                words = &words[done..];
            }
        }
    }
}

/// Returns the first column of the next vector after a vector of `step` columns.
const fn after_vector(base: u16, step: u16) -> u16 {
    let next = (base & COLUMN) + step;
    if base >= NONE || next > COLUMN {
        OVER
    } else {
        base & ON | next
    }
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
        if self.high.last().is_some() && self.low < NONE {
            self.latest_us = Some(self.high_us | u64::from(self.low));
        }
    }

    fn resume(&mut self, now_us: Option<u64>) {
        if self.half.take().is_some() {
            self.losses.add("bytes of an incomplete word", 1);
        }
        self.high.resume(now_us.map(|now_us| now_us >> TIME_BITS));
        self.same_high = NO_WORD;
        self.rows = 0;
        self.first_low = NONE;
        (self.low, self.row, self.base) = (NONE, NONE, NONE);
    }

    fn time_us(&self) -> Option<u64> {
        self.latest_us
    }

    fn events(&self) -> u64 {
        self.events
    }

    fn words(&self) -> Skipped {
        let mut words = Skipped::default();
        for (name, count) in COUNTED.into_iter().zip(self.counted) {
            words.add(name, count);
        }
        words.add("times, upper bits", self.highs);
        words.add("times, lower bits", self.lows);
        words.add("rows", self.row_words);
        words.add("vectors' first columns", self.bases);
        words.add("empty vectors", self.empty_vectors);
        words
    }

    fn losses(&self) -> Skipped {
        self.losses.clone()
    }
}
