//! Host-side codec for event-camera volumes: encodes recordings as frames, and decodes frames to events and
//! volumes.
//!
//! ```text
//! events -> encode -> frames -> decode -> events, coefficients, volumes
//! ```
//!
//! ```no_run
//! use std::fs::File;
//!
//! use eecvs::decode::WindowReader;
//! use eecvs::frame_file::FrameReader;
//! use eecvs::reconstruct::events::{EventDecoder, Finder};
//!
//! fn main() -> Result<(), eecvs::Error> {
//!     let mut windows = WindowReader::new(FrameReader::new(File::open("recording.eecvs")?));
//!     let mut events = EventDecoder::new(Finder::Exact);
//!     while let Some(mut window) = windows.next_window()? {
//!         events.fill(&mut window);
//!         println!("{} us: {} events", window.header.t0_us, window.events.len());
//!     }
//!     println!("{} frames lost", windows.report().frames_lost);
//!     Ok(())
//! }
//! ```
//!
//! [`encode`](encode::encode) reads from any [`EventReader`](event_types::stream::EventReader) (a file opened by
//! `event-files`, a camera, events in memory) and writes frames to any [`Write`](std::io::Write). The frames are
//! the same as those of an encoder on a microcontroller. [`decode`](decode::decode) turns frames back into windows
//! of events. [`reconstruct`] holds the stages in between: coefficients, exact event times and volumes.
//!
//! The feature `encode` adds the encoder, and the feature `thresholds` reads and writes the thresholds of a
//! calibration as a file. Both are on by default; a program that only decodes needs neither.

pub mod calibrate;
pub mod decode;
pub mod density_series;
#[cfg(feature = "encode")]
pub mod encode;
pub mod exact_density;
pub mod frame_file;
pub mod hot_pixels;
pub mod pushed;
pub mod reconstruct;
pub mod representation;
pub mod search_budget;
pub mod storage;
pub mod stream_buffer;
#[cfg(feature = "thresholds")]
pub mod thresholds_file;
mod tree_memory;
pub mod window_counts;
pub mod window_limit;
pub mod work_limit;

pub use event_types::stream::{Error, ErrorKind};
