//! Types in which an array's numbers are stored, and the quantiser that converts to them.
//!
//! ```text
//! natural   f32
//! signed    i16 or i8 times a step of the window: its largest |value| over the type's largest number
//! levels    u16 or u8: value / largest of the definition, in equal levels from 0
//! counts    u16 or u8: the count, limited to the type's largest number
//! ```
//!
//! Decoders see only the numbers read back from the stored type.

/// Stored type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// The natural type f32, 4 bytes.
    F32,
    /// A type of 2 bytes.
    Bits16,
    /// A type of 1 byte.
    Bits8,
}

impl Stored {
    /// All stored types.
    pub const ALL: [Self; 3] = [Self::F32, Self::Bits16, Self::Bits8];

    /// Returns the name used in the rows of results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bits16 => "16 bits",
            Self::Bits8 => "8 bits",
        }
    }

    /// Returns the bytes per number.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::Bits16 => 2,
            Self::Bits8 => 1,
        }
    }
}

/// Range of a representation's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// Both signs, without a bound.
    Signed,
    /// From 0 to this number.
    UpTo(f64),
    /// Whole numbers from 0 on.
    Counts,
}

impl Range {
    /// Returns the name of the type that stores numbers of this range.
    #[must_use]
    pub const fn type_name(self, stored: Stored) -> &'static str {
        match (stored, self) {
            (Stored::F32, _) => "f32",
            (Stored::Bits16, Self::Signed) => "i16",
            (Stored::Bits8, Self::Signed) => "i8",
            (Stored::Bits16, Self::UpTo(_) | Self::Counts) => "u16",
            (Stored::Bits8, Self::UpTo(_) | Self::Counts) => "u8",
        }
    }
}

/// Quantises the numbers of one window.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantiser {
    range: Range,
    stored: Stored,
    /// Step of signed numbers in a small type.
    step: f32,
}

impl Quantiser {
    /// Makes the quantiser of a window whose largest |number| is `largest`.
    #[must_use]
    pub fn new(range: Range, stored: Stored, largest: f64) -> Self {
        let most = match stored {
            Stored::F32 => f64::INFINITY,
            Stored::Bits16 => f64::from(i16::MAX),
            Stored::Bits8 => f64::from(i8::MAX),
        };
        Self {
            range,
            stored,
            step: (largest / most) as f32,
        }
    }

    /// Returns the stored type.
    #[must_use]
    pub const fn stored(&self) -> Stored {
        self.stored
    }

    /// Returns the step of the window, if its numbers are quantised with one.
    #[must_use]
    pub fn step(&self) -> Option<f32> {
        (self.range == Range::Signed && self.stored != Stored::F32).then_some(self.step)
    }

    /// Returns the largest code of an unsigned type.
    fn levels(&self) -> f64 {
        match self.stored {
            Stored::F32 => f64::INFINITY,
            Stored::Bits16 => f64::from(u16::MAX),
            Stored::Bits8 => f64::from(u8::MAX),
        }
    }

    /// Returns the bits of a number, in the lowest bytes.
    #[must_use]
    pub fn code(&self, value: f64) -> u32 {
        if self.stored == Stored::F32 {
            return (value as f32).to_bits();
        }
        match self.range {
            Range::Signed => {
                let step = f64::from(self.step);
                let steps = if step > 0.0 {
                    (value / step).round() as i32
                } else {
                    0
                };
                if self.stored == Stored::Bits16 {
                    (steps as i16 as u16).into()
                } else {
                    (steps as i8 as u8).into()
                }
            }
            // Casts saturate.
            Range::UpTo(most) => (value / most * self.levels()).round().min(self.levels()) as u32,
            Range::Counts => value.round().min(self.levels()) as u32,
        }
    }

    /// Returns the number that the bits represent.
    #[must_use]
    pub fn value(&self, code: u32) -> f64 {
        match (self.stored, self.range) {
            (Stored::F32, _) => f32::from_bits(code).into(),
            (Stored::Bits16, Range::Signed) => f64::from(code as i16) * f64::from(self.step),
            (Stored::Bits8, Range::Signed) => f64::from(code as i8) * f64::from(self.step),
            (_, Range::UpTo(most)) => f64::from(code) / self.levels() * most,
            (_, Range::Counts) => f64::from(code),
        }
    }

    /// Returns the number after quantising.
    #[must_use]
    pub fn rounded(&self, value: f64) -> f64 {
        self.value(self.code(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_off_by_half_a_step_at_the_most() {
        for (stored, signed, unsigned) in [
            (Stored::F32, 2e-7, 2e-7),
            (Stored::Bits16, 0.5 / 32_767.0, 0.5 / 65_535.0),
            (Stored::Bits8, 0.5 / 127.0, 0.5 / 255.0),
        ] {
            let of_both = Quantiser::new(Range::Signed, stored, 3.0);
            let levels = Quantiser::new(Range::UpTo(3.0), stored, 0.0);
            for i in 0..=3000 {
                let value = 0.001 * f64::from(i);
                assert_eq!(of_both.rounded(-value), -of_both.rounded(value));
                // The step itself is rounded to f32.
                let most = 3.0 * signed + 3e-7;
                assert!((of_both.rounded(value) - value).abs() <= most, "{value}");
                let most = 3.0 * unsigned + 1e-12;
                assert!((levels.rounded(value) - value).abs() <= most, "{value}");
            }
            assert_eq!(of_both.rounded(0.0), 0.0);
            assert!(levels.code(9.0) <= levels.code(3.0) || stored == Stored::F32);
        }
    }

    #[test]
    fn counts_are_exact_until_the_type_ends() {
        let rounded = |stored, count| Quantiser::new(Range::Counts, stored, 0.0).rounded(count);
        for count in [0.0, 1.0, 255.0] {
            for stored in Stored::ALL {
                assert_eq!(rounded(stored, count), count);
            }
        }
        assert_eq!(rounded(Stored::Bits8, 256.0), 255.0);
        assert_eq!(rounded(Stored::Bits16, 70_000.0), 65_535.0);
        assert_eq!(rounded(Stored::F32, 70_000.0), 70_000.0);
    }

    #[test]
    fn a_window_of_zeros_has_no_step() {
        for stored in Stored::ALL {
            let quantiser = Quantiser::new(Range::Signed, stored, 0.0);
            assert_eq!(quantiser.rounded(0.0), 0.0);
            assert_eq!(quantiser.step().is_some(), stored != Stored::F32);
        }
    }
}
