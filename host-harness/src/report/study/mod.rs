//! The page of a study: tables, charts, pictures and prose, all made from its rows.

pub mod colours;
pub mod equal_errors;
pub mod figures;
pub mod page;
pub mod panels;
pub mod rate_distortion;
pub mod section;
pub mod table;
pub mod tables;
pub mod time_errors;
