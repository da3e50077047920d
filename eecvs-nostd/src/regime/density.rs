//! Event density of a window (eq. 1).

/// The event density rho = N_w / (H W T) (eq. 1), held as integers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Density {
    /// N_w, the number of events in the window.
    pub events: u32,
    /// H W, the number of pixels of the sensor.
    pub pixels: u32,
    /// T, the duration of the window in microseconds.
    pub duration_us: u32,
}

impl Density {
    /// Number of threshold units in one event per pixel per second: 10^12.
    pub const PICO: u64 = 1_000_000_000_000;

    /// Returns whether rho < `tau_pico` * 10^-12 events per pixel per second. Exact: compares N_w 10^6 10^12 with
    /// tau H W T in 128 bits, which no window can overflow.
    #[must_use]
    pub const fn is_below(self, tau_pico: u64) -> bool {
        let events = self.events as u128 * (1_000_000 * Self::PICO as u128);
        events < tau_pico as u128 * (self.pixels as u64 * self.duration_us as u64) as u128
    }

    /// Returns rho in events per pixel per second, for reports.
    #[must_use]
    pub fn per_pixel_s(self) -> f64 {
        f64::from(self.events) * 1e6 / (f64::from(self.pixels) * f64::from(self.duration_us))
    }
}
