//! Fixed-point, no-heap encoder for event cameras: windows of events to transform coefficients.
//!
//! ```text
//! events -> window -> density -> regime -> group -> accumulate -> prune -> quantise -> pack -> frame
//! ```
//!
//! In mode `hybrid` the events themselves are coded ([`coder`]), in place of what follows the group.
//! A stage is a folder: `mod.rs` chooses by target among the files beside it, `portable.rs`,
//! `sse2.rs`, `avx2.rs`, `armv7em.rs`. Every buffer is lent by the caller or sits in [`Storage`]; nothing
//! allocates, nothing uses floating point on the way from an event to a frame, and the same code
//! gives the same bits on a microcontroller and on a host. Feature `defmt` derives `defmt::Format`
//! on the public types; `coefficients` and `order`, defaults, let the encoder take the adaptive coders of
//! coefficients ([`coder::coefficients`]) and [`Config::keep_order`]; `float` adds two kernels in f32 to
//! compare with ([`kernel`]); `portable` leaves assembly out, to compare with.
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

// What the stages share.
mod checksum;
pub mod event_link;
pub mod fixed_point;
mod machine;
pub mod stage;

pub use coder::key_frames::KEY_WINDOWS;
pub use coder::{Axis, Cells, Coder, Fidelity, Hybrid, Readout, Scans, Times};
pub use encoder::Encoder;
pub use encoder::config::{Config, ConfigError, HotError, Scratch, SetupError};
pub use encoder::storage::Storage;
pub use encoder::window_encoder::{Encoded, OUTPUT_BYTES_MIN, WindowEncoder};
pub use event_types::evt2;
pub use event_types::{Event, Polarity, Sensor};
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
