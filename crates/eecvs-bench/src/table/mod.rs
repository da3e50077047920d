//! Rows that tests measure, and the tables that the documents make from them.

pub mod exact_times;
pub mod keep_order;
pub mod rate_control;
