//! Fixed-point, no-heap encoder for event cameras.
#![no_std]

pub mod event;

pub use event::{Event, Polarity, Sensor};
