//! AEDAT 2.0 of the DVS128 and every DAVIS, as jAER, v2e and MATLAB scripts write it.
//!
//! A file is header lines that begin with `#`, then pairs of big-endian 32-bit words: an address, and a time in
//! us. `Layout` describes how an address encodes pixel and polarity. y is as in the file: in jAER it counts
//! upwards.
//!
//! The header line `# AEChip:` names the chip; v2e, saveaerdat.m and jAER before 2014 write no such line. Without
//! it:
//!
//! 1. If the addresses have only 16 bits, the chip is a DVS128; if their lower 10 bits are 0, it is a DAVIS. If
//!    both fit, or neither, or the file has no events, it is a DAVIS if the size is known; without a size, or if
//!    both fit and the size is 128x128, the reader's error asks for the chip's line or the size.
//! 2. A DAVIS has the size that the caller states, or else that of the lines `# sizeX` and `# sizeY`. Without
//!    either it is a DAVIS240C, provided that no address of the whole file lies outside it; otherwise the reader's
//!    error asks for the size.
//! 3. What was assumed is among the reader's assumptions.
//!
//! A chip that is not in `Chip`'s list is read by the same rules with the caller's size. Without a size, it is
//! refused unless its addresses are those of a DVS128. The time wraps after 71.6 minutes; the wraps are counted.
//! No maintained crate reads AEDAT 2.0.

use std::path::Path;

use event_types::stream::{ErrorKind, Result};
use event_types::{Event, Sensor, bail, error};

use crate::aedat::chip::{Chip, Layout};
use crate::format::{Format, Limits, Opening};
use crate::input::{Batch, Decode, Input, ReadSeek, Reader, Words};
use crate::output::sequential::Output;
use crate::wrapping::Wrapping;
use crate::{Assumption, EventWriter, Skipped};

/// First line of every AEDAT 2.0 file, without the minor version and the line end.
pub const MAGIC: &[u8] = b"#!AER-DAT2";

/// Largest length of the header in bytes: jAER copies its preferences into it, 175 kB in a real file.
const HEADER_MAX: u64 = 1 << 24;
const LINE_MAX: usize = 1 << 16;

/// Number of addresses that are examined if the header does not name the chip.
const CHIP_WORDS: usize = 4096;

/// Key of a line of this project's writer: microseconds to add to the first time, which has only 32 bits.
const TIME_BASE_KEY: &str = "time_base_us:";

/// This format's entry in the table of formats.
pub const FORMAT: Format = Format {
    name: "aedat2",
    title: "AEDAT 2",
    endings: &[".aedat"],
    detect: |start| start.begins(MAGIC),
    open: |Opening {
               source,
               name,
               reading,
               ..
           }| Ok(Box::new(Aedat2Reader::new(source, name, reading.size)?)),
    has_places: false,
    is_table: false,
    grows: true,
    streams: true,
    limits: Limits {
        x_max: 239,
        y_max: 179,
        ..Limits::NONE
    },
    create: Some(|path, sensor| Ok(Box::new(Aedat2Writer::create(path, sensor)?))),
};

/// A reader of AEDAT 2.0 files.
pub type Aedat2Reader = Reader<Aedat2Decoder>;

impl Aedat2Reader {
    /// Reads `source`, which messages call `name`; `size` is used if the header names no known chip.
    ///
    /// # Errors
    /// There is no AEDAT 2.0 header; without a size, the chip is unknown, or more than one layout fits the
    /// addresses.
    pub fn new(source: Box<dyn ReadSeek>, name: &str, size: Option<Sensor>) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let header = Header::read(&mut input)?;
        let mut assumptions = Vec::new();
        let known = header.class.as_deref().and_then(Chip::of_name);
        let chip = match known {
            Some(chip) => chip,
            None => {
                let guess = Guess {
                    class: header.class.as_deref(),
                    size: size.or(header.size),
                };
                guess.chip(&mut input, &mut assumptions)?
            }
        };
        let camera = match &header.class {
            Some(class) => class.rsplit('.').next().map(str::to_owned),
            None => (chip.layout == Layout::Dvs128).then(|| "DVS128".to_owned()),
        };
        Ok(Self::around(Aedat2Decoder {
            input,
            words: Words::default(),
            chip,
            camera,
            assumptions,
            time: Wrapping::new(32, header.time_base_us),
            events: 0,
            skipped: Skipped::default(),
        }))
    }
}

/// The decoder of [`Aedat2Reader`]: its state between two pairs of words.
pub struct Aedat2Decoder {
    input: Input,
    words: Words<8>,
    chip: Chip,
    camera: Option<String>,
    assumptions: Vec<Assumption>,
    time: Wrapping,
    events: u64,
    skipped: Skipped,
}

impl Decode for Aedat2Decoder {
    fn format(&self) -> &'static str {
        "aedat2"
    }

    fn sensor(&self) -> Sensor {
        self.chip.sensor
    }

    fn camera(&self) -> Option<&str> {
        self.camera.as_deref()
    }

    fn assumptions(&self) -> &[Assumption] {
        &self.assumptions
    }

    fn leave_out_bad_events(&mut self) -> bool {
        self.input.leave_out_bad_events();
        true
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn decode(&mut self, batch: &mut Batch<'_>) -> Result<()> {
        let sensor = self.chip.sensor;
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
                    self.input
                        .outside(offset, self.events, (x, y), sensor, &mut self.skipped)?;
                }
            }
            self.events += 1;
        }
        Ok(())
    }
}

/// What the header states.
#[derive(Default)]
struct Header {
    /// Class after `# AEChip:`.
    class: Option<String>,
    /// Size from `# sizeX` and `# sizeY`, which some scripts write.
    size: Option<Sensor>,
    time_base_us: u64,
}

impl Header {
    /// Reads the header and leaves the input at the first word.
    fn read(input: &mut Input) -> Result<Self> {
        let mut header = Self::default();
        let (mut width, mut height) = (None, None);
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
                break;
            }
            let text = String::from_utf8_lossy(&line);
            let text = text.trim_start_matches(['#', ' ', '\t']).trim_end();
            if text.eq_ignore_ascii_case("End Of ASCII Header") {
                break;
            }
            if let Some(class) = text.strip_prefix("AEChip:") {
                header.class = Some(class.trim().to_owned()).filter(|class| !class.is_empty());
            } else if let Some(side) = text.strip_prefix("sizeX") {
                width = side.trim_matches([' ', ':', '=']).parse().ok();
            } else if let Some(side) = text.strip_prefix("sizeY") {
                height = side.trim_matches([' ', ':', '=']).parse().ok();
            } else if let Some(base) = text.strip_prefix(TIME_BASE_KEY) {
                let base = base.trim().parse().ok();
                header.time_base_us = base
                    .filter(|base| *base <= Wrapping::START_MAX)
                    .ok_or_else(|| {
                        input.error_at(start, "the time base is not a number of at most 2^60 us")
                    })?;
            }
        }
        header.size = width
            .zip(height)
            .and_then(|(width, height)| Sensor::new(width, height));
        Ok(header)
    }
}

/// Returns whether `line` is text after `#`. The first address of a DAVIS240C may also begin with the byte of `#`,
/// but control characters then follow.
pub(crate) fn is_header_line(line: &[u8]) -> bool {
    let text = line
        .strip_suffix(b"\n")
        .map(|text| text.strip_suffix(b"\r").unwrap_or(text));
    text.is_some_and(|text| {
        text.starts_with(b"#") && !text.iter().any(|c| c.is_ascii_control() && *c != b'\t')
    })
}

/// What is known about a chip that the header does not name, or names by an unknown name.
struct Guess<'a> {
    class: Option<&'a str>,
    size: Option<Sensor>,
}

impl Guess<'_> {
    /// Returns the chip that the first addresses indicate, and adds the assumption to `said`; leaves the input
    /// where it is.
    fn chip(&self, input: &mut Input, said: &mut Vec<Assumption>) -> Result<Chip> {
        let layout = self.layout(input)?;
        let is_large = |sensor: &Sensor| *sensor != Chip::DVS128.sensor;
        let chip = match (layout, self.size) {
            (Layout::Dvs128, Some(Sensor { width, height }))
                if self.size.is_some_and(|s| is_large(&s)) =>
            {
                let what = format!(
                    "{}, and the addresses have 16 bits, as those of a DVS128 (128x128), not a \
                     sensor of {width}x{height}: omit --width and --height",
                    self.named()
                );
                return Err(input.error(what));
            }
            (Layout::Dvs128, _) => Chip::DVS128,
            (Layout::Davis, Some(sensor)) => Chip { layout, sensor },
            (Layout::Davis, None) => self.davis(input)?,
        };
        let Sensor { width, height } = chip.sensor;
        let taken = format!("{} of {width}x{height}", layout.name());
        let why = match (layout, self.size) {
            (Layout::Dvs128, _) => format!("{}, and the addresses have 16 bits", self.named()),
            (_, Some(_)) => format!(
                "{}, and the addresses are those of a DAVIS; the size was given",
                self.named()
            ),
            (_, None) => format!(
                "{}, and the addresses are those of a DAVIS and all fit a DAVIS240; for another \
                 DAVIS, give --width and --height",
                self.named()
            ),
        };
        said.push(Assumption {
            what: "chip",
            taken,
            why,
        });
        Ok(chip)
    }

    fn named(&self) -> String {
        match self.class {
            Some(class) => format!("chip {class} is not known"),
            None => "no `# AEChip:` line".to_owned(),
        }
    }

    /// Returns the layout that all of the first addresses allow.
    fn layout(&self, input: &mut Input) -> Result<Layout> {
        let start = input.offset();
        let mut words = Words::<8>::default();
        let (mut dvs, mut davis, mut count) = (true, true, 0);
        // The reader will meet the damage again, after the events before it.
        while count < CHIP_WORDS
            && let Ok(Some([a0, a1, a2, a3, ..])) = words.next(input)
        {
            let address = u32::from_be_bytes([a0, a1, a2, a3]);
            dvs &= Layout::Dvs128.allows(address);
            davis &= Layout::Davis.allows(address);
            count += 1;
        }
        input.seek(start)?;
        let is_large = self.size.is_some_and(|size| size != Chip::DVS128.sensor);
        match (dvs, davis, self.size) {
            (true, false, _) => Ok(Layout::Dvs128),
            (false, true, _) => Ok(Layout::Davis),
            // Samples of old firmware and tags of filters use the lower bits; the caller knows the size, so it is
            // a DAVIS.
            (false, false, Some(_)) => Ok(Layout::Davis),
            (true, true, Some(_)) if is_large || count == 0 => Ok(Layout::Davis),
            (true, true, _) if count > 0 => Err(input
                .error(format!(
                    "{}, and the addresses fit a DVS128 as well as a DAVIS: add a line such as \
                     `# AEChip: DVS128` or `# AEChip: DAVIS240C` to the header, or give --width W \
                     --height H",
                    self.named()
                ))
                .of_kind(ErrorKind::Undecided)),
            _ => Err(input
                .error(format!(
                    "{}, so the sensor size is not known: give --width W --height H",
                    self.named()
                ))
                .of_kind(ErrorKind::Undecided)),
        }
    }

    /// Returns the DAVIS240 if the whole file has no address outside it.
    fn davis(&self, input: &mut Input) -> Result<Chip> {
        let ask = |input: &Input, why: String| {
            let what = format!("{}{why}: give --width W --height H", self.named());
            Err(input.error(what).of_kind(ErrorKind::Undecided))
        };
        if self.class.is_some() {
            return ask(input, String::new());
        }
        let start = input.offset();
        let mut words = Words::<8>::default();
        let (mut width, mut height) = (0, 0);
        while let Ok(Some([a0, a1, a2, a3, ..])) = words.next(input) {
            let address = u32::from_be_bytes([a0, a1, a2, a3]);
            if Chip::DAVIS240.decode(address).is_ok() {
                let (x, y) = Layout::Davis.fields(address);
                (width, height) = (width.max(x + 1), height.max(y + 1));
            }
        }
        input.seek(start)?;
        let Sensor {
            width: columns,
            height: rows,
        } = Chip::DAVIS240.sensor;
        if width > u32::from(columns) || height > u32::from(rows) {
            let why = format!(
                ", and the addresses span {width} columns and {height} rows, more than a DAVIS240 \
                 has (other DAVIS sensors have 346x260 or 640x480)"
            );
            return ask(input, why);
        }
        Ok(Chip::DAVIS240)
    }
}

/// A writer of AEDAT 2.0 files for the sizes of DVS128 (128x128) and DAVIS240C (240x180).
///
/// It holds times up to 2^60 us (the header line `# time_base_us:` carries what exceeds 32 bits), in any order as
/// long as a reader can follow the wraps; gaps must be below 35 minutes.
pub struct Aedat2Writer {
    file: Output,
    chip: Chip,
    /// Counter of the times; `None` until the first event, whose time the header needs.
    time: Option<Wrapping>,
    events: u64,
}

impl Aedat2Writer {
    /// Creates the file; the header is written with the first event.
    ///
    /// # Errors
    /// I/O; the sensor's size is that of neither chip.
    pub fn create(path: &Path, sensor: Sensor) -> Result<Self> {
        let mut chips = [Chip::DVS128, Chip::DAVIS240].into_iter();
        let chip = chips.find(|chip| chip.sensor == sensor);
        let chip = chip.ok_or_else(|| {
            error!(
                CannotHold,
                "{}: AEDAT 2.0 holds only DVS128 (128x128) and DAVIS240C (240x180) recordings, not \
                 {}x{}: write .aedat4",
                crate::output::final_path(path).display(),
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

    fn header(&mut self, first_us: u64) -> Result<Wrapping> {
        let time = Wrapping::new(32, first_us);
        let mut text = format!(
            "#!AER-DAT2.0\r\n# This is a raw AE data file - do not edit\r\n\
             # Data format is int32 address, int32 timestamp (8 bytes total), repeated for each \
             event\r\n# Timestamps tick is 1 us\r\n# AEChip: {}\r\n",
            self.chip.class()
        );
        if time.base() > 0 {
            text += &format!("# {TIME_BASE_KEY} {}\r\n", time.base());
        }
        text += "#End Of ASCII Header\r\n";
        self.file.put(text.as_bytes())?;
        Ok(time)
    }
}

impl EventWriter for Aedat2Writer {
    fn write(&mut self, events: &[Event]) -> Result<()> {
        for event in events {
            crate::check_inside(self.file.name(), self.events, event, self.chip.sensor)?;
            let mut time = match self.time.take() {
                Some(time) => time,
                None => self.header(event.t_us)?,
            };
            // `low` is below 2^32.
            let low = time.low(event.t_us) as u32;
            if time.extend(u64::from(low)) != event.t_us {
                let refused =
                    crate::time_refused(self.file.name(), self.events, event.t_us, "AEDAT 2.0");
                bail!(CannotHold, "{}", refused);
            }
            self.time = Some(time);
            let address = self.chip.encode(event);
            self.file.put(&address.to_be_bytes())?;
            self.file.put(&low.to_be_bytes())?;
            self.events += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        if self.events == 0 {
            self.header(0)?;
        }
        self.file.finish()
    }
}
