//! Bags of ROS: recordings of messages, among which those of one topic of events are read.
//!
//! One file each: [`bag`] (ROS 1), [`db3`] and [`mcap`] (ROS 2), [`folder`] (a ROS 2 bag of several
//! files). [`decoder`] reads messages of any of them, [`message_events`] turns them into events and says what times mean;
//! [`message`] knows the types of messages, `seek` finds a time. The first topic of events is read, in the order in which
//! the file names topics; another one is named behind the file: `FILE.bag/dvs/right/events`. Messages
//! come in the order of the file, which is that of their arrival.

pub mod bag;
mod bag_writer;
pub mod chunk;
pub mod db3;
mod db3_writer;
pub mod decoder;
pub mod fields;
pub mod folder;
pub mod mcap;
mod mcap_writer;
pub mod message;
pub mod message_events;
pub mod packets;
mod seek;
pub mod topics;
