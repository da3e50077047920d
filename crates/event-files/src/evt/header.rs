//! Header of Prophesee RAW and DAT files: text lines that begin with `% `.
//!
//! A RAW file names its word format (`% evt`, `% format`). A DAT file never does; its header has
//! `% Data file containing` and `% Version`.

use event_types::Sensor;
use event_types::stream::{ErrorKind, Result};

use crate::input::{Input, ReadSeek};
use crate::wrapping::Wrapping;

/// Largest length of a header line, and of the header, in bytes; real headers stay below 1 KiB.
const LINE_MAX: usize = 4096;
const HEADER_MAX: u64 = 1 << 16;

/// Key of a line of this project's writers: microseconds to add to the first time. The words of EVT 2 and EVT 3
/// hold 34 and 24 bits of time, so the upper bits of an absolute time would be lost without it.
const TIME_BASE_KEY: &str = "time_base_us";

/// The format of the words after the header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Words {
    /// 32-bit EVT 2.0.
    Evt2,
    /// 64-bit EVT 2.1.
    Evt21,
    /// 16-bit EVT 3.0.
    Evt3,
    /// 32-bit EVT 4.0.
    Evt4,
}

impl Words {
    const ALL: [Self; 4] = [Self::Evt2, Self::Evt21, Self::Evt3, Self::Evt4];

    /// Returns the format's name in messages.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::Evt2 => "EVT 2.0",
            Self::Evt21 => "EVT 2.1",
            Self::Evt3 => "EVT 3.0",
            Self::Evt4 => "EVT 4.0",
        }
    }

    /// Returns the version that a header states after `% evt`, such as `3.0`.
    #[must_use]
    pub const fn version(self) -> &'static str {
        match self {
            Self::Evt2 => "2.0",
            Self::Evt21 => "2.1",
            Self::Evt3 => "3.0",
            Self::Evt4 => "4.0",
        }
    }

    /// Returns the name after `% format`, in capitals.
    const fn format(self) -> &'static str {
        match self {
            Self::Evt2 => "EVT2",
            Self::Evt21 => "EVT21",
            Self::Evt3 => "EVT3",
            Self::Evt4 => "EVT4",
        }
    }
}

/// A parsed header of a RAW or DAT file.
#[derive(Debug, Clone)]
pub struct RawHeader {
    /// Word format, from `% evt 3.0` or `% format EVT3;...`; for an unknown one, its name.
    pub words: Result<Words, String>,
    /// Sensor size, from `% geometry WxH`, `% format EVT3;height=H;width=W`, or `% Width W` and `% Height H`;
    /// otherwise that of the sensor named by `% sensor_generation`, `% plugin_name` or `% system_ID`.
    pub sensor: Option<Sensor>,
    /// Microseconds from `% time_base_us`, or 0.
    pub time_base_us: u64,
    /// Camera, from `% plugin_name` or else from `% integrator_name`.
    pub camera: Option<String>,
    /// Order of a word's bytes, from `% endianness` or `% format EVT21;endianness=...`, in lower case.
    pub endianness: Option<String>,
    /// What follows `% Data file containing`, which only DAT files have.
    pub data: Option<String>,
    /// What follows `% Version`, which only DAT files have.
    pub version: Option<String>,
    /// What follows `% T0`, which faery writes: see [`RawHeader::t0_us`].
    pub t0: Option<String>,
    /// Length of the header in bytes.
    pub length: u64,
}

/// An opened RAW file, whose input is positioned at the first word.
pub struct RawFile {
    /// The file's bytes.
    pub input: Input,
    /// The file's header.
    pub header: RawHeader,
    /// The sensor's size.
    pub sensor: Sensor,
    /// Microseconds to add to the times of the words.
    pub t0_us: u64,
}

impl RawFile {
    /// Opens `source`, which messages call `name`; `size` is used if the header states no size.
    ///
    /// # Errors
    /// The header does not announce `words`, or the sensor's size is unknown.
    pub fn open(
        source: Box<dyn ReadSeek>,
        name: &str,
        size: Option<Sensor>,
        words: Words,
    ) -> Result<Self> {
        let mut input = Input::new(source, name)?;
        let header = RawHeader::read(&mut input)?;
        if header.words != Ok(words) {
            let (title, version) = (words.title(), words.version());
            return Err(input.error_at(0, format!("no {title} header (% evt {version})")));
        }
        Ok(Self {
            sensor: header.sensor_or(size, &input)?,
            t0_us: header.t0_us(&input)?,
            input,
            header,
        })
    }
}

impl RawHeader {
    /// Reads the header, and leaves the input after it. The header ends with `% end`, or before the first line
    /// that is not text after `% `, since old files have no `% end`.
    ///
    /// # Errors
    /// I/O; a header over 64 KiB; a size that no [`Sensor`] can have.
    pub fn read(input: &mut Input) -> Result<Self> {
        let mut fields = Fields::default();
        let mut line = Vec::new();
        loop {
            let start = input.offset();
            if start > HEADER_MAX {
                return Err(input.error("the header is longer than 65536 bytes: damaged file"));
            }
            line.clear();
            input.line(&mut line, LINE_MAX)?;
            let Some(text) = header_text(&line) else {
                input.seek(start)?;
                break;
            };
            if text == "end" {
                break;
            }
            fields.take(text);
        }
        fields.into_header(input)
    }

    /// Returns the text of a header that [`RawHeader::read`] and other readers accept.
    pub fn text(words: Words, sensor: Sensor, time_base_us: u64) -> String {
        let Sensor { width, height } = sensor;
        let (evt, format) = (words.version(), words.format());
        let (option, line) = match words {
            Words::Evt21 => (";endianness=little", "% endianness little\n"),
            _ => ("", ""),
        };
        let mut text = format!(
            "{line}% evt {evt}\n% format {format}{option};height={height};width={width}\n\
             % geometry {width}x{height}\n% integrator_name EECVS\n"
        );
        if time_base_us > 0 {
            text += &format!("% {TIME_BASE_KEY} {time_base_us}\n");
        }
        text + "% end\n"
    }

    /// Returns the microseconds to add to every time: faery subtracts them when it writes, and states them as
    /// `% T0`.
    ///
    /// # Errors
    /// The value is not a number of at most 2^60; to ignore it would silently change every time.
    pub fn t0_us(&self, input: &Input) -> Result<u64> {
        match self.t0.as_deref().map(str::parse) {
            None => Ok(0),
            Some(Ok(t0_us)) if t0_us <= Wrapping::START_MAX => Ok(t0_us),
            Some(_) => Err(input.error_at(0, "% T0 is not a time of at most 2^60 us")),
        }
    }

    /// Returns the header's sensor size, or `size` if the header states none.
    ///
    /// # Errors
    /// Neither is known.
    pub fn sensor_or(&self, size: Option<Sensor>, input: &Input) -> Result<Sensor> {
        self.sensor.or(size).ok_or_else(|| {
            input
                .error("the header names no sensor size: give --width W --height H")
                .of_kind(ErrorKind::Undecided)
        })
    }
}

/// Returns the text after `% ` of a header line, or `None` for anything else.
fn header_text(line: &[u8]) -> Option<&str> {
    let text = std::str::from_utf8(line)
        .ok()?
        .strip_suffix('\n')?
        .strip_prefix('%')?
        .trim_end();
    let printable = !text.chars().any(|c| c.is_control() && c != '\t');
    (printable && (text.is_empty() || text.starts_with(' '))).then(|| text.trim_start())
}

/// Returns the sensor size for one of Prophesee's camera system numbers. Cameras of other makers, such as
/// CenturyArks, use these numbers too, and the first of them wrote no geometry.
fn size_of_system(number: &str) -> Option<(u64, u64)> {
    match number.parse::<u32>().ok()? {
        21 | 23 | 25 | 28 | 29 | 33 | 35 => Some((640, 480)),
        26 | 30 | 46 | 49 => Some((1280, 720)),
        _ => None,
    }
}

#[derive(Default)]
struct Fields {
    evt: Option<String>,
    format: Option<String>,
    width: Option<u64>,
    height: Option<u64>,
    named: Option<(u64, u64)>,
    /// Size by the camera's system number, which is less specific than a sensor's name.
    by_system: Option<(u64, u64)>,
    plugin: Option<String>,
    integrator: Option<String>,
    time_base_us: u64,
    endianness: Option<String>,
    data: Option<String>,
    version: Option<String>,
    t0: Option<String>,
}

impl Fields {
    fn take(&mut self, text: &str) {
        let (key, value) = text.split_once([' ', '\t']).unwrap_or((text, ""));
        let value = value.trim();
        match key.to_ascii_lowercase().as_str() {
            "evt" => self.evt = Some(value.to_owned()),
            "format" => {
                let mut parts = value.split(';').map(str::trim);
                self.format = parts.next().map(str::to_ascii_uppercase);
                for (key, value) in parts.filter_map(|part| part.split_once('=')) {
                    self.side(key.trim(), value.trim());
                }
            }
            "geometry" => {
                if let Some((width, height)) = value.split_once('x') {
                    self.side("width", width.trim());
                    self.side("height", height.trim());
                }
            }
            key @ ("width" | "height") => self.side(key, value),
            "sensor_generation" => {
                self.named = match value.split('.').next() {
                    Some("3") => Some((640, 480)),
                    Some("4") => Some((1280, 720)),
                    _ => self.named,
                };
            }
            "system_id" => self.by_system = size_of_system(value),
            "integrator_name" => self.integrator = Some(value.to_owned()),
            "plugin_name" => {
                self.plugin = Some(value.to_owned());
                let holds = |name| value.contains(name);
                if holds("gen31") || holds("gen3_") {
                    self.named = self.named.or(Some((640, 480)));
                } else if holds("gen4") || holds("imx636") {
                    self.named = self.named.or(Some((1280, 720)));
                } else if holds("genx320") {
                    self.named = self.named.or(Some((320, 320)));
                }
            }
            "endianness" => self.endianness = Some(value.to_ascii_lowercase()),
            "data" => self.data = value.strip_prefix("file containing").map(str::to_owned),
            "version" => self.version = Some(value.to_owned()),
            "t0" => self.t0 = Some(value.to_owned()),
            TIME_BASE_KEY => self.time_base_us = value.parse().unwrap_or(0),
            _ => {}
        }
    }

    fn side(&mut self, key: &str, value: &str) {
        match key {
            "width" => self.width = value.parse().ok().or(self.width),
            "height" => self.height = value.parse().ok().or(self.height),
            "endianness" => self.endianness = Some(value.to_ascii_lowercase()),
            _ => {}
        }
    }

    fn into_header(self, input: &Input) -> Result<RawHeader> {
        let named = |is_named: &dyn Fn(Words) -> bool| {
            Words::ALL.into_iter().find(|words| is_named(*words))
        };
        let words = match (self.evt.as_deref(), self.format.as_deref()) {
            (_, Some(name)) => {
                named(&|words| words.format() == name).ok_or_else(|| name.to_owned())
            }
            (Some(version), None) => {
                named(&|words| words.version() == version).ok_or_else(|| format!("EVT {version}"))
            }
            (None, None) => Err(String::new()),
        };
        let size = self
            .width
            .zip(self.height)
            .or(self.named)
            .or(self.by_system);
        let side = |side: u64| u16::try_from(side).unwrap_or(0);
        let sensor = size.map(|(width, height)| {
            Sensor::new(side(width), side(height)).ok_or_else(|| {
                let limit = Sensor::SIDE_MAX;
                input.error(format!(
                    "the header's sensor size {width}x{height} is not within 1x1 to {limit}x{limit}"
                ))
            })
        });
        let time_base_us = self.time_base_us;
        let camera = self.plugin.or(self.integrator);
        if time_base_us > Wrapping::START_MAX {
            return Err(input.error(format!("{TIME_BASE_KEY} {time_base_us} is above 2^60")));
        }
        Ok(RawHeader {
            words,
            sensor: sensor.transpose()?,
            time_base_us,
            camera,
            endianness: self.endianness,
            data: self.data,
            version: self.version,
            t0: self.t0,
            length: input.offset(),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn parse(bytes: &[u8]) -> (RawHeader, u64) {
        let mut input = Input::new(Box::new(Cursor::new(bytes.to_vec())), "test").expect("memory");
        let header = RawHeader::read(&mut input).expect("a header");
        (header, input.offset())
    }

    #[test]
    fn sizes_of_every_style() {
        let cases: [(&[u8], Words, (u16, u16)); 9] = [
            (
                b"% evt 2.0\n% plugin_name silky_common_plugin\n% system_ID 28\n",
                Words::Evt2,
                (640, 480),
            ),
            (
                b"% evt 3.0\n% geometry 320x240\n% end\n",
                Words::Evt3,
                (320, 240),
            ),
            (
                b"% format EVT3;height=720;width=1280\n% end\n",
                Words::Evt3,
                (1280, 720),
            ),
            (
                b"% evt 2.0\n% Width 304\n% Height 240\n",
                Words::Evt2,
                (304, 240),
            ),
            (
                b"% evt 2.0\n% plugin_name hal_plugin_gen3_fx3\n",
                Words::Evt2,
                (640, 480),
            ),
            (
                b"% evt 3.0\n% sensor_generation 4.2\n",
                Words::Evt3,
                (1280, 720),
            ),
            (b"% evt 3.0\r\n% geometry 4x5\r\n", Words::Evt3, (4, 5)),
            (
                b"% format EVT21;endianness=legacy;height=720;width=1280\n% end\n",
                Words::Evt21,
                (1280, 720),
            ),
            (b"% evt 4.0\n% geometry 4x5\n% end\n", Words::Evt4, (4, 5)),
        ];
        for (bytes, words, (width, height)) in cases {
            let (header, offset) = parse(bytes);
            assert_eq!(header.words, Ok(words));
            assert_eq!(header.sensor, Sensor::new(width, height));
            assert_eq!(offset, bytes.len() as u64);
        }
    }

    #[test]
    fn data_that_looks_like_a_header_line_is_data() {
        let (_, offset) = parse(b"% evt 2.0\n%\x01\x02\x80\n\n");
        assert_eq!(offset, 10);
        let (_, offset) = parse(b"% evt 2.0\n% end\n% x\n");
        assert_eq!(offset, 16);
    }

    #[test]
    fn orders_of_a_words_bytes() {
        for (bytes, endianness) in [
            (&b"% evt 2.1\n% end\n"[..], None),
            (b"% format EVT21;endianness=Legacy\n", Some("legacy")),
            (b"% endianness little\n% evt 2.1\n", Some("little")),
        ] {
            assert_eq!(parse(bytes).0.endianness.as_deref(), endianness);
        }
    }

    #[test]
    fn a_dat_file_names_no_words() {
        let (header, offset) =
            parse(b"% Data file containing CD events.\n% Version 2\n% T0 17\n\x0c\x08");
        assert_eq!(header.words, Err(String::new()));
        assert_eq!(header.data.as_deref(), Some(" CD events."));
        assert_eq!(header.version.as_deref(), Some("2"));
        assert_eq!(header.t0.as_deref(), Some("17"));
        assert_eq!((header.length, offset), (54, 54));
    }

    #[test]
    fn written_text_reads_back() {
        let sensor = Sensor {
            width: 346,
            height: 260,
        };
        for words in Words::ALL {
            let (header, _) = parse(RawHeader::text(words, sensor, 1 << 34).as_bytes());
            assert_eq!(header.words, Ok(words));
            assert_eq!(header.sensor, Some(sensor));
            assert_eq!(header.time_base_us, 1 << 34);
        }
    }
}
