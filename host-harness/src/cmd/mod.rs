//! Subcommands of `eecvs`: one file each, with its flags.

pub mod bench;
mod bench_pipelines;
mod bench_rate;
mod bench_read;
mod bench_selection;
pub mod calibrate;
pub mod compare;
pub mod convert;
pub mod decode;
pub mod demo;
pub mod emulate;
pub mod encode;
pub mod index;
pub mod info;
pub mod inspect;
pub mod mcu;
pub mod monitor;
pub mod report;
pub mod split;
pub mod verify;
pub mod view;
