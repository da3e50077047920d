//! Configuration of an encoder, as a packet's body.

use core::num::NonZeroU32;

use serde::{Deserialize, Serialize};

use super::{Refusal, TooLong, parse_body, write_body};
use crate::coder::{Axis, Coder, Fidelity, Hybrid, Readout};
use crate::encoder::config::Config;
use crate::frame::Mode;
use crate::quantise::Quantiser;
use crate::regime::Thresholds;
use crate::transform::Transform;
use crate::window::WindowConfig;
use crate::window::filter::{Filter, Region};
use event_types::Sensor;

/// Configuration that a [`super::Kind::Setup`] packet carries, written by postcard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Setup {
    /// Columns of the sensor.
    pub width: u16,
    /// Rows of the sensor.
    pub height: u16,
    /// Duration T of a window in microseconds.
    pub window_us: u32,
    /// tau_low, in 10^-12 events per pixel per second.
    pub tau_low_pico: u64,
    /// tau_high in the same unit.
    pub tau_high_pico: u64,
    /// Code of the transform; 255 for the regime's.
    pub transform: u8,
    /// Number of coefficients kept: M.
    pub m: u8,
    /// Size of the grid, K; 0 for the transform's default.
    pub grid: u16,
    /// log2 of the quantiser's step.
    pub step_log2: i8,
    /// Mode of the frames, as the low four bits of a frame's mode byte.
    pub mode: u8,
    /// Tolerance or width in microseconds, or number of bins; [`Config::max_emd_us`] in a lossless mode; 0 for other
    /// modes.
    pub fidelity: u32,
    /// Number of windows after which the dense coder begins anew.
    pub key_windows: u16,
    /// First column, first row, columns and rows of the region that is sent; 0 columns for all.
    pub region: [u16; 4],
    /// Sum of [`Setup::ISOLATED`], [`Setup::FEW_AS_TIMES`] and [`Setup::QUICK`], where they apply.
    pub options: u8,
    /// Most bytes that the frames of any second take; 0 for no limit.
    pub bytes_per_second: u32,
    /// Period of the readout in 2^-16 us; 0 for a sensor that does not scan.
    pub scan_period_q16: u32,
    /// Time from line to line of the readout, in 2^-16 us.
    pub scan_slope_q16: i32,
    /// Lines that are read at once: 0 columns, 1 rows.
    pub scan_axis: u8,
    /// Time in microseconds that time 0 of the words stands for.
    pub time_base_us: u64,
    /// What happens to events while no window is free: 0 they wait, so that the link's flow control holds the
    /// sender; 1 they are dropped and counted, as for a sensor that cannot be held.
    pub when_full: u8,
}

impl Setup {
    const AUTO: u8 = 255;
    /// [`Setup::options`]: isolated events are not sent.
    pub const ISOLATED: u8 = 1;
    /// [`Setup::options`]: [`Config::few_as_times`].
    pub const FEW_AS_TIMES: u8 = 1 << 1;
    /// [`Setup::options`]: of the coders that share a mode, the quick one.
    pub const QUICK: u8 = 1 << 2;
    const OPTIONS: u8 = Self::ISOLATED + Self::FEW_AS_TIMES + Self::QUICK;
    /// [`Setup::when_full`]: events wait.
    pub const WAIT: u8 = 0;
    /// [`Setup::when_full`]: events are dropped and counted.
    pub const DROP: u8 = 1;

    /// Returns the setup of a configuration, for words whose times count from `time_base_us`; events wait when no
    /// window is free.
    #[must_use]
    pub fn new(config: &Config, time_base_us: u64) -> Self {
        let (mode, fidelity) = config.mode.code();
        Self {
            width: config.window.sensor.width,
            height: config.window.sensor.height,
            window_us: config.window.window_us,
            tau_low_pico: config.thresholds.tau_low_pico(),
            tau_high_pico: config.thresholds.tau_high_pico(),
            transform: config
                .transform
                .map_or(Self::AUTO, |transform| transform as u8),
            m: config.m,
            grid: config.grid.unwrap_or(0),
            step_log2: config.quantiser.step_log2(),
            mode,
            fidelity: fidelity.unwrap_or(config.max_emd_us.map_or(0, NonZeroU32::get)),
            key_windows: config.key_windows,
            region: config.filter.region.map_or([0; 4], |region| {
                [region.x, region.y, region.width, region.height]
            }),
            options: u8::from(config.filter.isolated) * Self::ISOLATED
                + u8::from(config.few_as_times) * Self::FEW_AS_TIMES
                + u8::from(config.mode.keeps_arrival()) * Self::QUICK,
            bytes_per_second: config.bytes_per_second.map_or(0, NonZeroU32::get),
            scan_period_q16: config.readout.map_or(0, Readout::period_q16),
            scan_slope_q16: config.readout.map_or(0, Readout::slope_q16),
            scan_axis: match config.readout.map(Readout::axis) {
                None | Some(Axis::Columns) => 0,
                Some(Axis::Rows) => 1,
            },
            time_base_us,
            when_full: Self::WAIT,
        }
    }

    /// Writes the setup as a packet's body to the start of `out` and returns its length in bytes.
    ///
    /// # Errors
    /// [`TooLong`] if `out` is too short; [`super::FIELDS_BYTES_MAX`] bytes suffice.
    pub fn write(&self, out: &mut [u8]) -> Result<usize, TooLong> {
        write_body(self, out)
    }

    /// Reads a packet's body; `None` if it is not a setup.
    #[must_use]
    pub fn parse(body: &[u8]) -> Option<Self> {
        parse_body(body)
    }

    /// Returns the configuration. M and K are checked only by the encoder.
    ///
    /// # Errors
    /// A [`Refusal`] that names the first field that is out of its range.
    pub fn config(&self) -> Result<Config, Refusal> {
        if self.when_full > Self::DROP || self.options > Self::OPTIONS {
            return Err(Refusal::Flag);
        }
        let [x, y, width, height] = self.region;
        let region = Region {
            x,
            y,
            width,
            height,
        };
        let mut mode = Mode::from_code(self.mode, self.fidelity).ok_or(Refusal::Mode)?;
        if self.options & Self::QUICK != 0 {
            match &mut mode {
                Mode::Hybrid(Hybrid {
                    coder: coder @ Coder::Tree(_),
                    fidelity: Fidelity::Lossless,
                }) => *coder = Coder::Quick,
                _ => return Err(Refusal::Mode),
            }
        }
        Ok(Config {
            window: WindowConfig::new(
                Sensor::new(self.width, self.height).ok_or(Refusal::Sensor)?,
                self.window_us,
            ),
            thresholds: Thresholds::new(self.tau_low_pico, self.tau_high_pico)
                .ok_or(Refusal::Thresholds)?,
            transform: match self.transform {
                Self::AUTO => None,
                code => Some(Transform::from_code(code).ok_or(Refusal::Transform)?),
            },
            m: self.m,
            grid: (self.grid > 0).then_some(self.grid),
            quantiser: Quantiser::new(self.step_log2).ok_or(Refusal::Step)?,
            few_as_times: self.options & Self::FEW_AS_TIMES != 0,
            max_emd_us: NonZeroU32::new(self.fidelity).filter(|_| mode.is_lossless()),
            mode,
            key_windows: self.key_windows,
            readout: self.readout()?,
            filter: Filter {
                region: (width > 0).then_some(region),
                isolated: self.options & Self::ISOLATED != 0,
            },
            bytes_per_second: NonZeroU32::new(self.bytes_per_second),
            keep_order: false,
        })
    }

    fn readout(&self) -> Result<Option<Readout>, Refusal> {
        let axis = match self.scan_axis {
            0 => Axis::Columns,
            1 => Axis::Rows,
            _ => return Err(Refusal::Readout),
        };
        if self.scan_period_q16 == 0 {
            return Ok(None);
        }
        Readout::new(axis, self.scan_period_q16, self.scan_slope_q16)
            .map(Some)
            .ok_or(Refusal::Readout)
    }
}

#[cfg(test)]
mod tests {
    use super::super::FIELDS_BYTES_MAX;
    use super::*;

    #[test]
    fn setups_return_or_are_refused() {
        let setup = Setup {
            width: 320,
            height: 320,
            window_us: 32_768,
            tau_low_pico: 1,
            tau_high_pico: u64::MAX,
            transform: 255,
            m: 16,
            grid: 0,
            step_log2: -6,
            mode: 0,
            fidelity: 0,
            key_windows: 64,
            region: [3, 4, 100, 2],
            options: Setup::ISOLATED + Setup::FEW_AS_TIMES,
            bytes_per_second: u32::MAX,
            scan_period_q16: 250 << 16,
            scan_slope_q16: -(125 << 16),
            scan_axis: 1,
            time_base_us: u64::MAX,
            when_full: Setup::WAIT,
        };
        let mut out = [0; FIELDS_BYTES_MAX];
        let len = setup.write(&mut out).unwrap();
        assert_eq!(Setup::parse(&out[..len]), Some(setup));
        assert_eq!(Setup::parse(&out[..=len]), None);
        assert_eq!(Setup::parse(&out[..len - 1]), None);
        assert_eq!(Setup::new(&setup.config().unwrap(), u64::MAX), setup);
        let still = Setup {
            scan_period_q16: 0,
            scan_slope_q16: 0,
            scan_axis: 0,
            ..setup
        };
        assert_eq!(Setup::new(&still.config().unwrap(), u64::MAX), still);
        // FAST, lossless: the value is a mean error. With a tolerance, or as coefficients, it is not.
        let mean = Setup {
            mode: 1,
            fidelity: 300,
            options: 0,
            ..setup
        };
        assert_eq!(
            mean.config().unwrap().max_emd_us.map(NonZeroU32::get),
            Some(300)
        );
        assert_eq!(Setup::new(&mean.config().unwrap(), u64::MAX), mean);
        for mode in [0, 1 | 1 << 2] {
            let other = Setup { mode, ..mean };
            assert_eq!(other.config().unwrap().max_emd_us, None);
        }
        let quick = Setup {
            mode: 3,
            options: Setup::QUICK,
            ..setup
        };
        assert!(quick.config().unwrap().mode.keeps_arrival());
        assert_eq!(Setup::new(&quick.config().unwrap(), u64::MAX), quick);
        let tolerant = Setup { mode: 7, ..quick };
        assert_eq!(tolerant.config(), Err(Refusal::Mode));
        let is = |change: fn(&mut Setup), refusal| {
            let mut wrong = setup;
            change(&mut wrong);
            assert_eq!(wrong.config(), Err(refusal), "{wrong:?}");
        };
        is(|s| s.width = 0, Refusal::Sensor);
        is(|s| s.height = 2049, Refusal::Sensor);
        is(
            |s| (s.tau_low_pico, s.tau_high_pico) = (2, 1),
            Refusal::Thresholds,
        );
        is(|s| s.transform = 3, Refusal::Transform);
        is(|s| s.step_log2 = 9, Refusal::Step);
        is(|s| s.mode = 15, Refusal::Mode);
        is(|s| s.when_full = 2, Refusal::Flag);
        is(|s| s.options = 8, Refusal::Flag);
        is(|s| s.options = Setup::QUICK, Refusal::Mode);
        is(|s| s.scan_axis = 2, Refusal::Readout);
        is(|s| s.scan_period_q16 = 1, Refusal::Readout);
        is(|s| s.scan_slope_q16 = i32::MIN, Refusal::Readout);
    }

    #[test]
    fn the_longest_setup_fits() {
        let longest = Setup {
            width: u16::MAX,
            height: u16::MAX,
            window_us: u32::MAX,
            tau_low_pico: u64::MAX,
            tau_high_pico: u64::MAX,
            transform: u8::MAX,
            m: u8::MAX,
            grid: u16::MAX,
            step_log2: i8::MAX,
            mode: u8::MAX,
            fidelity: u32::MAX,
            key_windows: u16::MAX,
            region: [u16::MAX; 4],
            options: u8::MAX,
            bytes_per_second: u32::MAX,
            scan_period_q16: u32::MAX,
            scan_slope_q16: i32::MIN,
            scan_axis: u8::MAX,
            time_base_us: u64::MAX,
            when_full: u8::MAX,
        };
        let mut out = [0; FIELDS_BYTES_MAX];
        let len = longest.write(&mut out).unwrap();
        assert_eq!(Setup::parse(&out[..len]), Some(longest));
    }
}
