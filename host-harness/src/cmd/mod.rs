//! Subcommands of `eecvs`, one file each, their flags beside them.

pub mod calibrate;
pub mod compare;
pub mod decode;
pub mod emulate;
pub mod encode;
pub mod inspect;
pub mod options;
pub mod output;
