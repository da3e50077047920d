//! Pictures and charts of the reports.

pub mod chart;
pub mod demo;
pub mod frame_picture;
pub mod picture;
