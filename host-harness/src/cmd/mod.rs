//! One file per subcommand, flag help beside it.

pub mod compare;
