//! What carries messages: DDS, Zenoh, or the memory of one process.
//!
//! Each of them takes and gives messages as CDR bytes ([`crate::message`]), so that nodes know nothing of them.

pub mod dds;
pub mod graph;
pub mod local;
mod queue;
mod raw;
pub mod zenoh;

use std::time::Duration;

use anyhow::Result;

use crate::message::Type;
use crate::names::NodeName;

/// How much care a topic's messages get. They are volatile: who comes later gets later ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Messages that wait at a subscription; beyond, the oldest are let go of.
    pub depth: usize,
    /// Whether what was lost is sent again. It wants both sides to ask for it.
    pub reliable: bool,
}

/// Something that carries messages.
pub trait Transport: Send + Sync {
    /// Announces a node, with its parameters for those who ask.
    ///
    /// # Errors
    /// The network cannot be used.
    fn node(&self, name: &NodeName, parameters: &[(String, String)]) -> Result<Box<dyn Node>>;
}

/// A node that others see.
pub trait Node: Send {
    /// Begins to publish.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>>;

    /// Begins to receive.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>>;
}

/// A topic's messages on their way out.
pub trait Publisher: Send {
    /// Sends a message to whoever has subscribed. Without reliability it never waits.
    ///
    /// # Errors
    /// The transport does not take it.
    fn publish(&mut self, cdr: &[u8]) -> Result<()>;

    /// How many have subscribed.
    fn subscribers(&self) -> usize;
}

/// A topic's messages on their way in.
pub trait Subscription: Send {
    /// The oldest message that waits, or the first that comes in time. What the transport could not read is empty.
    ///
    /// # Errors
    /// The transport has ended.
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>>;

    /// How many publish.
    fn publishers(&self) -> usize;
}
