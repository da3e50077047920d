//! What an encoder on the host is asked to do: the core's configuration, and the kernel.

use eecvs_nostd::kernel::{Libm, Micromath, Precise, Recurrence};
use eecvs_nostd::{Config, Encoded, Kernel, NoRoom, Window, WindowEncoder};

/// A configuration, and the kernel of the accumulate stage.
#[derive(Debug, Clone, Copy)]
pub struct Codec<'h> {
    /// Everything that a microcontroller is asked to do as well.
    pub config: Config,
    /// Kernel of the DCT and the DTFT. The Haar transform has one alone.
    pub kernel: Kernel,
    /// Pixels that are never sent, column and row.
    pub hot: &'h [(u16, u16)],
}

impl From<Config> for Codec<'_> {
    /// With the encoder's own kernel.
    fn from(config: Config) -> Self {
        Self {
            config,
            kernel: Kernel::Table,
            hot: &[],
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
