//! ROS 2 nodes around the encoder, without an installation of ROS.
//!
//! [`node`] has the nodes, [`transport`] what carries their messages, [`message`] these themselves, [`operator`] what
//! turns events into frames and back. [`run`] is the command `eecvs-ros`, with operators of another crate if need be.

pub mod arguments;
pub mod bag;
mod command;
pub mod message;
pub mod names;
pub mod node;
pub mod operator;
pub mod packet_reader;
pub mod packing;
pub mod sequence;
pub mod transport;

pub use command::run;
