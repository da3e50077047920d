//! The events themselves in few bits: what `hybrid` frames hold.

pub mod cells;
pub mod content;
pub mod dense;
pub mod fast;
pub mod range;
