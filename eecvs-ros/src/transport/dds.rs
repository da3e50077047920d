//! DDS, as ROS 2's default middlewares speak it.
//!
//! Types are matched by their names alone: [`crate::message::from_cdr`] refuses what has other fields. A message
//! beyond a datagram's 64 kB travels in fragments of which none may be lost, so that best effort wants messages
//! of 100 kB at the most and receivers with room for a burst of them.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, bail};
use mio::{Events, Interest, Poll, Token};
use ros2_client::dds::rustdds::{self, DomainParticipantBuilder};
use ros2_client::qos::{History, Reliability, WhenFull};
use ros2_client::{Context, MessageTypeName, Name, NodeOptions, ParameterValue, QosProfile};

use super::raw::Raw;
use super::{Node, Publisher, Qos, Subscription, Transport};
use crate::message::{ENCAPSULATION, Type};
use crate::names::NodeName;

/// A participant of a domain.
pub struct Dds {
    context: Context,
}

impl Dds {
    /// Joins a domain; with `loopback` on this computer alone.
    ///
    /// # Errors
    /// No network, or another process has its ports.
    pub fn join(domain: u16, loopback: bool) -> Result<Self> {
        let mut builder = DomainParticipantBuilder::new(domain);
        if loopback {
            builder = builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let joined = builder.build();
        let participant = joined.map_err(|error| anyhow!("DDS domain {domain}: {error}"))?;
        let context = Context::from_domain_participant(participant)
            .map_err(|error| anyhow!("DDS domain {domain}: {error}"))?;
        Ok(Self { context })
    }
}

impl Transport for Dds {
    fn node(&self, name: &NodeName, parameters: &[(String, String)]) -> Result<Box<dyn Node>> {
        let refused = |what: &dyn std::fmt::Display| anyhow!("node {}: {what}", name.full());
        let mut options = NodeOptions::new();
        for (name, value) in parameters {
            options = options.declare_parameter(name, ParameterValue::String(value.clone()));
        }
        options = options.parameter_validator(Box::new(only_as_declared(parameters.to_vec())));
        let base = ros2_client::NodeName::new(&name.namespace, &name.base);
        let base = base.map_err(|error| refused(&error))?;
        let node = self.context.new_node(base, options);
        let mut node = node.map_err(|error| refused(&format!("{error:?}")))?;
        let spinner = node
            .spinner()
            .map_err(|error| refused(&format!("{error:?}")))?;
        // Ends with the node.
        thread::Builder::new()
            .name("node".to_owned())
            .spawn(move || futures_executor::block_on(spinner.spin()))
            .context("a thread of a node")?;
        Ok(Box::new(DdsNode {
            node: Arc::new(Mutex::new(node)),
        }))
    }
}

/// Refuses to set parameters, which are flags: they take effect when a node starts. What they are declared with is fine.
fn only_as_declared(
    parameters: Vec<(String, String)>,
) -> impl Fn(&str, &ParameterValue) -> Result<(), String> + Send + Sync {
    move |name, value| {
        let mut declared = parameters.iter().filter(|(known, _)| known == name);
        match (declared.next(), value) {
            (Some((_, declared)), ParameterValue::String(value)) if value == declared => Ok(()),
            _ => Err(format!(
                "{name} is read-only: it takes effect when the node starts, with -p {name}:=VALUE"
            )),
        }
    }
}

/// Shared with what it publishes and receives, as it knows who is at the other end of them.
type Shared = Arc<Mutex<ros2_client::Node>>;

struct DdsNode {
    node: Shared,
}

/// Runs `act` on a node. A panic while another thread had it has left it whole.
fn on<T>(node: &Shared, act: impl FnOnce(&mut ros2_client::Node) -> T) -> T {
    act(&mut node.lock().unwrap_or_else(PoisonError::into_inner))
}

impl DdsNode {
    fn topic(&self, topic: &str, kind: Type, qos: &QosProfile) -> Result<rustdds::Topic> {
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
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>> {
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
        let dds_topic = self.topic(topic, kind, &qos)?;
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
            subscription,
            poll,
            events: Events::with_capacity(4),
            refused: 0,
        }))
    }
}

struct DdsPublisher {
    topic: String,
    node: Shared,
    publisher: ros2_client::Publisher<Raw>,
    latest: Option<Instant>,
}

/// Time in which the thread that sends has certainly sent what was published.
const LEAVES: Duration = Duration::from_millis(200);

/// What was published last is still to be sent by a thread that ends with the participant.
impl Drop for DdsPublisher {
    fn drop(&mut self) {
        if let Some(latest) = self.latest {
            thread::sleep(LEAVES.saturating_sub(latest.elapsed()));
        }
    }
}

impl Publisher for DdsPublisher {
    fn publish(&mut self, cdr: &[u8]) -> Result<()> {
        // The other two bytes are options that only others read.
        let Some(([0, 1, _, _], fields)) = cdr.split_first_chunk() else {
            bail!(
                "{}: a message that is not little-endian CDR of version 1",
                self.topic
            );
        };
        self.latest = Some(Instant::now());
        // Fragments are not padded below: Cyclone DDS drops a message whose last one does not end with a word.
        let mut fields = fields.to_vec();
        fields.resize(fields.len().next_multiple_of(4), 0);
        let published = self.publisher.publish(Raw(fields));
        published.map_err(|error| anyhow!("{}: {error:?}", self.topic))
    }

    fn subscribers(&self) -> usize {
        // Of several nodes in a participant, one alone is told of a match: the topic's are counted.
        on(&self.node, |node| node.subscription_count(&self.topic))
    }
}

struct DdsSubscription {
    topic: String,
    node: Shared,
    subscription: ros2_client::Subscription<Raw>,
    poll: Poll,
    events: Events,
    /// Messages in a row that could not be taken.
    refused: u32,
}

/// Messages in a row that are no messages; with more, it is the subscription that has ended.
const REFUSED_MAX: u32 = 10_000;

impl Subscription for DdsSubscription {
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>> {
        let until = Instant::now() + wait;
        loop {
            let taken = match self.subscription.take() {
                Ok(taken) => taken,
                Err(error) if self.refused >= REFUSED_MAX => {
                    bail!("{}: {error:?}", self.topic);
                }
                Err(_) => {
                    // Whoever takes it finds that it is none, and counts it.
                    self.refused += 1;
                    return Ok(Some(Vec::new()));
                }
            };
            self.refused = 0;
            if let Some((Raw(fields), _)) = taken {
                let mut cdr = ENCAPSULATION.to_vec();
                cdr.extend_from_slice(&fields);
                return Ok(Some(cdr));
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
}
