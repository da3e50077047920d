//! Fixed-point, no-heap encoder for event cameras: turns windows of events into transform coefficients.
//!
//! ```text
//! events -> window -> density -> regime -> group -> accumulate -> prune -> quantise -> pack -> frame
//! ```
//!
//! In mode `hybrid` the events themselves are coded ([`coder`]); this replaces the stages after `group`.
//!
//! Every buffer is lent by the caller or lies in [`Storage`]: nothing allocates. No step from an event to a frame
//! uses floating point, and a microcontroller and a host produce the same bits.
//!
//! A stage is a folder. Its `mod.rs` selects the implementation for the target from the files beside it:
//! `portable.rs`, `sse2.rs`, `avx2.rs` or `armv7em.rs`.
//!
//! Cargo features:
//!
//! - `coefficients` (default): the encoder can use the adaptive coefficient coders ([`coder::coefficients`]).
//! - `dense` (default): the encoder can use the dense coder ([`coder::dense`]).
//! - `keys` (default): the encoder can use the keys coder ([`coder::keys`]).
//! - `order` (default): the encoder supports [`Config::keep_order`].
//! - `quick` (default): the encoder can use the quick coder ([`coder::quick`]).
//! - `transform` (default): the encoder has mode `transform`, without which it codes events only.
//! - `tree` (default): the encoder can use the tree coder ([`coder::tree`]).
//! - `defmt`: derives `defmt::Format` on the public types.
//! - `float`: adds two f32 kernels for comparison ([`kernel`]).
//! - `portable`: replaces assembly with plain Rust, for comparison.
#![no_std]

#[cfg(test)]
extern crate std;

// In the order of the data flow.
pub mod accumulate;
pub mod coder;
pub mod encoder;
pub mod frame;
mod fused;
pub mod group;
pub mod ingest;
pub mod kernel;
pub mod pack;
pub mod prune;
pub mod quantise;
pub mod regime;
pub mod transform;
pub mod window;

// Shared by the stages.
mod checksum;
pub mod event_link;
pub mod fixed_point;
mod machine;
pub mod stage;

pub use coder::key_frames::KEY_WINDOWS;
pub use coder::{Axis, Cells, Coder, Effort, Fidelity, Hybrid, Readout, Scans, Times};
pub use encoder::Encoder;
pub use encoder::config::{Config, ConfigError, HotError, Scratch, SetupError};
pub use encoder::storage::Storage;
pub use encoder::window_encoder::{Encoded, OUTPUT_BYTES_MIN, WindowEncoder};
pub use event_types::{Event, Polarity, Sensor};
pub use event_types::{aer, evt2, evt21};
pub use frame::stream::{Order, Scan, Sequence, scan};
pub use frame::{FRAME_BYTES_MAX, Frame, FrameError, Header, Mode, NoRoom, OrderSection};
pub use kernel::Kernel;
pub use pack::descriptor::{Coded, Descriptor};
pub use pack::unpack::UnpackError;
pub use quantise::{Level, Quantiser};
pub use regime::density::Density;
pub use regime::{Regime, Thresholds};
pub use stage::{Stage, Trace};
pub use transform::Transform;
pub use transform::shape::{Packing, Shape};
pub use window::filter::{Filter, Region};
pub use window::{
    Closed, Counts, Head, NextStart, Push, Slot, Taken, Window, WindowBuffers, WindowConfig,
    bitmap_words, segments,
};
