//! The nodes of ROS 2: messages, topics over DDS and Zenoh, bags and tables.

mod again;
mod bags;
mod cdr;
mod log;
mod over_dds;
mod over_zenoh;
mod peers;
mod pipeline;
mod program;
mod tables;
