//! The cameras of AEDAT 1 to 3: their names, sizes and address layouts.
//!
//! jAER writes a chip's Java class into its files (`eu.seebetter.ini.chips.davis.Davis346red`), cAER a short name
//! (`DAVIS346B`). Both vary in upper and lower case and in what follows the size. DAVIS chips of all sizes share
//! one address layout, mirrored about the chip's last column, so a wrong size gives wrong columns without an
//! error.

use event_types::{Event, Polarity, Sensor};

/// How an AEDAT 2 address encodes pixel and polarity.
///
/// | layout | x | y | polarity | not an event |
/// |---|---|---|---|---|
/// | DVS128 | 127 - bits 7..1 | bits 14..8 | bit 0, 0 = ON | bit 15: external |
/// | DAVIS | width - 1 - bits 21..12 | bits 30..22 | bit 11, 1 = ON | bit 31: APS or IMU; bit 10: external |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Addresses of 16 bits.
    Dvs128,
    /// Addresses of 32 bits.
    Davis,
}

/// A chip: its address layout and its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chip {
    /// Layout of the chip's addresses.
    pub layout: Layout,
    /// Size of the chip.
    pub sensor: Sensor,
}

const fn davis(width: u16, height: u16) -> Chip {
    Chip {
        layout: Layout::Davis,
        sensor: Sensor { width, height },
    }
}

impl Chip {
    /// The DVS128, of 128 x 128 pixels.
    pub const DVS128: Self = Self {
        layout: Layout::Dvs128,
        sensor: Sensor {
            width: 128,
            height: 128,
        },
    };

    /// The DAVIS240C, and all other DAVIS chips of its size.
    pub const DAVIS240: Self = davis(240, 180);

    /// How the names of chips begin, in lower case. The DAVIS240 was first called SBret and SeeBetter.
    const NAMES: [(&'static str, Self); 16] = [
        ("dvs128", Self::DVS128),
        ("tmpdiff128", Self::DVS128),
        ("edvs", Self::DVS128),
        ("davis240", Self::DAVIS240),
        ("dvs240", Self::DAVIS240),
        ("sbret10", Self::DAVIS240),
        ("sbret20", Self::DAVIS240),
        ("sbret21", Self::DAVIS240),
        ("davis128", davis(128, 128)),
        ("davis208", davis(208, 192)),
        ("pixelparade", davis(208, 192)),
        ("sensdavis192", davis(208, 192)),
        ("davis320", davis(320, 240)),
        ("davis346", davis(346, 260)),
        ("davi346", davis(346, 260)),
        ("davis640", davis(640, 480)),
    ];

    /// Returns the chip of a name or a Java class, if it is known.
    #[must_use]
    pub fn of_name(name: &str) -> Option<Self> {
        let class = name.trim().rsplit('.').next().unwrap_or_default();
        let class = class.to_ascii_lowercase();
        let known = |(start, _): &&(&str, Self)| class.starts_with(start);
        Self::NAMES.iter().find(known).map(|(_, chip)| *chip)
    }

    /// Returns the chip's class in jAER, for writers; known for the DVS128 and the DAVIS240C.
    #[must_use]
    pub const fn class(self) -> &'static str {
        match self.layout {
            Layout::Dvs128 => "ch.unizh.ini.jaer.chip.retina.DVS128",
            Layout::Davis => "eu.seebetter.ini.chips.davis.DAVIS240C",
        }
    }

    /// Returns column, row and polarity of an address.
    ///
    /// # Errors
    /// The address is not an event: the error names the kind that it is counted as.
    pub fn decode(self, address: u32) -> Result<(i64, i64, Polarity), &'static str> {
        match self.layout {
            Layout::Dvs128 if address >> 16 != 0 => Err("unknown words"),
            Layout::Dvs128 if address & 0x8000 != 0 => Err("external events"),
            Layout::Davis if address >> 31 != 0 => Err("APS and IMU words"),
            Layout::Davis if address & 0x400 != 0 => Err("external events"),
            layout => {
                let (x, y) = layout.fields(address);
                let on = match layout {
                    Layout::Dvs128 => address & 1 == 0,
                    Layout::Davis => address & 0x800 != 0,
                };
                let last = i64::from(self.sensor.width) - 1;
                Ok((last - i64::from(x), y.into(), Polarity::from_bool(on)))
            }
        }
    }

    /// Returns the address of an event, which must lie on the chip.
    #[must_use]
    pub fn encode(self, event: &Event) -> u32 {
        let (x, y) = (u32::from(event.x), u32::from(event.y));
        let on = u32::from(event.polarity == Polarity::On);
        let last = u32::from(self.sensor.width) - 1;
        match self.layout {
            Layout::Dvs128 => y << 8 | (last - x) << 1 | (1 - on),
            Layout::Davis => y << 22 | (last - x) << 12 | on << 11,
        }
    }
}

impl Layout {
    /// Returns the address's fields of x, not mirrored, and of y.
    #[must_use]
    pub const fn fields(self, address: u32) -> (u32, u32) {
        match self {
            Self::Dvs128 => (address >> 1 & 0x7f, address >> 8 & 0x7f),
            Self::Davis => (address >> 12 & 0x3ff, address >> 22 & 0x1ff),
        }
    }

    /// Returns whether an address is possible in this layout.
    #[must_use]
    pub const fn allows(self, address: u32) -> bool {
        match self {
            Self::Dvs128 => address >> 16 == 0,
            // The lower bits belong to samples and to the types of external events.
            Self::Davis => address >> 31 != 0 || address & 0x3ff == 0,
        }
    }

    /// Returns the layout's name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Dvs128 => "DVS128",
            Self::Davis => "DAVIS",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_jaer_and_caer() {
        let size = |name: &str| {
            let Sensor { width, height } = Chip::of_name(name)?.sensor;
            Some((width, height))
        };
        for (name, want) in [
            ("ch.unizh.ini.jaer.chip.retina.DVS128", Some((128, 128))),
            ("DVS128", Some((128, 128))),
            ("eu.seebetter.ini.chips.DAViS.SBret10", Some((240, 180))),
            ("SBRet21", Some((240, 180))),
            (
                "eu.seebetter.ini.chips.davis.DAVIS240BaseCamera",
                Some((240, 180)),
            ),
            (
                "eu.seebetter.ini.chips.davis.Davis208PixelParadeColor",
                Some((208, 192)),
            ),
            ("eu.seebetter.ini.chips.davis.Davis346red", Some((346, 260))),
            (
                "eu.seebetter.ini.chips.davis.Davis346BColor",
                Some((346, 260)),
            ),
            ("DAVI346", Some((346, 260))),
            ("DAVIS346zero", Some((346, 260))),
            (
                "eu.seebetter.ini.chips.davis.Davis640Color",
                Some((640, 480)),
            ),
            ("eu.seebetter.ini.chips.davis.Davis128", Some((128, 128))),
            ("eu.seebetter.ini.chips.davis.CDAVIS", None),
            ("ch.unizh.ini.jaer.chip.cochlea.CochleaAMS1c", None),
            ("", None),
        ] {
            assert_eq!(size(name), want, "{name}");
        }
        assert_eq!(
            Chip::of_name("Davis128").map(|chip| chip.layout),
            Some(Layout::Davis)
        );
    }

    #[test]
    fn addresses_read_back() {
        for chip in Chip::NAMES.map(|(_, chip)| chip) {
            let Sensor { width, height } = chip.sensor;
            for (x, y) in [(0, 0), (width - 1, height - 1), (width / 3, height / 2)] {
                for polarity in [Polarity::On, Polarity::Off] {
                    let event = Event {
                        t_us: 0,
                        x,
                        y,
                        polarity,
                    };
                    let address = chip.encode(&event);
                    let want = (i64::from(x), i64::from(y), polarity);
                    assert_eq!(chip.decode(address), Ok(want), "{chip:?}");
                    assert!(chip.layout.allows(address));
                }
            }
        }
    }
}
