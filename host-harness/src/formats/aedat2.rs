//! AEDAT 2.0 of DVS128 and DAVIS240C, as jAER writes it.
//!
//! Header lines that begin with `#`, then pairs of big-endian 32-bit words: address, time in us.
//!
//! | chip | x | y | polarity | not an event |
//! |---|---|---|---|---|
//! | DVS128 | 127 - bits 7..1 | bits 14..8 | bit 0, 0 = ON | bit 15: external |
//! | DAVIS240C | 239 - bits 21..12 | bits 30..22 | bit 11, 1 = ON | bit 31: APS or IMU; bit 10: external |
//!
//! y is as in the file: it counts upwards in jAER. Which chip it is says the header line
//! `# AEChip:`; without one, addresses above 16 bits mean DAVIS240C. The time wraps after 71.6
//! minutes; the wraps are carried. No maintained crate reads AEDAT 2.0.

use std::path::Path;

use anyhow::Context;
use eecvs_nostd::{Event, Polarity, Sensor};

use super::format::{Format, Limits, Opening};
use super::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use super::output::Output;
use super::wrapping::Wrapping;
use super::{EventWriter, Skipped};

/// First line of every AEDAT 2.0 file, without its line end.
pub const MAGIC: &[u8] = b"#!AER-DAT2";

/// jAER copies its preferences into the header: 175 kB in a real file.
const HEADER_MAX: u64 = 1 << 24;
const LINE_MAX: usize = 1 << 16;

/// Words looked at where the header does not name the chip.
const CHIP_WORDS: usize = 4096;

/// Line of our own writer: microseconds to add to the first time, which has only 32 bits.
const TIME_BASE_KEY: &str = "# time_base_us:";

/// A chip's address layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Chip {
    Dvs128,
    Davis240c,
}

impl Chip {
    const ALL: [Self; 2] = [Self::Dvs128, Self::Davis240c];

    const fn sensor(self) -> Sensor {
        match self {
            Self::Dvs128 => Sensor {
                width: 128,
                height: 128,
            },
            Self::Davis240c => Sensor {
                width: 240,
                height: 180,
            },
        }
    }

    const fn class(self) -> &'static str {
        match self {
            Self::Dvs128 => "ch.unizh.ini.jaer.chip.retina.DVS128",
            Self::Davis240c => "eu.seebetter.ini.chips.davis.DAVIS240C",
        }
    }

    /// (x, y, polarity) of an address, or the name of what it is instead.
    fn decode(self, address: u32) -> Result<(i64, i64, Polarity), &'static str> {
        let field = |shift: u32, bits: u32| i64::from(address >> shift & ((1 << bits) - 1));
        match self {
            Self::Dvs128 if address >> 16 != 0 => Err("unknown words"),
            Self::Dvs128 if address & 0x8000 != 0 => Err("external events"),
            Self::Dvs128 => Ok((
                127 - field(1, 7),
                field(8, 7),
                Polarity::from_bool(address & 1 == 0),
            )),
            Self::Davis240c if address >> 31 != 0 => Err("APS and IMU words"),
            Self::Davis240c if address & 0x400 != 0 => Err("external events"),
            Self::Davis240c => {
                let polarity = Polarity::from_bool(address & 0x800 != 0);
                Ok((239 - field(12, 10), field(22, 9), polarity))
            }
        }
    }

    /// Address of a pixel inside of the sensor.
    fn encode(self, event: &Event) -> u32 {
        let (x, y) = (u32::from(event.x), u32::from(event.y));
        let on = u32::from(event.polarity == Polarity::On);
        match self {
            Self::Dvs128 => y << 8 | (127 - x) << 1 | (1 - on),
            Self::Davis240c => y << 22 | (239 - x) << 12 | on << 11,
        }
    }
}

/// This format in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat2",
    title: "AEDAT 2",
    endings: &[".aedat"],
    detect: |start| start.begins(MAGIC),
    open: |Opening { source, name, .. }| Ok(Box::new(Aedat2Reader::new(source, name)?)),
    has_places: false,
    grows: true,
    limits: Limits {
        x_max: 239,
        y_max: 179,
        ..Limits::NONE
    },
    create: Some(|path, sensor| Ok(Box::new(Aedat2Writer::create(path, sensor)?))),
};

/// Reader of AEDAT 2.0 files.
pub type Aedat2Reader = Reader<Aedat2Decoder>;

impl Aedat2Reader {
    /// Reads `source`, which messages call `name`.
    ///
    /// # Errors
    /// No AEDAT 2.0 header, an unknown chip.
    pub fn new(source: Box<dyn ReadSeek>, name: &str) -> anyhow::Result<Self> {
        let mut input = Input::new(source, name)?;
        let (chip, time_base_us) = read_header(&mut input)?;
        let chip = match chip {
            Some(chip) => chip,
            None => chip_of_addresses(&mut input)?,
        };
        Ok(Self::around(Aedat2Decoder {
            input,
            words: Words::default(),
            chip,
            time: Wrapping::new(32, time_base_us),
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// State between two pairs of words.
pub struct Aedat2Decoder {
    input: Input,
    words: Words<8>,
    chip: Chip,
    time: Wrapping,
    events: u64,
    skipped: Skipped,
}

impl Decode for Aedat2Decoder {
    fn format(&self) -> &'static str {
        "aedat2"
    }

    fn sensor(&self) -> Sensor {
        self.chip.sensor()
    }

    fn camera(&self) -> Option<&str> {
        self.chip.class().rsplit('.').next()
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> anyhow::Result<()> {
        let sensor = self.chip.sensor();
        while batch.room() > 0 {
            let Some([a0, a1, a2, a3, t0, t1, t2, t3]) = self.words.next(&mut self.input)? else {
                break;
            };
            // Skipped words carry the time too: a wrap may fall between two events.
            let t_us = self
                .time
                .extend(u64::from(u32::from_be_bytes([t0, t1, t2, t3])));
            let (x, y, polarity) = match self.chip.decode(u32::from_be_bytes([a0, a1, a2, a3])) {
                Ok(event) => event,
                Err(kind) => {
                    self.skipped.add(kind, 1);
                    continue;
                }
            };
            match (u16::try_from(x), u16::try_from(y)) {
                (Ok(x), Ok(y)) if sensor.contains(x, y) => {
                    batch.push(Event {
                        t_us,
                        x,
                        y,
                        polarity,
                    });
                }
                _ => {
                    let offset = self.words.offset(&self.input);
                    return Err(self.input.outside(offset, self.events, x, y, sensor));
                }
            }
            self.events += 1;
        }
        Ok(())
    }
}

/// The chip that the header names, if any, and the time base; leaves the input at the first word.
fn read_header(input: &mut Input) -> anyhow::Result<(Option<Chip>, u64)> {
    let (mut chip, mut time_base_us) = (None, 0);
    let mut line = Vec::new();
    loop {
        let start = input.offset();
        if start > HEADER_MAX {
            return Err(input.error("the header is longer than 16 MiB: damaged file"));
        }
        line.clear();
        input.line(&mut line, LINE_MAX)?;
        if start == 0 && !line.starts_with(MAGIC) {
            return Err(input.error_at(0, "no AEDAT 2.0 header (#!AER-DAT2.0)"));
        }
        if !is_header_line(&line) {
            input.seek(start)?;
            return Ok((chip, time_base_us));
        }
        let text = String::from_utf8_lossy(&line);
        if text.trim_end() == "#End Of ASCII Header" {
            return Ok((chip, time_base_us));
        }
        if let Some(class) = text.strip_prefix("# AEChip:") {
            let class = class.trim();
            chip = match class.rsplit('.').next().unwrap_or(class) {
                "DVS128" => Some(Chip::Dvs128),
                "DAVIS240" | "DAVIS240A" | "DAVIS240B" | "DAVIS240C" => Some(Chip::Davis240c),
                other => {
                    return Err(input.error_at(
                        start,
                        format!("chip {other}: only DVS128 and DAVIS240C are known"),
                    ));
                }
            };
        } else if let Some(base) = text.strip_prefix(TIME_BASE_KEY) {
            let base = base
                .trim()
                .parse()
                .ok()
                .filter(|base| *base <= Wrapping::START_MAX);
            time_base_us =
                base.ok_or_else(|| input.error_at(start, "the time base is no number"))?;
        }
    }
}

/// Whether `line` is text after `#`. The first address of a DAVIS240C may begin with the byte of
/// `#` as well, but then control characters follow.
fn is_header_line(line: &[u8]) -> bool {
    let text = line
        .strip_suffix(b"\n")
        .map(|text| text.strip_suffix(b"\r").unwrap_or(text));
    text.is_some_and(|text| {
        text.starts_with(b"#") && !text.iter().any(|c| c.is_ascii_control() && *c != b'\t')
    })
}

/// Guesses the chip: the addresses of a DVS128 stay below 2^16. The input stays where it is.
fn chip_of_addresses(input: &mut Input) -> anyhow::Result<Chip> {
    let start = input.offset();
    let mut words = Words::<8>::default();
    let mut chip = Chip::Dvs128;
    for _ in 0..CHIP_WORDS {
        match words.next(input) {
            Ok(Some([0, 0, ..])) => {}
            Ok(Some(_)) => chip = Chip::Davis240c,
            // The reader will meet the damage again, after the events before it.
            Ok(None) | Err(_) => break,
        }
    }
    input.seek(start)?;
    Ok(chip)
}

/// Writer of AEDAT 2.0 files for the sizes of DVS128 (128x128) and DAVIS240C (240x180).
///
/// Times up to 2^60 us (the header line `# time_base_us:` carries what exceeds 32 bits), in any
/// order as long as a reader can follow the wraps; gaps stay below 35 minutes.
pub struct Aedat2Writer {
    file: Output,
    chip: Chip,
    /// `None` until the first event: the header needs its time.
    time: Option<Wrapping>,
    events: u64,
}

impl Aedat2Writer {
    /// Creates the file.
    ///
    /// # Errors
    /// I/O, a sensor size that no known chip has.
    pub fn create(path: &Path, sensor: Sensor) -> anyhow::Result<Self> {
        let chip = Chip::ALL.into_iter().find(|chip| chip.sensor() == sensor);
        let chip = chip.with_context(|| {
            format!(
                "{}: AEDAT 2.0 holds DVS128 (128x128) and DAVIS240C (240x180), not {}x{}: \
                 write .aedat4",
                path.display(),
                sensor.width,
                sensor.height
            )
        })?;
        let file = Output::create(path)?;
        Ok(Self {
            file,
            chip,
            time: None,
            events: 0,
        })
    }

    fn header(&mut self, first_us: u64) -> anyhow::Result<Wrapping> {
        let time = Wrapping::new(32, first_us);
        let mut text = format!(
            "#!AER-DAT2.0\r\n# This is a raw AE data file - do not edit\r\n\
             # Data format is int32 address, int32 timestamp (8 bytes total), repeated for each \
             event\r\n# Timestamps tick is 1 us\r\n# AEChip: {}\r\n",
            self.chip.class()
        );
        if time.base() > 0 {
            text += &format!("{TIME_BASE_KEY} {}\r\n", time.base());
        }
        text += "#End Of ASCII Header\r\n";
        self.file.put(text.as_bytes())?;
        Ok(time)
    }
}

impl EventWriter for Aedat2Writer {
    fn write(&mut self, events: &[Event]) -> anyhow::Result<()> {
        for event in events {
            super::check_inside(self.file.name(), self.events, event, self.chip.sensor())?;
            let mut time = match self.time.take() {
                Some(time) => time,
                None => self.header(event.t_us)?,
            };
            // Below 2^32.
            let low = time.low(event.t_us) as u32;
            if time.extend(u64::from(low)) != event.t_us {
                let refused =
                    super::time_refused(self.file.name(), self.events, event.t_us, "AEDAT 2.0");
                anyhow::bail!(refused);
            }
            self.time = Some(time);
            let address = self.chip.encode(event);
            self.file.put(&address.to_be_bytes())?;
            self.file.put(&low.to_be_bytes())?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> anyhow::Result<()> {
        if self.events == 0 {
            self.header(0)?;
        }
        self.file.finish()
    }
}
