//! One brightness change of one pixel.

/// The sign of a brightness change: `On` is +1 and `Off` is -1 in the sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Polarity {
    /// The pixel became darker: p = -1, stored as 0.
    Off = 0,
    /// The pixel became brighter: p = +1, stored as 1.
    On = 1,
}

impl Polarity {
    /// `On` where `bright` is true.
    #[inline]
    #[must_use]
    pub const fn from_bool(bright: bool) -> Self {
        if bright { Self::On } else { Self::Off }
    }

    /// p of the formulas: +1 or -1.
    #[inline]
    #[must_use]
    pub const fn sign(self) -> i32 {
        match self {
            Self::On => 1,
            Self::Off => -1,
        }
    }
}

/// An event (t, x, y, p) as a camera reports it.
///
/// `t_us` is in unsigned microseconds of any epoch; `x` runs to the right in `0..width`,
/// `y` downwards in `0..height`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Event {
    /// Time in microseconds.
    pub t_us: u64,
    /// Column, 0 at the left.
    pub x: u16,
    /// Row, 0 at the top.
    pub y: u16,
    /// Sign of the brightness change.
    pub polarity: Polarity,
}

/// Size of a sensor in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensor {
    /// Columns, 1 to [`Sensor::SIDE_MAX`].
    pub width: u16,
    /// Rows, 1 to [`Sensor::SIDE_MAX`].
    pub height: u16,
}

impl Sensor {
    /// Largest width and height: an x or a y fits 11 bits.
    pub const SIDE_MAX: u16 = 2048;

    /// A sensor of `width` x `height` pixels, or `None` where a side is 0 or above
    /// [`Sensor::SIDE_MAX`].
    #[inline]
    #[must_use]
    pub const fn new(width: u16, height: u16) -> Option<Self> {
        if width == 0 || height == 0 || width > Self::SIDE_MAX || height > Self::SIDE_MAX {
            None
        } else {
            Some(Self { width, height })
        }
    }

    /// Number of pixels, at most 2^22.
    #[inline]
    #[must_use]
    pub const fn pixels(self) -> u32 {
        self.width as u32 * self.height as u32
    }

    /// Whether the sensor has a pixel (x, y).
    #[inline]
    #[must_use]
    pub const fn contains(self, x: u16, y: u16) -> bool {
        x < self.width && y < self.height
    }

    /// Number of a pixel in raster order, y * width + x.
    #[inline]
    #[must_use]
    pub const fn number(self, (x, y): (u16, u16)) -> u32 {
        y as u32 * self.width as u32 + x as u32
    }

    /// Column and row of a pixel's number; `None` beyond the last.
    #[inline]
    #[must_use]
    pub const fn pixel(self, number: u32) -> Option<(u16, u16)> {
        let width = self.width as u32;
        match (number.checked_div(width), number.checked_rem(width)) {
            (Some(y), Some(x)) if y < self.height as u32 => Some((x as u16, y as u16)),
            _ => None,
        }
    }
}
