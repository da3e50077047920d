//! What the cameras of iniVation share: words, time that wraps, alignment, registers.
//!
//! Their streams are words of 16 or 32 bits, little-endian, without frames or checks. So a parser
//! can only judge a word by its place:
//!
//! * A word that the device does not send (an unknown code, an address outside of the sensor, a wrap
//!   of 0) is counted by its cause and left out, and what was known before stays.
//! * [`strikes`]: where 8 of 32 words are such or let time run back, the words are taken as
//!   misaligned by an odd number of lost bytes: one byte is left out, and time goes on from what it
//!   was before the first of them.
//! * [`clock`]: what a lost or forged word of time does, what is seen of it, and what is not.

pub(super) mod camera;
pub mod clock;
pub(super) mod groups;
pub(super) mod masks;
pub mod parser;
pub(super) mod registers;
pub mod strikes;
pub(super) mod system;
pub mod tally;
pub(super) mod words16;
pub(super) mod writer;
