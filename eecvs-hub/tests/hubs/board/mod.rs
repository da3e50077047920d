//! A board that is fed with frames of emulated scenes: what it tells of them, by rows, metrics, pictures and HTTP.

mod bounds;
mod http;
mod metrics;
mod pictures;
mod rows;

use eecvs_nostd::{Coder, Fidelity, Mode};

/// Events themselves, by the fast coder.
const EXACT: Mode = crate::feed::events(Coder::Fast, Fidelity::Lossless);
