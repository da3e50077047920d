//! Code shared by the iniVation cameras: words, wrapping time, alignment and registers.
//!
//! Their streams consist of 16- or 32-bit little-endian words without frames or checksums. A parser can therefore
//! judge a word only by its context:
//!
//! * A word that the device does not send (an unknown code, an address outside the sensor, a wrap of 0) is counted
//!   by its cause and skipped, and the state before it is kept.
//! * [`strikes`]: if 8 of 32 words are of this kind or make time run back, the words are taken as misaligned by an
//!   odd number of lost bytes. One byte is skipped, and time continues from its value before the first of them.
//! * [`clock`]: the effects of a lost or forged time word, and which of them can be detected.

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
