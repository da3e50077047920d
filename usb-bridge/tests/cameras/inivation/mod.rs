//! The models of iniVation's cameras against themselves: parsers against writers, drivers against
//! simulated cameras.

mod accounts;
mod faults;
mod recordings;
mod round_trip;
mod scene;
mod sequence;
