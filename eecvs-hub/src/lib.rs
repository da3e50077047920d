//! Transmits frames from many sensors to many machines over Zenoh.
//!
//! A sensor's [`uplink`] numbers its frames, publishes them, and keeps them for a while; a receiver's [`downlink`]
//! requests those that have not arrived. Hubs connect the two: they are Zenoh routers with a [`board`], which shows
//! what is known of the sensors.

pub mod access;
pub mod board;
pub mod budget;
pub mod certificate;
pub mod clock;
pub mod cmd;
mod command;
pub mod downlink;
pub mod frames;
pub mod hub;
pub mod key;
pub mod latency;
pub mod link;
pub mod lives;
pub mod message;
pub mod order;
pub mod simulation;
pub mod source;
pub mod store;
pub mod uplink;

pub use command::run;

/// The error of a thread that panicked.
fn panicked<T>(_: Box<dyn std::any::Any + Send>) -> anyhow::Result<T> {
    anyhow::bail!("a thread panicked: please report this")
}
