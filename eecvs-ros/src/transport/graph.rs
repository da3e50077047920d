//! The publishers and subscriptions on Zenoh, from the tokens by which `rmw_zenoh` announces them.
//!
//! ```text
//! @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NAME[/TOPIC/TYPE/HASH/QOS]
//! ```
//!
//! A `/` within a part is written as `%`, and an empty part is a single `%`.

use std::collections::{HashMap, HashSet};

use super::{Known, PublisherId, Qos};
use crate::message::TypeName;
use crate::names::NodeName;

/// What a token announces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A node.
    Node,
    /// A publisher of a topic.
    Publisher,
    /// A subscription to a topic.
    Subscription,
}

impl Kind {
    const fn code(self) -> &'static str {
        match self {
            Self::Node => "NN",
            Self::Publisher => "MP",
            Self::Subscription => "MS",
        }
    }
}

/// Returns the key expression that matches all tokens of a domain.
#[must_use]
pub fn tokens_of(domain: u16) -> String {
    format!("@ros2_lv/{domain}/**")
}

/// Returns the key of a topic's messages: domain, topic, type and the type's hash.
#[must_use]
pub fn key_of<'a>(domain: u16, topic: &str, kind: impl Into<TypeName<'a>>) -> String {
    let kind = kind.into();
    let topic = topic.trim_matches('/');
    format!("{domain}/{topic}/{}/{}", kind.dds(), kind.hash)
}

/// The parts of the tokens of one node and of its publishers and subscriptions.
#[derive(Debug, Clone)]
pub struct NodeToken {
    start: String,
    node: u64,
    end: String,
}

impl NodeToken {
    /// Creates the tokens of a session's node number `node`.
    #[must_use]
    pub fn new(domain: u16, session: &str, node: u64, name: &NodeName) -> Self {
        let namespace = mangled(&name.namespace);
        Self {
            start: format!("@ros2_lv/{domain}/{session}/{node}"),
            node,
            end: format!("%/{namespace}/{}", name.base),
        }
    }

    /// Returns the node's own token.
    #[must_use]
    pub fn node(&self) -> String {
        // A node's entity number is its node number.
        let Self { start, node, end } = self;
        format!("{start}/{node}/{}/{end}", Kind::Node.code())
    }

    /// Returns the token of a publisher or subscription of this node; `entity` must be unique in the session.
    #[must_use]
    pub fn end_of<'a>(
        &self,
        entity: u64,
        kind: Kind,
        topic: &str,
        message: impl Into<TypeName<'a>>,
        qos: Qos,
    ) -> String {
        let message = message.into();
        let Self { start, end, .. } = self;
        let topic = mangled(topic);
        // Values of the default profile are left out: reliable, volatile, keep last, no deadlines.
        let reliability = if qos.reliable { "" } else { "2" };
        format!(
            "{start}/{entity}/{}/{end}/{topic}/{}/{}/{reliability}::,{}:,:,:,,",
            kind.code(),
            message.dds(),
            message.hash,
            qos.depth
        )
    }
}

/// Returns the ID that the messages of a publisher carry: the hash of its token.
#[must_use]
pub fn id_of(token: &str) -> PublisherId {
    let hash = twox_hash::XxHash3_128::oneshot(token.as_bytes());
    PublisherId(hash.to_le_bytes())
}

fn mangled(name: &str) -> String {
    match name.trim_end_matches('/') {
        "" => "%".to_owned(),
        name => name.replace('/', "%"),
    }
}

/// The publishers and subscriptions that exist at present.
#[derive(Debug, Default)]
pub struct Graph {
    ends: HashMap<(Kind, String), HashSet<String>>,
}

impl Graph {
    /// Records that a token has appeared or disappeared. Tokens that are not of a publisher or subscription are
    /// ignored.
    pub fn take(&mut self, token: &str, is_there: bool) {
        let Some(end) = end(token) else { return };
        if is_there {
            self.ends.entry(end).or_default().insert(token.to_owned());
        } else if let Some(tokens) = self.ends.get_mut(&end) {
            tokens.remove(token);
            if tokens.is_empty() {
                self.ends.remove(&end);
            }
        }
    }

    /// Returns the number of publishers or subscriptions of a topic.
    #[must_use]
    pub fn count(&self, kind: Kind, topic: &str) -> usize {
        let end = (kind, mangled(topic));
        self.ends.get(&end).map_or(0, HashSet::len)
    }

    /// Returns the nodes of other sessions than `own` that publish a topic.
    #[must_use]
    pub fn publishers(&self, topic: &str, own: &str) -> Vec<String> {
        let tokens = self.ends.get(&(Kind::Publisher, mangled(topic)));
        let is_other = |token: &&String| token.split('/').nth(2) != Some(own);
        let tokens = tokens.into_iter().flatten().filter(is_other);
        tokens.filter_map(|token| node_of(token)).collect()
    }

    /// Returns what is known of a publisher of a topic, found by the ID in its messages. An ID that is not the
    /// hash of a token, as some implementations choose it, is that of a publisher that is gone.
    #[must_use]
    pub fn publisher(&self, topic: &str, id: PublisherId) -> Known {
        let tokens = self.ends.get(&(Kind::Publisher, mangled(topic)));
        let mut tokens = tokens.into_iter().flatten();
        match tokens.find(|token| id_of(token) == id) {
            Some(token) => node_of(token).map_or(Known::Unnamed, Known::Node),
            None => Known::Gone,
        }
    }
}

/// Returns the full name of a token's node.
fn node_of(token: &str) -> Option<String> {
    let mut parts = token.split('/').skip(7);
    let (namespace, name) = (parts.next()?, parts.next()?);
    let namespace = namespace.replace('%', "/");
    Some(format!("{}/{name}", namespace.trim_end_matches('/')))
}

fn end(token: &str) -> Option<(Kind, String)> {
    let parts: Vec<&str> = token.split('/').collect();
    let [_, _, _, _, _, kind, _, _, _, topic, ..] = parts.as_slice() else {
        return None;
    };
    let kind = [Kind::Publisher, Kind::Subscription]
        .into_iter()
        .find(|known| known.code() == *kind)?;
    Some((kind, (*topic).to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{EventPacket, Message};

    /// As in the design document of rmw_zenoh, except for the topics.
    #[test]
    fn tokens_are_written_as_ros_writes_them() {
        let name = NodeName::new("/", "listener").unwrap();
        let session = "aac3178e146ba6f1fc6e6a4085e77f21";
        let node = NodeToken::new(2, session, 0, &name);
        assert_eq!(
            node.node(),
            "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
        );
        let qos = Qos {
            depth: 7,
            reliable: true,
        };
        let name = NodeName::new("/robot/left", "encode").unwrap();
        let node = NodeToken::new(0, session, 3, &name);
        let topic = "/robot/left/events";
        let token = node.end_of(10, Kind::Publisher, topic, EventPacket::TYPE, qos);
        let want = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/3/10/MP/%/%robot%left/encode/\
            %robot%left%events/event_camera_msgs::msg::dds_::EventPacket_/\
            RIHS01_d6fa176260b1f37e5a40845305315e150a0f18191241eb64f407442aa29844aa/::,7:,:,:,,";
        assert_eq!(token, want);
        let qos = Qos {
            reliable: false,
            ..qos
        };
        let token = node.end_of(11, Kind::Subscription, topic, EventPacket::TYPE, qos);
        assert!(token.contains("/3/11/MS/") && token.ends_with("/2::,7:,:,:,,"));
        assert_eq!(
            key_of(5, topic, EventPacket::TYPE),
            "5/robot/left/events/event_camera_msgs::msg::dds_::EventPacket_/\
             RIHS01_d6fa176260b1f37e5a40845305315e150a0f18191241eb64f407442aa29844aa"
        );
    }

    #[test]
    fn ends_come_and_go() {
        let name = NodeName::new("/", "a").unwrap();
        let node = NodeToken::new(0, "1", 0, &name);
        let qos = Qos {
            depth: 1,
            reliable: false,
        };
        let token = |entity| node.end_of(entity, Kind::Publisher, "/a/b", EventPacket::TYPE, qos);
        let mut graph = Graph::default();
        for (entity, is_there, want) in [
            (1, true, 1),
            (1, true, 1),
            (2, true, 2),
            (3, false, 2),
            (1, false, 1),
            (2, false, 0),
        ] {
            graph.take(&token(entity), is_there);
            assert_eq!(graph.count(Kind::Publisher, "/a/b"), want);
            assert_eq!(graph.count(Kind::Subscription, "/a/b"), 0);
        }
        let id = id_of(&token(4));
        assert_eq!(graph.publisher("/a/b", id), Known::Gone);
        graph.take(&token(4), true);
        assert_eq!(graph.publisher("/a/b", id), Known::Node("/a".to_owned()));
        assert_eq!(graph.publishers("/a/b", "2"), ["/a"]);
        assert!(graph.publishers("/a/b", "1").is_empty());
        graph.take(&token(4), false);
        assert_eq!(graph.publisher("/a/b", id), Known::Gone);
        for odd in [
            "",
            "@ros2_lv",
            &node.node(),
            "a/b/c/d/e/f/g/h/i/j/k",
            "//////////",
        ] {
            graph.take(odd, true);
        }
        assert!(graph.ends.is_empty());
    }
}
