//! Library of the `eecvs` command: its subcommands, and the studies, baselines and reports behind them.

pub mod baseline;
pub mod cmd;
pub mod digest;
pub mod downstream;
pub mod npy;
pub mod rate;
pub mod recordings;
pub mod report;
pub mod round_trip;
pub mod selection;
pub mod split;
pub mod study;
pub mod view;
pub mod volume_file;
