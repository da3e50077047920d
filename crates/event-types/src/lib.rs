//! Defines the event types that encoders on microcontrollers and readers of event files share.
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
//! [`evt2`] converts between events and the 32-bit words of Prophesee's EVT 2.0 format, which the sensors send and
//! which an encoder receives over a link; [`evt21`] has the words of EVT 2.1, of up to 32 events each, and [`aer`] those
//! of AER, which have no time.
//!
//! The types are `no_std` and need no allocator. The feature `std` adds [`stream`]: the traits of event sources
//! (files, cameras, emulated scenes, decoded frames) and of event sinks; and [`plain`], which makes text from outside
//! harmless for a terminal.
#![cfg_attr(not(any(test, feature = "std")), no_std)]

pub mod aer;
mod event;
pub mod evt2;
pub mod evt21;
#[cfg(feature = "std")]
pub mod plain;
#[cfg(feature = "std")]
pub mod stream;
#[cfg(feature = "test-events")]
pub mod test_events;

pub use event::{Event, Polarity, Sensor};
