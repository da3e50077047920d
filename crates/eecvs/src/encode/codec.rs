//! Settings of an encoder on the host: the core's configuration, the kernel, hot pixels and a variable budget.

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};

use eecvs_nostd::kernel::{Libm, Micromath, Precise, Recurrence};
use eecvs_nostd::{Config, Encoded, Kernel, NoRoom, Window, WindowEncoder};

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
}

impl From<Config> for Codec<'_> {
    /// Uses the encoder's default kernel.
    fn from(config: Config) -> Self {
        Self {
            config,
            kernel: Kernel::Table,
            hot: &[],
            budget: None,
        }
    }
}

impl Codec<'_> {
    /// Returns the number of windows between restarts of the dense coder's frames; `None` for other coders.
    pub(super) fn chained(&self) -> Option<u16> {
        let is_dense = self.config.mode.is_dense();
        is_dense.then_some(self.config.key_windows)
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
    ) -> Result<Option<Encoded>, NoRoom> {
        match self.kernel {
            Kernel::Table | Kernel::Haar => encoder.next_frame(window, out),
            Kernel::Recurrence => encoder.next_frame_with::<Recurrence>(window, out),
            Kernel::Precise => encoder.next_frame_with::<Precise>(window, out),
            Kernel::Micromath => encoder.next_frame_with::<Micromath>(window, out),
            Kernel::Libm => encoder.next_frame_with::<Libm>(window, out),
        }
    }
}
