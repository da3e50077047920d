//! Subcommands of `eecvs`, one file each, with the help of its flags beside it.

pub mod emulate;
