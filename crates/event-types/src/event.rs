//! Events, their polarity, and the size of the sensor that they come from.

/// The sign of a brightness change: sums over events count `On` as +1 and `Off` as -1.
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
    /// Returns `On` if `bright` is true, else `Off`.
    #[inline]
    #[must_use]
    pub const fn from_bool(bright: bool) -> Self {
        if bright { Self::On } else { Self::Off }
    }

    /// Returns the polarity p of the formulas: +1 for `On`, -1 for `Off`.
    #[inline]
    #[must_use]
    pub const fn sign(self) -> i32 {
        match self {
            Self::On => 1,
            Self::Off => -1,
        }
    }
}

/// One brightness change of one pixel: an event (t, x, y, p) as a camera reports it.
///
/// `t_us` counts unsigned microseconds from any epoch; `x` runs to the right in `0..width`, `y` downwards in
/// `0..height`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
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

impl Event {
    /// An event that stands for none: for memory whose content does not count.
    pub const UNSET: Self = Self {
        t_us: 0,
        x: 0,
        y: 0,
        polarity: Polarity::Off,
    };
}

// Decoders write several at once.
const _: () = assert!(
    core::mem::offset_of!(Event, t_us) == 0
        && core::mem::offset_of!(Event, x) == 8
        && core::mem::offset_of!(Event, y) == 10
        && core::mem::offset_of!(Event, polarity) == 12
        && size_of::<Event>() == 16
);

/// The size of a sensor in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensor {
    /// Number of columns, 1 to [`Sensor::SIDE_MAX`].
    pub width: u16,
    /// Number of rows, 1 to [`Sensor::SIDE_MAX`].
    pub height: u16,
}

impl Sensor {
    /// Largest width and height: 2048, so that x and y each fit into 11 bits.
    pub const SIDE_MAX: u16 = 2048;

    /// Returns a sensor of `width` x `height` pixels, or `None` if a side is 0 or above [`Sensor::SIDE_MAX`].
    #[inline]
    #[must_use]
    pub const fn new(width: u16, height: u16) -> Option<Self> {
        if width == 0 || height == 0 || width > Self::SIDE_MAX || height > Self::SIDE_MAX {
            None
        } else {
            Some(Self { width, height })
        }
    }

    /// Returns the number of pixels, at most 2^22.
    #[inline]
    #[must_use]
    pub const fn pixels(self) -> u32 {
        self.width as u32 * self.height as u32
    }

    /// Returns whether the pixel (x, y) lies on the sensor.
    #[inline]
    #[must_use]
    pub const fn contains(self, x: u16, y: u16) -> bool {
        x < self.width && y < self.height
    }

    /// Returns a pixel's number in raster order: y * width + x.
    #[inline]
    #[must_use]
    pub const fn number(self, (x, y): (u16, u16)) -> u32 {
        y as u32 * self.width as u32 + x as u32
    }

    /// Returns column and row of the pixel with this raster-order number, or `None` if the sensor has no such
    /// pixel.
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
