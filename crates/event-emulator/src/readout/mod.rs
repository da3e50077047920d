//! From the pixels' events to a stream in order.

mod queue;

pub(crate) use queue::Queue;
