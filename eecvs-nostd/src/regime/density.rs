//! Event density of a window.

/// rho = N_w / (H W T) (eq. 1), held as the integers it is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Density {
    /// N_w.
    pub events: u32,
    /// H W.
    pub pixels: u32,
    /// T in microseconds.
    pub duration_us: u32,
}

impl Density {
    /// Units of a threshold in one event per pixel per second: 10^12.
    pub const PICO: u64 = 1_000_000_000_000;

    /// rho < `tau_pico` * 10^-12 events per pixel per second, exactly:
    /// N_w 10^6 10^12 < tau H W T, in 128 bits, which no window can overflow.
    #[must_use]
    pub const fn is_below(self, tau_pico: u64) -> bool {
        let events = self.events as u128 * (1_000_000 * Self::PICO as u128);
        events < tau_pico as u128 * (self.pixels as u64 * self.duration_us as u64) as u128
    }

    /// rho in events per pixel per second, for reports.
    #[must_use]
    pub fn per_pixel_s(self) -> f64 {
        f64::from(self.events) * 1e6 / (f64::from(self.pixels) * f64::from(self.duration_us))
    }
}
