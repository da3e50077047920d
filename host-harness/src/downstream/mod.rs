//! What perception makes of decoded events: tasks run on the original and on the decoded events, and
//! how far their answers agree.

pub mod segment;
