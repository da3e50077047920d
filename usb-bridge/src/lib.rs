//! USB side of EECVS: which event cameras there are, and where their streams go.
//!
//! What is here: [`known`], the table of the cameras' USB identities. What is not here yet: device
//! models, links over libusb, serial and TCP, capture and forwarding. They follow the data flow of
//! the project:
//!
//! ```text
//! camera -> link (USB) -> device model (bytes to events) -> encoder -> frames -> sinks
//! MCU    -> link (USB or serial) -------------------------------------^
//! ```

pub mod known;
