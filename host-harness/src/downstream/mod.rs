//! What perception makes of decoded events: tasks run on the original and on the decoded events, and
//! how far their answers agree.
//!
//! | task | answers | agreement |
//! |---|---|---|
//! | [`segmentation()`] | segments of event frames | IoU of the masks |
//! | [`flow()`] | optical flow of tiles | length of the difference |

pub mod flow;
pub mod segment;
mod segmentation;
mod slices;
#[cfg(test)]
mod test_events;

pub use flow::{Flow, FlowReference, flow};
pub use segmentation::{Segmentation, SegmentationReference, segmentation};
