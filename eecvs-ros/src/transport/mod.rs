//! Transports of messages: DDS, Zenoh, or the memory of one process.
//!
//! All of them take and return messages as CDR bytes ([`crate::message`]), so that the nodes do not depend on the
//! transport.

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

/// Quality of service of a topic. Messages are volatile: a late subscriber receives only later messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Messages queued at a subscription; when more arrive, the oldest are dropped.
    pub depth: usize,
    /// Whether lost messages are resent. Both sides must request it.
    pub reliable: bool,
}

/// A network, or the memory of a process, that carries messages.
pub trait Transport: Send + Sync {
    /// Announces a node, with its parameters for those who ask for them.
    ///
    /// # Errors
    /// The network cannot be used.
    fn node(&self, name: &NodeName, parameters: &[(String, String)]) -> Result<Box<dyn Node>>;
}

/// An announced node.
pub trait Node: Send {
    /// Creates a publisher for the topic with this absolute name.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>>;

    /// Creates a subscription to the topic with this absolute name.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>>;
}

/// Sends the messages of one node on a topic.
pub trait Publisher: Send {
    /// Sends a message, as CDR bytes, to the subscribers. Without reliability it never waits.
    ///
    /// # Errors
    /// The transport does not accept the message.
    fn publish(&mut self, cdr: &[u8]) -> Result<()>;

    /// Returns the number of subscribers.
    fn subscribers(&self) -> usize;
}

/// Receives the messages of a topic.
pub trait Subscription: Send {
    /// Returns the oldest waiting message, or the first that arrives within `wait`. A message that the transport
    /// could not read is returned as empty bytes.
    ///
    /// # Errors
    /// The transport has ended.
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>>;

    /// Returns the number of publishers.
    fn publishers(&self) -> usize;
}
