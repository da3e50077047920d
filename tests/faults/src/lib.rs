//! Makes one call of the system fail on request: the N-th one by which a program changes the files of a folder.
//!
//! A program preloads the shared object (`LD_PRELOAD`) and gets its plan by variables:
//!
//! | variable | content |
//! |---|---|
//! | `EECVS_FAULTS_FOLDER` | the folder; relative names count as in it |
//! | `EECVS_FAULTS_LOG` | file outside of it that gets a line per call: its name, a space, its path |
//! | `EECVS_FAULTS_PLAN` | number of the call, from 1 on, and what happens at it, see [`plan`] |
//!
//! The functions are those by which Rust's standard library and SQLite write. Each issues the system call itself, so
//! that nothing needs to be looked up, and none allocates memory: they are called in signal handlers too.
//!
//! The crate is for Linux; elsewhere it is empty.
#![cfg(target_os = "linux")]

pub mod calls;
pub mod plan;
