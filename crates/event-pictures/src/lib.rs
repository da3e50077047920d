//! Pictures of event windows and their volumes, with captions, drawn without system fonts.

pub mod frame_picture;
pub mod picture;
