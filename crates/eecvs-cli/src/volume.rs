//! The flags of dense volumes, which `eecvs decode` and the ROS node `decode` share.

use anyhow::{Result, ensure};
use clap::{Args, ValueEnum};
use eecvs::reconstruct::volume::{Channels, Form, Weights};

/// What a volume is.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct VolumeOptions {
    /// B bins in time in place of coefficients: where frames hold events, the exact sums of their polarities by pixel
    /// and bin; where they hold coefficients, the inverse transform
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u16).range(1..=4096))]
    bins: Option<u16>,

    /// With --bins: what an event adds to which bins
    #[arg(
        long,
        value_enum,
        value_name = "HOW",
        default_value = "nearest",
        requires = "bins"
    )]
    voxel: Voxel,

    /// With --bins: one channel a bin for ON minus OFF, or B channels of ON and then B of OFF events
    #[arg(
        long,
        value_enum,
        value_name = "HOW",
        default_value = "signed",
        requires = "bins"
    )]
    polarity: Polarity,

    /// Scale what is not 0 in a volume
    #[arg(long, value_enum, value_name = "HOW", default_value = "none")]
    normalise: Normalise,
}

/// What an event adds to which bins, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Voxel {
    /// 1 to the bin that its time is in
    #[default]
    Nearest,
    /// Parts of 1 to the two bins that its time is between: max(0, 1 - |b - (B - 1) (t - t0) / T|)
    Bilinear,
}

/// What becomes of polarities, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Polarity {
    /// ON counts 1, OFF -1
    #[default]
    Signed,
    /// Channels of their own, both positive
    Split,
}

/// How values are scaled, on the command line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Normalise {
    /// As they are
    #[default]
    None,
    /// To a mean of 0 and a standard deviation of 1
    MeanStd,
}

impl VolumeOptions {
    /// Refuses flags of a volume where none is made.
    ///
    /// # Errors
    /// A flag was given.
    pub fn refuse(&self) -> Result<()> {
        ensure!(
            self.form() == Self::default().form(),
            "--bins, --voxel, --polarity and --normalise are for --volume"
        );
        Ok(())
    }

    /// The volume's form.
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
