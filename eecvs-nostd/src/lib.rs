//! Fixed-point, no-heap encoder for event cameras: windows of events to transform coefficients.
//!
//! ```text
//! events -> window -> density -> regime -> group -> accumulate -> prune -> quantise -> pack -> frame
//! ```
//!
//! In mode `hybrid` the events themselves are coded ([`coder`]), in place of what follows the group.
//! One stage, one file. Every buffer is lent by the caller or sits in [`Storage`]; nothing
//! allocates, nothing uses floating point on the way from an event to a frame, and the same code
//! gives the same bits on a microcontroller and on a host. Feature `defmt` derives `defmt::Format`
//! on the public types; `coefficients` and `order`, defaults, let the encoder take the adaptive coders of
//! coefficients ([`coder::coefficients`]) and [`Config::keep_order`]; `float` adds two kernels in f32 to
//! compare with ([`kernel`]); `portable` leaves assembly out, to compare with.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod arrival;
pub mod atom;
pub mod bits;
mod checksum;
#[cfg(any(test, eecvs_dsp))]
mod checksum_fold;
#[cfg(eecvs_dsp)]
mod code_tables_dsp;
pub mod coder;
#[cfg(feature = "coefficients")]
mod coefficient_encoder;
pub mod config;
pub mod density;
pub mod descriptor;
pub mod encoder;
pub mod event;
mod event_encoder;
pub mod event_link;
pub mod evt2;
#[cfg(not(any(eecvs_dsp, target_pointer_width = "64")))]
mod fast_walk;
#[cfg(eecvs_dsp)]
mod fast_walk_dsp;
pub mod filter;
pub mod fixed_point;
pub mod frame;
pub mod group;
pub mod hot_pixels;
pub mod ingest;
mod intake;
#[cfg(not(any(eecvs_intake_asm, target_pointer_width = "64")))]
mod intake_words;
pub mod kernel;
#[cfg(eecvs_dsp)]
mod lanes_dsp;
pub mod link;
pub mod link_source;
pub mod lists;
pub mod pack;
#[cfg(target_arch = "x86_64")]
mod pack_vectors;
pub mod packing;
pub mod phase;
mod pixel_encoder;
pub mod prune;
#[cfg(eecvs_dsp)]
mod prune_dsp;
pub mod quantise;
mod rate;
pub mod regime;
pub mod reorder;
#[cfg(eecvs_dsp)]
mod rows_dsp;
#[cfg(eecvs_dsp)]
mod segments_dsp;
pub mod sensor_source;
#[cfg(eecvs_dsp)]
mod seven_dsp;
mod sort;
pub mod storage;
pub mod trace;
pub mod transform;
#[cfg(eecvs_dsp)]
mod transform_walk_dsp;
#[cfg(eecvs_dsp)]
mod turn_rows_dsp;
pub mod unpack;
#[cfg(target_arch = "x86_64")]
mod waves_avx2;
#[cfg(eecvs_dsp)]
mod waves_dsp;
pub mod window;
pub mod window_encoder;

pub use coder::chain::KEY_WINDOWS;
pub use coder::{Axis, Cells, Coder, Fidelity, Hybrid, Readout, Scans, Times};
pub use config::{Config, ConfigError, HotError, Scratch, SetupError};
pub use density::Density;
pub use descriptor::{Coded, Descriptor};
pub use encoder::Encoder;
pub use event::{Event, Polarity, Sensor};
pub use filter::{Filter, Region};
pub use frame::{FRAME_BYTES_MAX, Frame, FrameError, Header, Mode, NoRoom, OrderSection};
pub use kernel::Kernel;
pub use link::{Order, Scan, Sequence, scan};
pub use packing::{Packing, Shape};
pub use quantise::{Level, Quantiser};
pub use regime::{Regime, Thresholds};
pub use storage::Storage;
pub use trace::{Stage, Trace};
pub use transform::Transform;
pub use unpack::UnpackError;
pub use window::{
    Closed, Counts, Head, NextStart, Push, Slot, Taken, Window, WindowBuffers, WindowConfig,
    bitmap_words, segments,
};
pub use window_encoder::{Encoded, OUTPUT_BYTES_MIN, WindowEncoder};
