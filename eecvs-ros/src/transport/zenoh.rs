//! Zenoh, as ROS 2's `rmw_zenoh` speaks it.
//!
//! A session connects to a router (`eecvs-ros router`, `rmw_zenohd` or `zenohd`) and, by what that tells, to the
//! others at it. Keys carry the types' hashes: messages of other fields never meet. Parameters are not served.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Result, anyhow};
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh::{Config, Session, Wait};

use super::graph::{Graph, Kind, NodeToken, key_of, tokens_of};
use super::queue::{Queue, lock};
use super::{Node, Publisher, Qos, Subscription, Transport};
use crate::message::Type;
use crate::names::NodeName;

/// Where a router listens unless it is told otherwise.
pub const ROUTER: &str = "tcp/localhost:7447";

/// What a session connects to and listens at.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Links {
    /// Endpoints, as Zenoh spells them: `tcp/HOST:PORT`.
    pub connect: Vec<String>,
    /// Endpoints.
    pub listen: Vec<String>,
    /// A file of Zenoh's own settings, which come first; endpoints above replace its own.
    pub config: Option<PathBuf>,
}

/// Errors of Zenoh are boxed ones that anyhow does not take.
fn said(what: impl Display) -> impl FnOnce(zenoh::Error) -> anyhow::Error {
    move |error| anyhow!("{what}: {error}")
}

/// Settings, the values in JSON.
fn with(mut config: Config, settings: &[(&str, &str)]) -> Result<Config> {
    for (name, value) in settings {
        let inserted = config.insert_json5(name, value);
        inserted.map_err(said(format_args!("{name}: {value}")))?;
    }
    Ok(config)
}

/// What is the same for sessions and routers: nobody is called by multicast, two sessions have one link and not one
/// by each of them, a burst of messages finds room on its way out, and a link that has failed is soon tried again.
const SETTINGS: &[(&str, &str)] = &[
    ("scouting/multicast/enabled", "false"),
    (
        "scouting/gossip/autoconnect_strategy",
        "{peer: {to_router: \"always\", to_peer: \"greater-zid\"}}",
    ),
    ("transport/link/tx/queue/size/data", "16"),
    (
        "connect/retry",
        "{period_init_ms: 250, period_max_ms: 1000}",
    ),
];

impl Links {
    fn config(&self, mode: &str, own: &[(&str, &str)]) -> Result<Config> {
        let config = match &self.config {
            Some(path) => read(path)?,
            None => with(Config::default(), SETTINGS)?,
        };
        let mode = format!("{mode:?}");
        let mut config = with(config, &[("mode", mode.as_str())])?;
        if self.config.is_none() {
            config = with(config, own)?;
        }
        for (name, endpoints) in [
            ("connect/endpoints", &self.connect),
            ("listen/endpoints", &self.listen),
        ] {
            if !endpoints.is_empty() {
                let endpoints = serde_json::to_string(endpoints)?;
                config = with(config, &[(name, endpoints.as_str())])?;
            }
        }
        Ok(config)
    }

    /// Whom they lead to, for messages.
    fn others(&self) -> String {
        match &self.config {
            _ if !self.connect.is_empty() => self.connect.join(", "),
            Some(path) => format!("what {} names", path.display()),
            None => ROUTER.to_owned(),
        }
    }
}

fn read(path: &Path) -> Result<Config> {
    Config::from_file(path).map_err(said(path.display()))
}

/// A router, until it is dropped.
pub struct Router {
    session: Session,
}

impl Router {
    /// Listens and connects.
    ///
    /// # Errors
    /// Settings, or an endpoint that cannot be listened at.
    pub fn start(links: &Links) -> Result<Self> {
        let listen = serde_json::to_string(&[ROUTER])?;
        let config = links.config("router", &[("listen/endpoints", listen.as_str())])?;
        let opened = zenoh::open(config).wait();
        Ok(Self {
            session: opened.map_err(said("the router"))?,
        })
    }

    /// Routers and others that are connected.
    #[must_use]
    pub fn connected(&self) -> (usize, usize) {
        let info = self.session.info();
        let routers = info.routers_zid().wait().count();
        (routers, info.peers_zid().wait().count())
    }
}

/// A session in a domain.
pub struct Zenoh {
    shared: Arc<Shared>,
}

struct Shared {
    domain: u16,
    session: Session,
    graph: Arc<Mutex<Graph>>,
    /// Numbers of nodes and of what is in them.
    entities: AtomicU64,
}

/// Longest wait for a first connection; it is tried on after that.
const CONNECTS: Duration = Duration::from_secs(3);

impl Zenoh {
    /// Joins a domain.
    ///
    /// # Errors
    /// Settings that Zenoh does not take.
    pub fn join(domain: u16, links: &Links) -> Result<Self> {
        let router = serde_json::to_string(&[ROUTER])?;
        let own = [
            ("connect/endpoints", router.as_str()),
            ("listen/endpoints", "[\"tcp/localhost:0\"]"),
        ];
        let opened = zenoh::open(links.config("peer", &own)?).wait();
        let session = opened.map_err(said("Zenoh"))?;
        let graph = Arc::new(Mutex::new(Graph::default()));
        let seen = Arc::clone(&graph);
        let declared = session
            .liveliness()
            .declare_subscriber(tokens_of(domain))
            .history(true)
            .callback(move |sample| {
                let is_there = sample.kind() == SampleKind::Put;
                lock(&seen).take(sample.key_expr().as_str(), is_there);
            })
            .background()
            .wait();
        declared.map_err(said("Zenoh: who else is there"))?;
        let zenoh = Self {
            shared: Arc::new(Shared {
                domain,
                session,
                graph,
                entities: AtomicU64::new(0),
            }),
        };
        if !zenoh.connects(CONNECTS) {
            eprintln!(
                "eecvs-ros: nobody at {} yet; it goes on trying (eecvs-ros router is one)",
                links.others()
            );
        }
        Ok(zenoh)
    }

    fn connects(&self, most: Duration) -> bool {
        let info = self.shared.session.info();
        let started = Instant::now();
        loop {
            let is_there = info.routers_zid().wait().next().is_some()
                || info.peers_zid().wait().next().is_some();
            if is_there || started.elapsed() >= most {
                return is_there;
            }
            thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Transport for Zenoh {
    fn node(&self, name: &NodeName, _: &[(String, String)]) -> Result<Box<dyn Node>> {
        let shared = Arc::clone(&self.shared);
        let number = shared.entities.fetch_add(1, Ordering::Relaxed);
        let session = shared.session.zid().to_string();
        let token = NodeToken::new(shared.domain, &session, number, name);
        let announced = shared.announce(&token.node())?;
        Ok(Box::new(ZenohNode {
            shared,
            token,
            _announced: announced,
        }))
    }
}

impl Shared {
    fn announce(&self, token: &str) -> Result<LivelinessToken> {
        let declared = self.session.liveliness().declare_token(token).wait();
        declared.map_err(said(token))
    }
}

struct ZenohNode {
    shared: Arc<Shared>,
    token: NodeToken,
    _announced: LivelinessToken,
}

impl ZenohNode {
    /// Announces an end of a topic: its token as text, too.
    fn end(
        &self,
        kind: Kind,
        topic: &str,
        message: Type,
        qos: Qos,
    ) -> Result<(String, LivelinessToken)> {
        let number = self.shared.entities.fetch_add(1, Ordering::Relaxed);
        let token = self.token.end_of(number, kind, topic, message, qos);
        let announced = self.shared.announce(&token)?;
        Ok((token, announced))
    }
}

impl Node for ZenohNode {
    fn publisher(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Publisher>> {
        let key = key_of(self.shared.domain, topic, kind);
        let congestion = if qos.reliable {
            CongestionControl::Block
        } else {
            CongestionControl::Drop
        };
        let declared = self
            .shared
            .session
            .declare_publisher(key)
            .congestion_control(congestion)
            .wait();
        let publisher = declared.map_err(said(topic))?;
        let (token, announced) = self.end(Kind::Publisher, topic, kind, qos)?;
        Ok(Box::new(ZenohPublisher {
            topic: topic.to_owned(),
            shared: Arc::clone(&self.shared),
            publisher,
            attachment: Attachment::new(&token),
            latest: None,
            _announced: announced,
        }))
    }

    fn subscription(&mut self, topic: &str, kind: Type, qos: Qos) -> Result<Box<dyn Subscription>> {
        let queue = Arc::new(Queue::new(qos.depth));
        let waiting = Arc::clone(&queue);
        let declared = self
            .shared
            .session
            .declare_subscriber(key_of(self.shared.domain, topic, kind))
            .callback(move |sample| {
                waiting.push(sample.payload().to_bytes().as_ref().into());
            })
            .wait();
        let subscriber = declared.map_err(said(topic))?;
        let (_, announced) = self.end(Kind::Subscription, topic, kind, qos)?;
        Ok(Box::new(ZenohSubscription {
            topic: topic.to_owned(),
            shared: Arc::clone(&self.shared),
            queue,
            _subscriber: subscriber,
            _announced: announced,
        }))
    }
}

/// What ROS 2 wants to know of every message: 33 bytes.
struct Attachment {
    sequence: i64,
    publisher: [u8; 16],
}

impl Attachment {
    /// Of a publisher, which is known by the hash of its token.
    fn new(token: &str) -> Self {
        let hash = twox_hash::XxHash3_128::oneshot(token.as_bytes());
        Self {
            sequence: 0,
            publisher: hash.to_le_bytes(),
        }
    }

    fn next(&mut self) -> [u8; 33] {
        self.sequence += 1;
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now_ns = now.map_or(0, |now| i64::try_from(now.as_nanos()).unwrap_or(i64::MAX));
        let mut bytes = [0; 33];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&now_ns.to_le_bytes());
        bytes[16] = 16;
        bytes[17..].copy_from_slice(&self.publisher);
        bytes
    }
}

struct ZenohPublisher {
    topic: String,
    shared: Arc<Shared>,
    publisher: zenoh::pubsub::Publisher<'static>,
    attachment: Attachment,
    latest: Option<Instant>,
    _announced: LivelinessToken,
}

/// Time in which what was published has certainly left.
const LEAVES: Duration = Duration::from_millis(200);

/// What was published last is still to be sent by a task that ends with the session.
impl Drop for ZenohPublisher {
    fn drop(&mut self) {
        if let Some(latest) = self.latest {
            thread::sleep(LEAVES.saturating_sub(latest.elapsed()));
        }
    }
}

impl Publisher for ZenohPublisher {
    fn publish(&mut self, cdr: &[u8]) -> Result<()> {
        self.latest = Some(Instant::now());
        let put = self
            .publisher
            .put(cdr)
            .attachment(&self.attachment.next()[..]);
        put.wait().map_err(said(&self.topic))
    }

    fn subscribers(&self) -> usize {
        lock(&self.shared.graph).count(Kind::Subscription, &self.topic)
    }
}

struct ZenohSubscription {
    topic: String,
    shared: Arc<Shared>,
    queue: Arc<Queue>,
    _subscriber: zenoh::pubsub::Subscriber<()>,
    _announced: LivelinessToken,
}

impl Subscription for ZenohSubscription {
    fn take(&mut self, wait: Duration) -> Result<Option<Vec<u8>>> {
        Ok(self.queue.take(wait))
    }

    fn publishers(&self) -> usize {
        lock(&self.shared.graph).count(Kind::Publisher, &self.topic)
    }
}
