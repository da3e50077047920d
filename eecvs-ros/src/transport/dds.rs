//! DDS, as ROS 2's default middlewares speak it.
//!
//! Types are matched by name only: [`crate::message::from_cdr`] rejects messages with other fields. A message
//! beyond the 64 kB of a datagram is sent in fragments, and is lost if one fragment is. Best effort therefore needs
//! messages of at most 100 kB, and receivers with room for a burst of them.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use mio::{Events, Interest, Poll, Token};
use ros2_client::dds::rustdds::{self, DomainParticipantBuilder};
use ros2_client::qos::{History, Reliability, WhenFull};
use ros2_client::{Context, MessageTypeName, Name, NodeOptions, QosProfile};

use super::dds_nodes::NodesOfPublishers;
use super::dds_parameters;
use super::queue::lock;
use super::raw::Raw;
use super::{Known, Node, Publisher, PublisherId, Qos, Subscription, Transport};
use crate::message::{ENCAPSULATION, Type, TypeName};
use crate::names::NodeName;
use crate::parameters::Parameters;

/// A participant in a domain.
pub struct Dds {
    context: Context,
    /// The threads of nodes, which hold on to the participant.
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// Longest wait for the threads of nodes, which end with them.
const ENDS: Duration = Duration::from_secs(1);

/// Waits for the threads: a participant that is dropped by the last of them announces that it goes; if the process
/// ended before, others would take it as present for a minute.
impl Drop for Dds {
    fn drop(&mut self) {
        let until = Instant::now() + ENDS;
        let mut threads = std::mem::take(&mut *lock(&self.threads));
        while !threads.is_empty() && Instant::now() < until {
            threads.retain(|thread| !thread.is_finished());
            thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Dds {
    /// Joins a domain; with `loopback`, only on this computer.
    ///
    /// # Errors
    /// There is no network, or another process occupies the ports.
    pub fn join(domain: u16, loopback: bool) -> Result<Self> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if loopback {
            builder = builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let joined = builder.build();
        let participant = joined.map_err(|error| anyhow!("DDS domain {domain}: {error}"))?;
        let context = Context::from_domain_participant(participant)
            .map_err(|error| anyhow!("DDS domain {domain}: {error}"))?;
        Ok(Self {
            context,
            threads: Mutex::default(),
        })
    }
}

impl Transport for Dds {
    fn node(&self, name: &NodeName, parameters: &Arc<Parameters>) -> Result<Box<dyn Node>> {
        let refused = |what: &dyn std::fmt::Display| anyhow!("node {}: {what}", name.full());
        // Its parameter services would know neither types nor ranges, and accept use_sim_time: ours take their place.
        let options = NodeOptions::new().start_parameter_services(false);
        let options = dds_parameters::declare(options, parameters);
        let base = ros2_client::NodeName::new(&name.namespace, &name.base);
        let base = base.map_err(|error| refused(&error))?;
        let node = self.context.new_node(base, options);
        let mut node = node.map_err(|error| refused(&format!("{error:?}")))?;
        let spinner = node
            .spinner()
            .map_err(|error| refused(&format!("{error:?}")))?;
        let nodes = NodesOfPublishers::new(&self.context, &mut node)?;
        let services = dds_parameters::Services::new(&mut node, name)?;
        let node = Arc::new(Mutex::new(node));
        // Both threads end with the node.
        let spins = thread::Builder::new()
            .name("node".to_owned())
            .spawn(move || {
                // It ends with an error only if it cannot begin: the node then works without.
                let _ = futures_executor::block_on(spinner.spin());
            });
        let (serves, end) = services.serve(&node, parameters)?;
        let threads = [spins.context("starting the thread of a node")?, serves];
        lock(&self.threads).extend(threads);
        Ok(Box::new(DdsNode {
            _end: end,
            node,
            nodes: Arc::new(Mutex::new(nodes)),
        }))
    }
}

/// A node, shared with its publishers and subscriptions, because the node knows the remote ends of its topics.
pub(super) type Shared = Arc<Mutex<ros2_client::Node>>;

struct DdsNode {
    _end: dds_parameters::End,
    node: Shared,
    nodes: Arc<Mutex<NodesOfPublishers>>,
}

/// Runs `act` on a node.
fn on<T>(node: &Shared, act: impl FnOnce(&mut ros2_client::Node) -> T) -> T {
    act(&mut lock(node))
}

impl DdsNode {
    fn topic(&self, topic: &str, kind: TypeName<'_>, qos: &QosProfile) -> Result<rustdds::Topic> {
        let name = Name::parse(topic).map_err(|error| anyhow!("{topic}: {error:?}"))?;
        let (package, base) = kind.parts();
        let kind = MessageTypeName::new(package, base);
        let created = on(&self.node, |node| node.create_topic(&name, kind, qos));
        created.map_err(|error| anyhow!("{topic}: {error:?}"))
    }
}

fn profile(qos: Qos) -> QosProfile {
    QosProfile {
        reliability: if qos.reliable {
            Reliability::Reliable {
                when_full: WhenFull::DEFAULT,
            }
        } else {
            Reliability::BestEffort
        },
        history: History::KeepLast { depth: qos.depth },
        ..QosProfile::subscription_default()
    }
}

impl Node for DdsNode {
    fn publisher_of(
        &mut self,
        topic: &str,
        kind: TypeName<'_>,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>> {
        let qos = profile(qos);
        let dds_topic = self.topic(topic, kind, &qos)?;
        let created = on(&self.node, |node| {
            node.create_publisher::<Raw>(&dds_topic, Some(qos))
        });
        let publisher = created.map_err(|error| anyhow!("{topic}: {error:?}"))?;
        Ok(Box::new(DdsPublisher {
            topic: topic.to_owned(),
            node: Arc::clone(&self.node),
            publisher,
            latest: None,
        }))
    }

    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>> {
        let qos = profile(qos);
        let dds_topic = self.topic(topic, kind.into(), &qos)?;
        let created = on(&self.node, |node| {
            node.create_subscription::<Raw>(&dds_topic, Some(qos))
        });
        let mut subscription = created.map_err(|error| anyhow!("{topic}: {error:?}"))?;
        let poll = Poll::new().with_context(|| topic.to_owned())?;
        poll.registry()
            .register(&mut subscription, Token(0), Interest::READABLE)
            .with_context(|| topic.to_owned())?;
        Ok(Box::new(DdsSubscription {
            topic: topic.to_owned(),
            node: Arc::clone(&self.node),
            nodes: Arc::clone(&self.nodes),
            subscription,
            poll,
            events: Events::with_capacity(4),
            refused: 0,
            latest: PublisherId::default(),
        }))
    }

    fn publishers_of(&mut self, topic: &str) -> Vec<String> {
        lock(&self.nodes).of_topic(topic)
    }
}

struct DdsPublisher {
    topic: String,
    node: Shared,
    publisher: ros2_client::Publisher<Raw>,
    latest: Option<Instant>,
}

/// Time within which the sending thread has certainly sent what was published.
pub(super) const LEAVES: Duration = Duration::from_millis(200);

/// Waits until the latest message has been sent, since the thread that sends it ends with the participant.
impl Drop for DdsPublisher {
    fn drop(&mut self) {
        if let Some(latest) = self.latest {
            thread::sleep(LEAVES.saturating_sub(latest.elapsed()));
        }
    }
}

impl Publisher for DdsPublisher {
    fn publish(&mut self, cdr: &[u8]) -> Result<()> {
        // The other two bytes of the encapsulation are options, which are not needed here.
        let Some(([0, 1, _, _], fields)) = cdr.split_first_chunk() else {
            bail!(
                "{}: the message is not little-endian CDR of version 1",
                self.topic
            );
        };
        self.latest = Some(Instant::now());
        // The DDS library does not pad fragments, and Cyclone DDS drops a message whose last fragment is not a
        // whole number of 4-byte words.
        let mut fields = fields.to_vec();
        fields.resize(fields.len().next_multiple_of(4), 0);
        let published = self.publisher.publish(Raw(fields));
        published.map_err(|error| anyhow!("{}: {error:?}", self.topic))
    }

    fn subscribers(&self) -> usize {
        // If a participant has several nodes, only one of them learns of a match: count the topic's subscriptions
        // instead.
        on(&self.node, |node| node.subscription_count(&self.topic))
    }
}

struct DdsSubscription {
    topic: String,
    node: Shared,
    nodes: Arc<Mutex<NodesOfPublishers>>,
    subscription: ros2_client::Subscription<Raw>,
    poll: Poll,
    events: Events,
    /// Consecutive messages that could not be taken.
    refused: u32,
    /// Publisher of the latest message.
    latest: PublisherId,
}

/// Number of consecutive unreadable messages after which the subscription counts as ended.
const REFUSED_MAX: u32 = 10_000;

impl Subscription for DdsSubscription {
    fn take_from(&mut self, wait: Duration) -> Result<Option<(Vec<u8>, PublisherId)>> {
        let until = Instant::now() + wait;
        loop {
            let taken = match self.subscription.take() {
                Ok(taken) => taken,
                Err(error) if self.refused >= REFUSED_MAX => {
                    bail!("{}: {error:?}", self.topic);
                }
                Err(_) => {
                    // Empty bytes: the caller finds that they are not a message, and counts them. Their publisher
                    // is unknown; they are taken as those of the latest one.
                    self.refused += 1;
                    return Ok(Some((Vec::new(), self.latest)));
                }
            };
            self.refused = 0;
            if let Some((Raw(fields), info)) = taken {
                let mut cdr = ENCAPSULATION.to_vec();
                cdr.extend_from_slice(&fields);
                self.latest = PublisherId(info.publisher_gid().to_bytes16());
                return Ok(Some((cdr, self.latest)));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            if let Err(error) = self.poll.poll(&mut self.events, Some(left))
                && error.kind() != std::io::ErrorKind::Interrupted
            {
                return Err(error).with_context(|| self.topic.clone());
            }
        }
    }

    fn publishers(&self) -> usize {
        on(&self.node, |node| node.publisher_count(&self.topic))
    }

    fn publisher(&self, id: PublisherId) -> Known {
        lock(&self.nodes).find(id)
    }
}
