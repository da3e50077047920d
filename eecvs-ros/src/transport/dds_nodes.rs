//! The nodes of publishers on DDS, from the topic on which ROS 2's nodes announce what they consist of.

use std::collections::HashMap;

use anyhow::{Result, anyhow};
use ros2_client::dds::rustdds;
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{Context, MessageTypeName, Node, QosProfile, Subscription};
use serde::Deserialize;

use super::{Known, PublisherId, UNNAMED};

/// Returns the publisher that writes for DDS as `writer`.
fn id_of(writer: &rustdds::discovery::DiscoveredWriterData) -> PublisherId {
    PublisherId(ros2_client::Gid::from(writer.writer_proxy.remote_writer_guid).to_bytes16())
}

/// Name of the topic in DDS.
const TOPIC: &str = "ros_discovery_info";

/// Number of announcements that wait until a name is looked up.
const DEPTH: usize = 1000;

/// `rmw_dds_common/msg/ParticipantEntitiesInfo`: the nodes of a program.
#[derive(Debug, Deserialize)]
struct Entities {
    _participant: [u8; 16],
    nodes: Vec<NodeEntities>,
}

/// `rmw_dds_common/msg/NodeEntitiesInfo`: what a node consists of.
#[derive(Debug, Deserialize)]
struct NodeEntities {
    namespace: String,
    name: String,
    _readers: Vec<[u8; 16]>,
    writers: Vec<[u8; 16]>,
}

/// Finds the nodes of publishers.
pub(super) struct NodesOfPublishers {
    context: Context,
    announced: Subscription<Entities>,
    names: HashMap<PublisherId, String>,
}

impl NodesOfPublishers {
    /// Listens to announcements, also to those made before.
    pub(super) fn new(context: &Context, node: &mut Node) -> Result<Self> {
        let refused = |error: &dyn std::fmt::Debug| anyhow!("{TOPIC}: {error:?}");
        let qos = QosProfile {
            reliability: Reliability::Reliable {
                when_full: WhenFull::DEFAULT,
            },
            durability: Durability::TransientLocal,
            history: History::KeepLast { depth: DEPTH },
            ..QosProfile::subscription_default()
        };
        let kind = MessageTypeName::new("rmw_dds_common", "ParticipantEntitiesInfo");
        let topic = context.create_topic(TOPIC.to_owned(), kind, &qos);
        let topic = topic.map_err(|error| refused(&error))?;
        let announced = node.create_subscription(&topic, Some(qos));
        Ok(Self {
            context: context.clone(),
            announced: announced.map_err(|error| refused(&error))?,
            names: HashMap::new(),
        })
    }

    /// Returns what is known of a publisher.
    pub(super) fn find(&mut self, id: PublisherId) -> Known {
        self.take();
        let writers = self.context.domain_participant().discovered_writers();
        if !writers.iter().any(|writer| id_of(writer) == id) {
            return Known::Gone;
        }
        let name = self.names.get(&id).cloned();
        name.map_or(Known::Unnamed, Known::Node)
    }

    /// Returns the nodes of other programs that publish the topic with this absolute name.
    pub(super) fn of_topic(&mut self, topic: &str) -> Vec<String> {
        self.take();
        let dds_name = format!("rt{topic}");
        let writers = self.context.domain_participant().discovered_writers();
        let names = writers
            .iter()
            .filter(|writer| writer.publication_topic_data.topic_name == dds_name)
            .map(|writer| {
                let name = self.names.get(&id_of(writer));
                name.map_or(UNNAMED, String::as_str)
            });
        names.map(str::to_owned).collect()
    }

    /// Takes the announcements that have arrived. An announcement that cannot be read is passed over.
    fn take(&mut self) {
        for _ in 0..DEPTH {
            match self.announced.take() {
                Ok(None) => return,
                Ok(Some((entities, _))) => {
                    for node in entities.nodes {
                        let namespace = node.namespace.trim_end_matches('/');
                        let name = format!("{namespace}/{}", node.name);
                        let writers = node.writers.into_iter().map(PublisherId);
                        self.names.extend(writers.map(|id| (id, name.clone())));
                    }
                }
                Err(_) => {}
            }
        }
    }
}
