//! The memory of one process, in front of another transport.
//!
//! A message goes directly into the queues of subscriptions in the same process, and through the other transport to
//! subscriptions elsewhere. A subscription to a topic that this process publishes receives messages only from this
//! process, and tells of other publishers. Such topics must be known before any node subscribes: [`Local::expect`] names
//! them.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Result;

use super::queue::{Queue, lock};
use super::{Known, Node, Publisher, PublisherId, Qos, Subscription, Transport};
use crate::message::{Type, TypeName};
use crate::names::NodeName;
use crate::parameters::Parameters;

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
    /// The nodes of the publishers in this process.
    publishers: HashMap<PublisherId, String>,
    /// Number of publishers so far.
    numbered: u128,
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
    fn node(&self, name: &NodeName, parameters: &Arc<Parameters>) -> Result<Box<dyn Node>> {
        let outside = self.outside.as_ref();
        Ok(Box::new(LocalNode {
            name: name.full(),
            outside: outside
                .map(|outside| outside.node(name, parameters))
                .transpose()?
                .map(|node| Arc::new(Mutex::new(node))),
            shared: Arc::clone(&self.shared),
        }))
    }
}

/// The node as other programs see it.
type Outside = Arc<Mutex<Box<dyn Node>>>;

struct LocalNode {
    name: String,
    outside: Option<Outside>,
    shared: Arc<Mutex<Topics>>,
}

impl Node for LocalNode {
    fn publisher_of(
        &mut self,
        topic: &str,
        kind: TypeName<'_>,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>> {
        let mut topics = lock(&self.shared);
        topics.numbered += 1;
        let id = PublisherId(topics.numbered.to_le_bytes());
        topics.publishers.insert(id, self.name.clone());
        drop(topics);
        let outside = self.outside.as_ref();
        Ok(Box::new(LocalPublisher {
            id,
            topic: topic.to_owned(),
            outside: outside
                .map(|node| lock(node).publisher_of(topic, kind, qos))
                .transpose()?,
            shared: Arc::clone(&self.shared),
        }))
    }

    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>> {
        let mut topics = lock(&self.shared);
        let is_outside = !topics.published.contains(topic);
        if let Some(outside) = self.outside.as_ref().filter(|_| is_outside) {
            drop(topics);
            return lock(outside).subscription(topic, kind, qos);
        }
        let queue = Arc::new(Queue::new(qos.depth));
        let queues = topics.queues.entry(topic.to_owned()).or_default();
        queues.push(Arc::clone(&queue));
        Ok(Box::new(LocalSubscription {
            topic: topic.to_owned(),
            outside: self.outside.clone(),
            queue,
            shared: Arc::clone(&self.shared),
        }))
    }

    fn publishers_of(&mut self, topic: &str) -> Vec<String> {
        let outside = self.outside.as_ref();
        outside.map_or_else(Vec::new, |outside| lock(outside).publishers_of(topic))
    }
}

struct LocalPublisher {
    id: PublisherId,
    topic: String,
    outside: Option<Box<dyn Publisher>>,
    shared: Arc<Mutex<Topics>>,
}

impl Publisher for LocalPublisher {
    fn publish(&mut self, cdr: &[u8]) -> Result<()> {
        let mut topics = lock(&self.shared);
        if let Some(queues) = topics.queues.get_mut(&self.topic) {
            let message: Arc<[u8]> = cdr.into();
            queues.retain(|queue| queue.push(Arc::clone(&message), self.id));
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

impl Drop for LocalPublisher {
    fn drop(&mut self) {
        lock(&self.shared).publishers.remove(&self.id);
    }
}

struct LocalSubscription {
    topic: String,
    outside: Option<Outside>,
    queue: Arc<Queue>,
    shared: Arc<Mutex<Topics>>,
}

impl Subscription for LocalSubscription {
    fn take_from(&mut self, wait: Duration) -> Result<Option<(Vec<u8>, PublisherId)>> {
        Ok(self.queue.take(wait))
    }

    fn publisher(&self, id: PublisherId) -> Known {
        let name = lock(&self.shared).publishers.get(&id).cloned();
        name.map_or(Known::Gone, Known::Node)
    }

    fn unheard(&self) -> Vec<String> {
        let outside = self.outside.as_ref();
        outside.map_or_else(Vec::new, |outside| lock(outside).publishers_of(&self.topic))
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
        let mut node = local.node(&name, &Parameters::none()).unwrap();
        let mut publisher = node.publisher("/x", EventPacket::TYPE, QOS).unwrap();
        publisher.publish(&[9]).unwrap();
        let mut one = node.subscription("/x", EventPacket::TYPE, QOS).unwrap();
        let mut other = node.subscription("/y", EventPacket::TYPE, QOS).unwrap();
        let second = NodeName::new("/", "second").unwrap();
        let mut second = local.node(&second, &Parameters::none()).unwrap();
        let mut second = second.publisher("/x", EventPacket::TYPE, QOS).unwrap();
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
        publisher.publish(&[8]).unwrap();
        second.publish(&[9]).unwrap();
        let mut publishers = Vec::new();
        for number in [8, 9] {
            let (cdr, id) = one.take_from(Duration::ZERO).unwrap().unwrap();
            assert_eq!(cdr, [number]);
            publishers.push(id);
        }
        let names = ["/a", "/second"].map(|name| Known::Node(name.to_owned()));
        assert!(publishers.iter().map(|id| one.publisher(*id)).eq(names));
        drop(second);
        assert_eq!(one.publisher(publishers[1]), Known::Gone);
        drop(one);
        publisher.publish(&[7]).unwrap();
        assert_eq!(publisher.subscribers(), 0);
    }
}
