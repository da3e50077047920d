//! Pictures, charts and tables of the reports.

pub mod chart;
pub mod demo;
pub mod error_chart;
pub mod few_table;
pub mod hub_load_table;
pub mod kernel_chart;
pub mod kernel_table;
pub mod part;
pub mod picture_backend;
pub mod pipelines_table;
pub mod rate_chart;
pub mod rate_table;
pub mod read_speed_table;
pub mod ros_delay_table;
pub mod sections;
pub mod seek_table;
pub mod selection_table;
pub mod sheet;
pub mod skip_table;
pub mod speed_chart;
pub mod stream_table;
pub mod strips;
pub mod study;
