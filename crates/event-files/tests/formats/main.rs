//! Tests readers and writers through the public interface, with one module for each kind of question.

mod cases_streams;
mod damage;
mod errors;
mod evt_strict;
mod evt_words;
mod hdf5;
mod hdf5_writer;
mod headers;
mod layouts;
mod mat;
mod npz;
mod reference;
mod roundtrip;
mod support;
mod tables;
#[cfg(feature = "video")]
mod video;
mod writers;
