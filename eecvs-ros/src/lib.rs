//! ROS 2 nodes around the encoder. They need no installation of ROS.
//!
//! [`node`] contains the nodes, [`transport`] the layers that carry their messages, [`message`] the messages
//! themselves, and [`operator`] the interface for coders, which turn events into frames and back. [`run`] is the
//! command `eecvs-ros`, optionally with operators from another crate.

pub mod arguments;
pub mod bag;
mod command;
pub mod message;
pub mod names;
pub mod node;
pub mod one_publisher;
pub mod operator;
pub mod packet_reader;
pub mod packing;
pub mod parameters;
pub mod sequence;
pub mod transport;

pub use command::run;
