//! Pictures of events and of their volumes, with captions, without fonts of the system.

pub mod frame_picture;
pub mod picture;
