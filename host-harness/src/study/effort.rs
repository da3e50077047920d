//! How much a study measures.

use eecvs::reconstruct::events::Finder;
use eecvs_nostd::{Coder, Fidelity, Transform};

use super::method::Method;
use crate::baseline::{Baseline, Stored};
use crate::selection::settings::Setting;

/// M of Table I.
pub const M: u8 = 16;
/// M of Table III.
pub const M_SPEED: u8 = 8;
/// Mean error of the events with coarse times in Table I, in us.
pub const MEAN_ERROR_US: u32 = 128;
/// M of Tables II, IV and V.
pub const M_ALL: [u8; 3] = [8, 16, 24];

/// Sizes of the sources, and the settings that are measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effort {
    /// `full` or `quick`.
    pub name: &'static str,
    /// Duration of an emulated scene in us.
    pub scene_us: u64,
    /// A recording is cut after the last whole window with which it has at most this many events; a source has at
    /// least one window.
    pub events_max: usize,
    /// M of the tables.
    pub m: &'static [u8],
    /// Further M of the rate-distortion curves.
    pub m_curve: &'static [u8],
    /// Time tolerances of the curves, in us.
    pub tolerances_us: &'static [u32],
    /// Bins of the curves.
    pub bins: &'static [u16],
    /// Mean errors of times that events are coded with, in us.
    pub mean_errors_us: &'static [u32],
    /// Transforms and M of coefficients by coarse steps; `None` chooses by density.
    pub coarse: &'static [(Option<Transform>, &'static [u8])],
    /// These steps, as powers of two.
    pub steps_log2: &'static [i8],
    /// Time spent on each measurement of speed, in seconds.
    pub speed_s: f64,
}

impl Effort {
    /// The effort for published figures.
    pub const FULL: Self = Self {
        name: "full",
        scene_us: 10 * 32_768,
        events_max: 100_000,
        m: &M_ALL,
        m_curve: &[2, 4],
        tolerances_us: &[10, 50, 100, 200, 300, 500, 1000, 4000],
        bins: &[4, 8, 16],
        mean_errors_us: &[8, 32, MEAN_ERROR_US, 512, 1024, 2048, 4096, 8192],
        coarse: &[
            (Some(Transform::Dct), &[2, 4, 24]),
            (Some(Transform::Dtft), &[4, 16]),
            (Some(Transform::Dwt), &[2, 4, 8, 16, 32]),
            (None, &[4, 16]),
        ],
        steps_log2: &[-4, -1, 1],
        speed_s: 3.0,
    };
    /// The effort for a first look: three windows of each scene.
    pub const QUICK: Self = Self {
        name: "quick",
        scene_us: 3 * 32_768,
        events_max: 50_000,
        m: &[8, 16],
        m_curve: &[4],
        tolerances_us: &[50, 1000],
        bins: &[8],
        mean_errors_us: &[MEAN_ERROR_US, 512, 2048],
        coarse: &[(Some(Transform::Dct), &[2]), (Some(Transform::Dwt), &[4])],
        steps_log2: &[1],
        speed_s: 0.5,
    };

    /// Returns every method with which a source is encoded and decoded.
    #[must_use]
    pub fn methods(&self) -> Vec<Method> {
        let mut methods = Vec::new();
        let hybrid = |coder, fidelity| Method::Hybrid { coder, fidelity };
        methods.push(hybrid(Coder::Fast, Fidelity::Lossless));
        methods.push(hybrid(Coder::Dense, Fidelity::Lossless));
        for tolerance_us in self.tolerances_us {
            methods.push(hybrid(Coder::Dense, Fidelity::ToleranceUs(*tolerance_us)));
        }
        for bins in self.bins {
            methods.push(hybrid(Coder::Dense, Fidelity::Bins(*bins)));
        }
        let mean_errors = self.mean_errors_us.iter();
        methods.extend(mean_errors.map(|most_us| Method::MeanError { most_us: *most_us }));
        let transforms = Transform::ALL.into_iter().map(Some).chain([None]);
        for transform in transforms {
            for m in self.m {
                for finder in [Finder::Exact, Finder::Peaks] {
                    methods.push(Method::Transform {
                        transform,
                        m: *m,
                        finder,
                    });
                }
            }
            // The choice by density is a row of the tables; its curve would lie between those of the three
            // transforms.
            for m in self.m_curve.iter().filter(|_| transform.is_some()) {
                let finder = Finder::Exact;
                methods.push(Method::Transform {
                    transform,
                    m: *m,
                    finder,
                });
            }
        }
        for (transform, m) in self.coarse {
            for m in *m {
                let settings = self.steps_log2.iter().map(|step_log2| Setting {
                    transform: *transform,
                    m: *m,
                    step_log2: *step_log2,
                });
                methods.extend(settings.map(Method::Coarse));
            }
        }
        for baseline in Baseline::ALL {
            let has_channels = !matches!(baseline, Baseline::EventFrame | Baseline::TimeSurface);
            let channels = if has_channels { self.m } else { &[2] };
            for m in channels {
                for stored in [Stored::F32, Stored::Bits8] {
                    methods.push(Method::Baseline {
                        baseline,
                        m: *m,
                        stored,
                    });
                }
            }
        }
        methods
    }
}
