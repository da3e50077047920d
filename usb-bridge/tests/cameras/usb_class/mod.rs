//! The microcontroller's USB class through the stack's own state machine, on a bus in memory:
//! enumeration byte by byte, frames and packets in any cut, requests that make no sense, hosts that
//! behave badly, and the encoder itself behind the class.

mod application;
mod encoder;
mod enumeration;
mod hosts;
mod script;
mod set_up;
mod traffic;
