//! Reads and writes ROS bags: recordings of messages, of which one topic of events is read.
//!
//! Each file format has a module: [`bag`] (ROS 1), [`db3`] and [`mcap`] (ROS 2), [`folder`] (a ROS 2 bag of several
//! files). [`decoder`] reads the messages of any of them, [`message_events`] turns them into events and describes
//! their times, [`message`] knows the message types, and `seek` finds a time. The first topic of events, in the
//! order in which the file introduces topics, is read; the name of another one is appended to the file's:
//! `FILE.bag/dvs/right/events`. Messages are read in the order of the file, which is that of their arrival.

pub mod bag;
mod bag_writer;
pub mod chunk;
pub mod db3;
mod db3_writer;
pub mod decoder;
pub mod fields;
pub mod folder;
#[cfg(feature = "video")]
pub(crate) mod images;
pub mod mcap;
mod mcap_writer;
pub mod message;
pub mod message_events;
pub mod packets;
mod seek;
pub mod topics;
