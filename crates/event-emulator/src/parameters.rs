//! The parameters of a pixel in model 2, each with its unit, range, default and source.

use event_types::stream::Result;
use event_types::{bail, ensure};

/// A parameter of [`PixelParameters`] or of another structure, for command lines, files and documents.
#[derive(Debug, Clone, Copy)]
pub struct Parameter<P = PixelParameters> {
    /// Name, as the field and in TOML files.
    pub name: &'static str,
    /// Unit; `1` for a share or a relative value, `ln` for a difference of logarithms.
    pub unit: &'static str,
    /// Smallest value.
    pub least: f64,
    /// Largest value.
    pub most: f64,
    /// One sentence that says what it is.
    pub about: &'static str,
    /// Where the default, or the effect, comes from.
    pub source: &'static str,
    pub(crate) get: fn(&P) -> f64,
    pub(crate) set: fn(&mut P, f64),
}

impl<P> Parameter<P> {
    /// Returns the value in `parameters`.
    #[must_use]
    pub fn of(&self, parameters: &P) -> f64 {
        (self.get)(parameters)
    }
}

/// Makes a structure of numbers, each with its default, unit, range, description and source, and the table of them.
macro_rules! parameters {
    (
        $(#[$about_all:meta])* pub struct $type:ident;
        $(#[$about_table:meta])* pub const $table:ident;
        $($name:ident: $default:literal, $unit:literal, $least:literal to $most:literal, $about:literal, $source:literal;)*
    ) => {
        $(#[$about_all])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $type {
            $(#[doc = $about] #[doc = concat!("\n\nUnit ", $unit, ", ", stringify!($least), " to ", stringify!($most), ". Source: ", $source, ".")] pub $name: f64,)*
        }

        impl Default for $type {
            fn default() -> Self {
                Self { $($name: $default,)* }
            }
        }

        $(#[$about_table])*
        pub const $table: &[$crate::parameters::Parameter<$type>] = &[
            $($crate::parameters::Parameter {
                name: stringify!($name),
                unit: $unit,
                least: $least,
                most: $most,
                about: $about,
                source: $source,
                get: |parameters| parameters.$name,
                set: |parameters, value| parameters.$name = value,
            },)*
        ];
    };
}
pub(crate) use parameters;

parameters! {
    /// The pixel of model 2. Every field is a row of [`PARAMETERS`].
    pub struct PixelParameters;
    /// The parameters, in the order in which light meets them.
    pub const PARAMETERS;

    sample_change: 1.0, "1", 0.01 to 4.0,
        "Largest change of light between two samples, relative to the smaller threshold.",
        "the idea: ESIM, Rebecq 2018, with half a threshold";
    dark_lux: 0.1, "lx", 0.0 to 10_000.0,
        "Dark current at 25 °C as an illuminance; below it the response is linear.",
        "Lichtsteiner 2008: the sensor works down to 0.1 lx";
    corner_hz_per_lux: 3.0, "Hz/lx", 0.001 to 1_000_000.0,
        "First corner of the photoreceptor per lux.",
        "Lichtsteiner 2008: 3 kHz in a scene of 1 klx";
    second_corner_hz: 300.0, "Hz", 1.0 to 1_000_000.0,
        "Second corner of the photoreceptor, which its bias currents set.",
        "v2e: a cutoff of 300 Hz in good light";
    threshold_on: 0.25, "ln", 0.01 to 10.0,
        "Mean threshold of ON events.",
        "v2e and ESIM: thresholds of 0.2 to 0.3";
    threshold_off: 0.27, "ln", 0.01 to 10.0,
        "Mean threshold of OFF events.",
        "v2e and ESIM: thresholds of 0.2 to 0.3";
    threshold_spread: 0.08, "1", 0.0 to 0.3,
        "Standard deviation of the thresholds from pixel to pixel, relative to the mean.",
        "Lichtsteiner 2008: 2.1 % of contrast, 0.021 of a threshold of 0.25";
    refractory_us: 300.0, "us", 0.0 to 1_000_000.0,
        "Time after an event in which a pixel is held in reset; its reference is the output at the end.",
        "Lichtsteiner 2008: set by a bias; v2e has 500 us";
    leak_hz: 0.1, "Hz", 0.0 to 1_000.0,
        "Mean rate of ON events in constant light at 25 °C that leakage of the reset switch causes.",
        "v2e, after Nozaki and Delbruck 2017";
    leak_spread: 0.2, "1", 0.0 to 0.3,
        "Standard deviation of the leakage from pixel to pixel, relative to the mean.",
        "estimate";
    temperature_c: 25.0, "°C", -40.0 to 125.0,
        "Temperature of the chip.",
        "room temperature";
    doubling_c: 8.0, "°C", 1.0 to 100.0,
        "Warming that doubles the dark current and the leakage.",
        "usual for silicon; the effect: Nozaki and Delbruck 2017";
    parasitic_hz_per_klux: 0.1, "Hz/klx", 0.0 to 1_000.0,
        "Rate of ON events in constant light, per 1,000 lx, by the photocurrent of the reset switch.",
        "estimate; the effect: Nozaki and Delbruck 2017";
    shot_noise: 0.085, "ln", 0.0 to 1.0,
        "Standard deviation of the photoreceptor's output by shot noise where the first corner is far below the second.",
        "chosen for some 2 noise events per second in a street at night; the law: Graca and Delbruck 2021";
    latency_us: 15.0, "us", 0.0 to 10_000.0,
        "Time from a crossing to its event, beyond that of the photoreceptor.",
        "Lichtsteiner 2008: 15 us at least";
    jitter_us: 5.0, "us", 0.0 to 5_000.0,
        "Standard deviation of that time, evenly distributed; at most the latency over the square root of 3.",
        "estimate";
    hot_share: 1e-4, "1", 0.0 to 1.0,
        "Share of hot pixels, which fire by themselves at random, 9 of 10 events ON.",
        "estimate";
    hot_hz: 20.0, "Hz", 0.0 to 10_000.0,
        "Lowest rate of a hot pixel; the highest is ten times as high.",
        "estimate";
    dead_share: 0.0, "1", 0.0 to 1.0,
        "Share of dead pixels, which never fire.",
        "none by default";
    stuck_share: 0.0, "1", 0.0 to 1.0,
        "Share of stuck pixels, which fire regularly, all events of one polarity, and see nothing.",
        "none by default";
    stuck_hz: 100.0, "Hz", 0.001 to 10_000.0,
        "Rate of a stuck pixel.",
        "estimate";
}

/// A group of parameters that can be switched off together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Effect {
    /// The dark current: the response is logarithmic in any light.
    Toe,
    /// The photoreceptor's corners: both become 1 MHz, in any light.
    LowPass,
    /// The spread of thresholds and leakage over pixels.
    Spread,
    /// The refractory time.
    Refractory,
    /// Leakage, that by light included.
    Leak,
    /// Shot noise: noise events, and the noise of crossings.
    ShotNoise,
    /// Latency and jitter of the comparators.
    Jitter,
    /// Hot, dead and stuck pixels.
    Defects,
}

impl Effect {
    /// All effects, in the order in which light meets them.
    pub const ALL: [Self; 8] = [
        Self::Toe,
        Self::LowPass,
        Self::Spread,
        Self::Refractory,
        Self::Leak,
        Self::ShotNoise,
        Self::Jitter,
        Self::Defects,
    ];

    /// Returns the name on command lines and in files, for example `shot-noise`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Toe => "toe",
            Self::LowPass => "low-pass",
            Self::Spread => "spread",
            Self::Refractory => "refractory",
            Self::Leak => "leak",
            Self::ShotNoise => "shot-noise",
            Self::Jitter => "jitter",
            Self::Defects => "defects",
        }
    }

    /// Returns what happens without the effect, in one line.
    #[must_use]
    pub const fn without(self) -> &'static str {
        match self {
            Self::Toe => "No dark current: the response is logarithmic in any light",
            Self::LowPass => "No low-pass: both corners are 1 MHz in any light",
            Self::Spread => "No spread of thresholds and leakage over the pixels",
            Self::Refractory => "No refractory time",
            Self::Leak => "No leakage, nor any by light",
            Self::ShotNoise => "No shot noise: neither noise events nor noise of crossings",
            Self::Jitter => "No latency and no jitter beyond those of the photoreceptor",
            Self::Defects => "No hot, dead or stuck pixels",
        }
    }
}

impl PixelParameters {
    /// Returns a pixel without any of the effects: thresholds and a logarithm alone.
    #[must_use]
    pub fn ideal() -> Self {
        let mut ideal = Self::default();
        for effect in Effect::ALL {
            ideal.switch_off(effect);
        }
        ideal
    }

    /// Sets the parameters of an effect to values at which it does nothing.
    pub fn switch_off(&mut self, effect: Effect) {
        match effect {
            Effect::Toe => self.dark_lux = 0.0,
            Effect::LowPass => {
                // The dimmest light of a scene is far above 1e-3 lx.
                self.corner_hz_per_lux = 1e6;
                self.second_corner_hz = 1e6;
            }
            Effect::Spread => {
                self.threshold_spread = 0.0;
                self.leak_spread = 0.0;
            }
            Effect::Refractory => self.refractory_us = 0.0,
            Effect::Leak => {
                self.leak_hz = 0.0;
                self.parasitic_hz_per_klux = 0.0;
            }
            Effect::ShotNoise => self.shot_noise = 0.0,
            Effect::Jitter => {
                self.latency_us = 0.0;
                self.jitter_us = 0.0;
            }
            Effect::Defects => {
                self.hot_share = 0.0;
                self.dead_share = 0.0;
                self.stuck_share = 0.0;
            }
        }
    }

    /// Sets a parameter by its name in [`PARAMETERS`].
    ///
    /// # Errors
    /// An unknown name; a value outside of the parameter's range, or none at all.
    pub fn set(&mut self, name: &str, value: f64) -> Result<()> {
        let Some(parameter) = PARAMETERS.iter().find(|parameter| parameter.name == name) else {
            let names: Vec<&str> = PARAMETERS.iter().map(|parameter| parameter.name).collect();
            bail!(
                Refused,
                "there is no parameter {name}; the parameters are {}",
                names.join(", ")
            );
        };
        (parameter.set)(self, value);
        check(parameter, value)
    }

    /// Checks that all parameters are in their ranges and agree with each other.
    ///
    /// # Errors
    /// A value outside of its range; a jitter that would have events before their crossings.
    pub fn check(&self) -> Result<()> {
        for parameter in PARAMETERS {
            check(parameter, parameter.of(self))?;
        }
        ensure!(
            self.jitter_us * 3.0_f64.sqrt() <= self.latency_us,
            Refused,
            "a jitter of {} us with a latency of {} us: events would come before their crossings; give a latency of \
             1.74 times the jitter or more",
            self.jitter_us,
            self.latency_us
        );
        ensure!(
            self.hot_share + self.dead_share + self.stuck_share <= 1.0,
            Refused,
            "the shares of hot, dead and stuck pixels have a sum above 1"
        );
        Ok(())
    }

    /// Returns how many times as large the dark current and the leakage are as at 25 °C.
    pub(crate) fn warmth(&self) -> f64 {
        libm::exp2((self.temperature_c - 25.0) / self.doubling_c)
    }

    /// Returns the dark current at the temperature, in lux.
    #[must_use]
    pub fn dark_now_lux(&self) -> f64 {
        self.dark_lux * self.warmth()
    }

    /// Returns the corner frequency in Hz at which the response to small changes in light of `lux` is lower by 3 dB:
    /// that of both poles together.
    #[must_use]
    pub fn corner_hz(&self, lux: f64) -> f64 {
        // 1/2 = 1 / ((1 + f^2/f1^2) (1 + f^2/f2^2)), solved for f^2.
        let first = self.corner_hz_per_lux * (lux + self.dark_now_lux());
        let (p, q) = (first * first, self.second_corner_hz * self.second_corner_hz);
        let half = 0.5 * (p + q);
        // Without a difference of large numbers.
        let square = p * q / (half + (half * half + p * q).sqrt());
        square.sqrt()
    }

    /// Returns the standard deviation of the photoreceptor's output in light of `lux`, in natural log units.
    #[must_use]
    pub fn noise_rms(&self, lux: f64) -> f64 {
        let first = self.corner_hz_per_lux * (lux + self.dark_now_lux());
        self.shot_noise / (1.0 + first / self.second_corner_hz).sqrt()
    }

    /// Returns the rate of noise events in light of `lux`, in Hz, of a pixel whose thresholds are the mean ones.
    #[must_use]
    pub fn noise_hz(&self, lux: f64) -> f64 {
        let first = self.corner_hz_per_lux * (lux + self.dark_now_lux());
        let crossings = (first * self.second_corner_hz).sqrt();
        let rms = self.noise_rms(lux);
        let share = |threshold: f64| libm::exp(-threshold * threshold / (2.0 * rms * rms));
        if rms > 0.0 {
            crossings * (share(self.threshold_on) + share(self.threshold_off))
        } else {
            0.0
        }
    }

    /// Returns the mean rate of ON events by leakage in constant light of `lux`, in Hz.
    #[must_use]
    pub fn leak_now_hz(&self, lux: f64) -> f64 {
        self.leak_hz * self.warmth()
            + self.parasitic_hz_per_klux * 1e-3 * (lux + self.dark_now_lux())
    }
}

pub(crate) fn check<P>(parameter: &Parameter<P>, value: f64) -> Result<()> {
    let Parameter {
        name,
        unit,
        least,
        most,
        ..
    } = parameter;
    ensure!(
        (*least..=*most).contains(&value),
        Refused,
        "{name} is {value}; give {least} to {most} {unit}"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_and_the_ideal_pixel_are_in_their_ranges() {
        PixelParameters::default().check().unwrap();
        PixelParameters::ideal().check().unwrap();
    }

    #[test]
    fn values_out_of_range_are_errors_that_name_the_range() {
        let mut parameters = PixelParameters::default();
        for parameter in PARAMETERS {
            for value in [parameter.least, parameter.most] {
                parameters.set(parameter.name, value).unwrap();
                assert_eq!(parameter.of(&parameters), value);
            }
            for value in [f64::NAN, f64::INFINITY, -1e9, 1e9] {
                let error = parameters.set(parameter.name, value).unwrap_err();
                assert!(error.to_string().contains(parameter.name), "{error}");
            }
        }
        let error = parameters.set("moon", 1.0).unwrap_err().to_string();
        assert!(error.contains("threshold_on"), "{error}");
        let early = PixelParameters {
            latency_us: 1.0,
            jitter_us: 1.0,
            ..PixelParameters::default()
        };
        assert!(early.check().unwrap_err().to_string().contains("latency"));
    }

    #[test]
    fn the_corner_is_that_of_both_poles() {
        let pixel = PixelParameters::default();
        for lux in [0.0, 1.0, 100.0, 1e5] {
            let corner = pixel.corner_hz(lux);
            let first = pixel.corner_hz_per_lux * (lux + 0.1);
            let power = (1.0 + (corner / first).powi(2)) * (1.0 + (corner / 300.0).powi(2));
            assert!((power - 2.0).abs() < 1e-9, "{lux}: {power}");
        }
        assert!(pixel.noise_hz(5.0) > 100.0 * pixel.noise_hz(500.0));
    }
}
