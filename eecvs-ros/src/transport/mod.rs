//! Transports of messages: DDS, Zenoh, or the memory of one process.
//!
//! All of them take and return messages as CDR bytes ([`crate::message`]), so that the nodes do not depend on the
//! transport.

pub mod dds;
mod dds_nodes;
mod dds_parameters;
pub mod graph;
pub mod local;
mod queue;
mod raw;
pub mod zenoh;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;

use crate::message::{Type, TypeName};
use crate::names::NodeName;
use crate::parameters::Parameters;

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
    fn node(&self, name: &NodeName, parameters: &Arc<Parameters>) -> Result<Box<dyn Node>>;
}

/// An announced node.
pub trait Node: Send {
    /// Creates a publisher for the topic with this absolute name.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>> {
        self.publisher_of(topic, kind.into(), qos)
    }

    /// As [`Node::publisher`], for messages of any type.
    ///
    /// # Errors
    /// As for [`Node::publisher`]; the transport needs the type's hash, which is not known.
    fn publisher_of(
        &mut self,
        topic: &str,
        kind: TypeName<'_>,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>>;

    /// Creates a subscription to the topic with this absolute name.
    ///
    /// # Errors
    /// The transport refuses the topic.
    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>>;

    /// Returns the full names of the nodes of other programs that publish a topic, as far as they are known.
    fn publishers_of(&mut self, topic: &str) -> Vec<String>;
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

/// Identification of a publisher, as a subscription sees it; all zeros where a message does not tell it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PublisherId(pub [u8; 16]);

/// What messages call a publisher whose node is not known.
pub const UNNAMED: &str = "a publisher without a node";

/// Longest wait for the name of a publisher's node, which may become known after its first messages.
pub const NAMED: Duration = Duration::from_secs(1);

/// Number of a topic's publishers that are told apart; all further ones are taken as one.
pub const PUBLISHERS_MAX: usize = 64;

/// What is known of a publisher.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Known {
    /// It is announced, by the node with this full name.
    Node(String),
    /// It is announced, but its node is not.
    Unnamed,
    /// It is not announced, or no longer.
    Gone,
}

/// Receives the messages of a topic.
pub trait Subscription: Send {
    /// Returns the oldest waiting message, or the first that arrives within `wait`. A message that the transport
    /// could not read is returned as empty bytes.
    ///
    /// # Errors
    /// The transport has ended.
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>> {
        Ok(self.take_from(wait)?.map(|(cdr, _)| cdr))
    }

    /// As [`Subscription::take`], with the publisher of the message.
    ///
    /// # Errors
    /// As for [`Subscription::take`].
    fn take_from(&mut self, wait: Duration) -> Result<Option<(Vec<u8>, PublisherId)>>;

    /// Returns what is known of a publisher of the topic.
    fn publisher(&self, id: PublisherId) -> Known;

    /// Returns the full names of nodes that publish the topic without being heard here.
    fn unheard(&self) -> Vec<String> {
        Vec::new()
    }

    /// Returns the number of publishers.
    fn publishers(&self) -> usize;
}
