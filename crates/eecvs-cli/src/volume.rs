//! The flags of dense volumes, shared by `eecvs decode` and the ROS node `decode`.

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use eecvs::reconstruct::volume::{Channels, Form, Weights};

/// Form of a volume.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct VolumeOptions {
    /// Use B time bins instead of coefficients: from frames with events, the exact sums of polarities per pixel and
    /// bin; from frames with coefficients, the inverse transform
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u16).range(1..=4096))]
    bins: Option<u16>,

    /// With --bins: how an event is distributed over the bins
    #[arg(
        long,
        value_enum,
        value_name = "HOW",
        default_value = "nearest",
        requires = "bins"
    )]
    voxel: Voxel,

    /// With --bins: one channel per bin with ON minus OFF, or B channels for ON followed by B for OFF events
    #[arg(
        long,
        value_enum,
        value_name = "HOW",
        default_value = "signed",
        requires = "bins"
    )]
    polarity: Polarity,

    /// Scaling of the non-zero values of a volume
    #[arg(long, value_enum, value_name = "HOW", default_value = "none")]
    normalise: Normalise,
}

/// How an event is distributed over the bins, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Voxel {
    /// 1 to the bin that contains its time
    #[default]
    Nearest,
    /// Split between the two bins nearest to its time: max(0, 1 - |b - (B - 1) (t - t0) / T|)
    Bilinear,
}

/// How polarities are represented, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Polarity {
    /// ON counts 1, OFF -1
    #[default]
    Signed,
    /// Separate channels for ON and OFF, both positive
    Split,
}

/// How values are scaled, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Normalise {
    /// Unchanged
    #[default]
    None,
    /// To a mean of 0 and a standard deviation of 1
    MeanStd,
}

impl VolumeOptions {
    /// Refuses volume flags where no volume is made.
    ///
    /// # Errors
    /// A flag has a value other than its default.
    pub fn refuse(&self) -> Result<()> {
        ensure!(
            self.form() == Self::default().form(),
            "--bins, --voxel, --polarity and --normalise are for --volume"
        );
        Ok(())
    }

    /// Returns the form of the volume.
    #[must_use]
    pub fn form(self) -> Form {
        Form {
            channels: match self.bins {
                None => Channels::Coefficients,
                Some(count) => Channels::Bins {
                    count,
                    weights: match self.voxel {
                        Voxel::Nearest => Weights::Nearest,
                        Voxel::Bilinear => Weights::Bilinear,
                    },
                    split: self.polarity == Polarity::Split,
                },
            },
            normalised: self.normalise == Normalise::MeanStd,
        }
    }
}
