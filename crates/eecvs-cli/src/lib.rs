//! Code shared by the commands of EECVS: flags, printed tables and JSON, progress, signals and exit status.
//!
//! `eecvs`, `eecvs-usb`, `eecvs-ros` and `eecvs-hub` use the same flags for the same purposes. The flags are defined
//! here because the libraries know nothing of a command line.

pub mod codec;
pub mod folder;
pub mod job;
pub mod memory;
pub mod options;
pub mod order;
pub mod output;
pub mod progress;
pub mod stop;
pub mod values;
pub mod variable;
pub mod volume;
