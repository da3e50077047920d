//! Frames, byte for byte: in every profile, and as the document of the format has them.

mod golden;
mod wire_format;
