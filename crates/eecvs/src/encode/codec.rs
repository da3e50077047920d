//! Settings of an encoder on the host: the core's configuration, the kernel, hot pixels and a variable budget.

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use eecvs_nostd::kernel::{Libm, Micromath, Precise, Recurrence};
use eecvs_nostd::{Config, Encoded, Kernel, NoRoom, Window, WindowEncoder};
use event_types::ensure;
use event_types::stream::Result;

use super::volume_error::VolumeError;

/// A budget in bytes of frames per second that another thread may change during encoding; `None` means no limit.
#[derive(Debug, Default)]
pub struct Budget(AtomicU32);

impl Budget {
    /// Creates a budget with its initial value.
    #[must_use]
    pub fn new(bytes_per_second: Option<u32>) -> Self {
        Self(AtomicU32::new(bytes_per_second.unwrap_or(0)))
    }

    /// Sets the budget from the next window on; a value below the size of the windows' headers is raised to that
    /// size.
    pub fn set(&self, bytes_per_second: Option<u32>) {
        self.0
            .store(bytes_per_second.unwrap_or(0), Ordering::Relaxed);
    }

    /// Returns the current budget.
    #[must_use]
    pub fn get(&self) -> Option<NonZeroU32> {
        NonZeroU32::new(self.0.load(Ordering::Relaxed))
    }
}

/// A configuration of the encoder, with the kernel of the accumulate stage.
#[derive(Debug, Clone, Copy)]
pub struct Codec<'h> {
    /// Configuration of the core, the same as on a microcontroller.
    pub config: Config,
    /// Kernel of the DCT and the DTFT; the Haar transform has only one kernel.
    pub kernel: Kernel,
    /// Pixels that are never sent, as (column, row).
    pub hot: &'h [(u16, u16)],
    /// A variable budget that replaces that of the configuration; modes without a budget ignore it. It restricts
    /// encoding to one thread.
    pub budget: Option<&'h Budget>,
    /// The largest error of a window's smoothed volume, as [`super::volume_error`] has it, in mode hybrid: every window
    /// gets the largest tolerance found for it. Frames coded by scans have exact times in any case.
    pub max_nmse: Option<f64>,
}

impl From<Config> for Codec<'_> {
    /// Uses the encoder's default kernel.
    fn from(config: Config) -> Self {
        Self {
            config,
            kernel: Kernel::Table,
            hot: &[],
            budget: None,
            max_nmse: None,
        }
    }
}

impl Codec<'_> {
    /// Returns the number of windows between restarts of the dense coder's frames; `None` for other coders.
    pub(super) fn chained(&self) -> Option<u16> {
        let is_dense = self.config.mode.is_dense();
        is_dense.then_some(self.config.key_windows)
    }

    /// Returns what sets the tolerance of each window, if that is asked for.
    pub(super) fn chooser(&self) -> Chooser {
        Chooser(self.max_nmse.map(VolumeError::new))
    }

    /// Calls [`WindowEncoder::next_frame`] with the selected kernel; the default kernel takes the encoder's own
    /// fast path.
    ///
    /// # Errors
    /// [`NoRoom`].
    pub(super) fn next_frame(
        &self,
        encoder: &mut WindowEncoder<'_>,
        window: &mut Window<'_>,
        out: &mut [u8],
    ) -> std::result::Result<Option<Encoded>, NoRoom> {
        match self.kernel {
            Kernel::Table | Kernel::Haar => encoder.next_frame(window, out),
            Kernel::Recurrence => encoder.next_frame_with::<Recurrence>(window, out),
            Kernel::Precise => encoder.next_frame_with::<Precise>(window, out),
            Kernel::Micromath => encoder.next_frame_with::<Micromath>(window, out),
            Kernel::Libm => encoder.next_frame_with::<Libm>(window, out),
        }
    }
}

/// Sets the tolerance of each window, if [`Codec::max_nmse`] asks for that.
#[derive(Debug)]
pub(super) struct Chooser(Option<VolumeError>);

impl Chooser {
    /// Sets the tolerance of a closed window, before its first frame; adds the time taken to `busy`.
    ///
    /// # Errors
    /// The mode or the coder has no tolerance; the system refuses the memory.
    pub fn choose(
        &mut self,
        encoder: &mut WindowEncoder<'_>,
        window: &mut Window<'_>,
        busy: &mut Duration,
    ) -> Result<()> {
        let Some(volume_error) = &mut self.0 else {
            return Ok(());
        };
        let started = Instant::now();
        encoder.filter(window);
        let chosen = encoder.set_tolerance(volume_error.tolerance_us(window)?);
        *busy += started.elapsed();
        ensure!(
            chosen.is_ok(),
            Refused,
            "a largest error of the volume is possible only in mode hybrid, by a coder with a tolerance, and without a \
             largest mean error"
        );
        Ok(())
    }
}
