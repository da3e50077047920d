//! Effect of the codec on perception: runs tasks on the original and the decoded events and compares the results.
//!
//! | task | result | agreement |
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
