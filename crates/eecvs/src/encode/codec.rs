//! What an encoder on the host is asked to do: the core's configuration, and the kernel.

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};

use eecvs_nostd::kernel::{Libm, Micromath, Precise, Recurrence};
use eecvs_nostd::{Config, Encoded, Kernel, NoRoom, Window, WindowEncoder};

/// Bytes of frames a second that another thread may change while windows are encoded; none: no limit.
#[derive(Debug, Default)]
pub struct Budget(AtomicU32);

impl Budget {
    /// What holds at first.
    #[must_use]
    pub fn new(bytes_per_second: Option<u32>) -> Self {
        Self(AtomicU32::new(bytes_per_second.unwrap_or(0)))
    }

    /// Holds from the next window on; less than the windows' headers take is raised to that.
    pub fn set(&self, bytes_per_second: Option<u32>) {
        self.0
            .store(bytes_per_second.unwrap_or(0), Ordering::Relaxed);
    }

    /// What holds now.
    #[must_use]
    pub fn get(&self) -> Option<NonZeroU32> {
        NonZeroU32::new(self.0.load(Ordering::Relaxed))
    }
}

/// A configuration, and the kernel of the accumulate stage.
#[derive(Debug, Clone, Copy)]
pub struct Codec<'h> {
    /// Everything that a microcontroller is asked to do as well.
    pub config: Config,
    /// Kernel of the DCT and the DTFT. The Haar transform has one alone.
    pub kernel: Kernel,
    /// Pixels that are never sent, column and row.
    pub hot: &'h [(u16, u16)],
    /// A budget that changes, in place of the configuration's; a mode that has none goes on without. One thread
    /// encodes then.
    pub budget: Option<&'h Budget>,
}

impl From<Config> for Codec<'_> {
    /// With the encoder's own kernel.
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
    /// Of the dense coder, windows after which its frames begin anew.
    pub(super) fn chained(&self) -> Option<u16> {
        let is_dense = self.config.mode.is_dense();
        is_dense.then_some(self.config.key_windows)
    }

    /// [`WindowEncoder::next_frame`] with the kernel. The encoder's own has its fast way.
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
