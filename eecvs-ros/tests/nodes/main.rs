//! The nodes of ROS 2: messages, topics over DDS and Zenoh, bags and tables.

mod again;
mod arguments;
mod bags;
mod cdr;
mod log;
mod losses;
mod over_dds;
mod over_zenoh;
mod parameters;
mod peers;
mod pipeline;
mod play;
mod program;
mod publishers;
mod tables;
