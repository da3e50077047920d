//! Rows that tests measure, and the documents' tables of them.

pub mod exact_times;
pub mod keep_order;
pub mod rate_control;
