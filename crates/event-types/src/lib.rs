//! Events of event cameras: the types that an encoder on a microcontroller and a file reader share.
//!
//! ```
//! use event_types::{Event, Polarity, Sensor};
//!
//! let sensor = Sensor::new(640, 480).expect("sides from 1 to 2048");
//! let event = Event { t_us: 1_000, x: 3, y: 2, polarity: Polarity::On };
//! assert!(sensor.contains(event.x, event.y));
//! assert_eq!(sensor.number((event.x, event.y)), 2 * 640 + 3);
//! ```
//!
//! [`evt2`] has the words in which Prophesee's sensors send events, and in which they reach an encoder over a link.
//!
//! The types are `no_std` and need no allocator. Feature `std` adds [`stream`]: the traits of whatever gives events
//! (files, cameras, emulated scenes, decoded frames) and of whatever takes them.
#![cfg_attr(not(feature = "std"), no_std)]

mod event;
pub mod evt2;
#[cfg(feature = "std")]
pub mod stream;
#[cfg(feature = "test-events")]
pub mod test_events;

pub use event::{Event, Polarity, Sensor};
