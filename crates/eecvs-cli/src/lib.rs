//! What the commands of EECVS share: flags, the tables and JSON that they print, progress, and how they end.
//!
//! `eecvs`, `eecvs-usb`, `eecvs-ros` and `eecvs-hub` have the same flags for the same things, which are here; a library
//! has no place for them.

pub mod codec;
pub mod job;
pub mod options;
pub mod order;
pub mod output;
pub mod progress;
pub mod stop;
pub mod values;
pub mod variable;
pub mod volume;
