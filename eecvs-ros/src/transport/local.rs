//! The memory of one process, in front of another transport.
//!
//! A message goes directly into the queues of subscriptions in the same process, and through the other transport to
//! subscriptions elsewhere. A subscription to a topic that this process publishes receives messages only from this
//! process. Such topics must be known before any node subscribes: [`Local::expect`] names them.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Result;

use super::queue::{Queue, lock};
use super::{Node, Publisher, Qos, Subscription, Transport};
use crate::message::Type;
use crate::names::NodeName;

/// The memory of a process, with an optional transport to the outside.
pub struct Local {
    outside: Option<Arc<dyn Transport>>,
    shared: Arc<Mutex<Topics>>,
}

/// The topics that are published in this process.
#[derive(Default)]
struct Topics {
    published: HashSet<String>,
    queues: HashMap<String, Vec<Arc<Queue>>>,
}

impl Local {
    /// Creates a local transport in front of another one.
    #[must_use]
    pub fn before(outside: Arc<dyn Transport>) -> Self {
        Self {
            outside: Some(outside),
            shared: Arc::default(),
        }
    }

    /// Creates a local transport without another one: no messages leave the process.
    #[must_use]
    pub fn alone() -> Self {
        Self {
            outside: None,
            shared: Arc::default(),
        }
    }

    /// Declares that a node of this process is going to publish a topic.
    pub fn expect(&self, topic: String) {
        lock(&self.shared).published.insert(topic);
    }
}

impl Transport for Local {
    fn node(&self, name: &NodeName, parameters: &[(String, String)]) -> Result<Box<dyn Node>> {
        let outside = self.outside.as_ref();
        Ok(Box::new(LocalNode {
            outside: outside
                .map(|outside| outside.node(name, parameters))
                .transpose()?,
            shared: Arc::clone(&self.shared),
        }))
    }
}

struct LocalNode {
    outside: Option<Box<dyn Node>>,
    shared: Arc<Mutex<Topics>>,
}

impl Node for LocalNode {
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>> {
        let outside = self.outside.as_mut();
        Ok(Box::new(LocalPublisher {
            topic: topic.to_owned(),
            outside: outside
                .map(|node| node.publisher(topic, kind, qos))
                .transpose()?,
            shared: Arc::clone(&self.shared),
        }))
    }

    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>> {
        let mut topics = lock(&self.shared);
        let is_outside = !topics.published.contains(topic);
        if let Some(outside) = self.outside.as_mut().filter(|_| is_outside) {
            drop(topics);
            return outside.subscription(topic, kind, qos);
        }
        let queue = Arc::new(Queue::new(qos.depth));
        let queues = topics.queues.entry(topic.to_owned()).or_default();
        queues.push(Arc::clone(&queue));
        Ok(Box::new(LocalSubscription { queue }))
    }
}

struct LocalPublisher {
    topic: String,
    outside: Option<Box<dyn Publisher>>,
    shared: Arc<Mutex<Topics>>,
}

impl Publisher for LocalPublisher {
    fn publish(&mut self, cdr: &[u8]) -> Result<()> {
        let mut topics = lock(&self.shared);
        if let Some(queues) = topics.queues.get_mut(&self.topic) {
            let message: Arc<[u8]> = cdr.into();
            queues.retain(|queue| queue.push(Arc::clone(&message)));
        }
        drop(topics);
        match &mut self.outside {
            Some(outside) if outside.subscribers() > 0 => outside.publish(cdr),
            _ => Ok(()),
        }
    }

    fn subscribers(&self) -> usize {
        let here = lock(&self.shared)
            .queues
            .get(&self.topic)
            .map_or(0, Vec::len);
        here + self
            .outside
            .as_ref()
            .map_or(0, |outside| outside.subscribers())
    }
}

struct LocalSubscription {
    queue: Arc<Queue>,
}

impl Subscription for LocalSubscription {
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>> {
        Ok(self.queue.take(wait))
    }

    fn publishers(&self) -> usize {
        1
    }
}

impl Drop for LocalSubscription {
    fn drop(&mut self) {
        self.queue.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{EventPacket, Message};

    const QOS: Qos = Qos {
        depth: 3,
        reliable: false,
    };

    #[test]
    fn messages_pass_and_the_oldest_are_let_go_of() {
        let local = Local::alone();
        let name = NodeName::new("/", "a").unwrap();
        let mut node = local.node(&name, &[]).unwrap();
        let mut publisher = node.publisher("/x", EventPacket::TYPE, QOS).unwrap();
        publisher.publish(&[9]).unwrap();
        let mut one = node.subscription("/x", EventPacket::TYPE, QOS).unwrap();
        let mut other = node.subscription("/y", EventPacket::TYPE, QOS).unwrap();
        assert_eq!(publisher.subscribers(), 1);
        for number in 0..5 {
            publisher.publish(&[number]).unwrap();
        }
        for number in 2..5 {
            let taken = one.take(Duration::ZERO).unwrap();
            assert_eq!(taken, Some(vec![number]));
        }
        assert_eq!(one.take(Duration::from_millis(5)).unwrap(), None);
        assert_eq!(other.take(Duration::ZERO).unwrap(), None);
        drop(one);
        publisher.publish(&[7]).unwrap();
        assert_eq!(publisher.subscribers(), 0);
    }
}
