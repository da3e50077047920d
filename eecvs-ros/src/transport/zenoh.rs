//! Zenoh, as ROS 2's `rmw_zenoh` speaks it.
//!
//! A session connects to a router (`eecvs-ros router`, `rmw_zenohd` or `zenohd`) and, by what the router reports,
//! to the other sessions connected to it. Keys contain the hashes of types, so that messages with other fields are
//! never received. Parameters are not served.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Result, anyhow, ensure};
use eecvs_cli::say;
use usb_bridge::stop::wait_at_most;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::sample::SampleKind;
use zenoh::{Config, Session, Wait};

use super::graph::{Graph, Kind, NodeToken, id_of, key_of, tokens_of};
use super::queue::{Queue, lock};
use super::{Known, Node, Publisher, PublisherId, Qos, Subscription, Transport};
use crate::message::{Type, TypeName};
use crate::names::NodeName;
use crate::parameters::Parameters;

/// Default endpoint of a router.
pub const ROUTER: &str = "tcp/localhost:7447";

/// The endpoints and settings of a session or router.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Links {
    /// Endpoints to connect to, as Zenoh spells them: `tcp/HOST:PORT`.
    pub connect: Vec<String>,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// A file with Zenoh's settings, used instead of the defaults here; the endpoints above replace those in the
    /// file.
    pub config: Option<PathBuf>,
}

/// Converts Zenoh's boxed errors, which `anyhow` does not accept, and puts `what` in front.
fn said(what: impl Display) -> impl FnOnce(zenoh::Error) -> anyhow::Error {
    move |error| anyhow!("{what}: {error}")
}

/// Applies settings, whose values are JSON5.
fn with(mut config: Config, settings: &[(&str, &str)]) -> Result<Config> {
    for (name, value) in settings {
        let inserted = config.insert_json5(name, value);
        inserted.map_err(said(format_args!("{name}: {value}")))?;
    }
    Ok(config)
}

/// Defaults for sessions and routers: no discovery by multicast, a single link between two sessions instead of one
/// opened by each, room for a burst of outgoing messages, and quick retries of a failed link.
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

    /// Returns the endpoints that the session connects to, for messages.
    fn others(&self) -> String {
        match &self.config {
            _ if !self.connect.is_empty() => self.connect.join(", "),
            Some(path) => format!("the endpoints in {}", path.display()),
            None => ROUTER.to_owned(),
        }
    }
}

fn read(path: &Path) -> Result<Config> {
    // A device or a pipe may have no end.
    ensure!(path.is_file(), "{}: not a file of settings", path.display());
    Config::from_file(path).map_err(said(path.display()))
}

/// A router, which runs until it is dropped.
pub struct Router {
    session: Session,
}

impl Router {
    /// Starts a router: listens and connects.
    ///
    /// # Errors
    /// Zenoh refuses the settings, or cannot listen on an endpoint.
    pub fn start(links: &Links) -> Result<Self> {
        let listen = serde_json::to_string(&[ROUTER])?;
        let config = links.config("router", &[("listen/endpoints", listen.as_str())])?;
        let opened = zenoh::open(config).wait();
        Ok(Self {
            session: opened.map_err(said("cannot start the router"))?,
        })
    }

    /// Returns the numbers of connected routers and of other connected sessions.
    #[must_use]
    pub fn connected(&self) -> (usize, usize) {
        let info = self.session.info();
        let routers = info.routers_zid().wait().count();
        (routers, info.peers_zid().wait().count())
    }
}

/// Longest wait until a router's session is closed: one that is connecting to somebody who does not answer takes seconds.
const CLOSES: Duration = Duration::from_millis(300);

/// Closes the session, or leaves that to a thread of its own where it takes too long.
impl Drop for Router {
    fn drop(&mut self) {
        let session = self.session.clone();
        // Closing a session whose other side is gone may fail, which does not matter.
        let _ = wait_at_most(move || session.close().wait().is_ok(), CLOSES);
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
    /// The next entity number, for nodes, publishers and subscriptions.
    entities: AtomicU64,
}

/// Longest wait for the first connection; Zenoh keeps trying after that.
const CONNECTS: Duration = Duration::from_secs(3);

impl Zenoh {
    /// Joins a domain. If there is no connection within 3 s, prints a message and returns all the same.
    ///
    /// # Errors
    /// Zenoh refuses the settings.
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
        declared.map_err(said("Zenoh: cannot watch for other nodes"))?;
        let zenoh = Self {
            shared: Arc::new(Shared {
                domain,
                session,
                graph,
                entities: AtomicU64::new(0),
            }),
        };
        if !zenoh.connects(CONNECTS) {
            say!(
                "eecvs-ros: no router answers at {} yet; trying again (eecvs-ros router starts one)",
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
    fn node(&self, name: &NodeName, _: &Arc<Parameters>) -> Result<Box<dyn Node>> {
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
    /// Announces a publisher or subscription; also returns its token as text.
    fn end(
        &self,
        kind: Kind,
        topic: &str,
        message: TypeName<'_>,
        qos: Qos,
    ) -> Result<(String, LivelinessToken)> {
        let number = self.shared.entities.fetch_add(1, Ordering::Relaxed);
        let token = self.token.end_of(number, kind, topic, message, qos);
        let announced = self.shared.announce(&token)?;
        Ok((token, announced))
    }
}

impl Node for ZenohNode {
    fn publisher_of(
        &mut self,
        topic: &str,
        kind: TypeName<'_>,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>> {
        ensure!(
            !kind.hash.is_empty(),
            "{topic}: the type hash of {} is unknown, and rmw_zenoh receives no messages without it",
            kind.name
        );
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
                let attachment = sample.attachment().map(|bytes| bytes.to_bytes());
                let publisher = Attachment::publisher(attachment.as_deref().unwrap_or_default());
                waiting.push(sample.payload().to_bytes().as_ref().into(), publisher);
            })
            .wait();
        let subscriber = declared.map_err(said(topic))?;
        let (_, announced) = self.end(Kind::Subscription, topic, kind.into(), qos)?;
        Ok(Box::new(ZenohSubscription {
            topic: topic.to_owned(),
            shared: Arc::clone(&self.shared),
            queue,
            _subscriber: subscriber,
            _announced: announced,
        }))
    }

    fn publishers_of(&mut self, topic: &str) -> Vec<String> {
        let own = self.shared.session.zid().to_string();
        lock(&self.shared.graph).publishers(topic, &own)
    }
}

/// The metadata that ROS 2 expects with every message, 33 bytes: sequence number, time, length of the publisher's
/// ID, and the ID.
struct Attachment {
    sequence: i64,
    publisher: PublisherId,
}

impl Attachment {
    /// Creates the attachment of a publisher, whose ID is the hash of its token.
    fn new(token: &str) -> Self {
        Self {
            sequence: 0,
            publisher: id_of(token),
        }
    }

    /// Returns the publisher in received metadata, or zeros if there is none.
    fn publisher(bytes: &[u8]) -> PublisherId {
        let id = bytes.get(17..).and_then(<[u8]>::first_chunk);
        PublisherId(id.copied().unwrap_or_default())
    }

    fn next(&mut self) -> [u8; 33] {
        self.sequence += 1;
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        let now_ns = now.map_or(0, |now| i64::try_from(now.as_nanos()).unwrap_or(i64::MAX));
        let mut bytes = [0; 33];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&now_ns.to_le_bytes());
        bytes[16] = 16;
        bytes[17..].copy_from_slice(&self.publisher.0);
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

/// Time within which what was published has certainly been sent.
const LEAVES: Duration = Duration::from_millis(200);

/// Waits until the latest message has been sent, since the task that sends it ends with the session.
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
    fn take_from(&mut self, wait: Duration) -> Result<Option<(Vec<u8>, PublisherId)>> {
        Ok(self.queue.take(wait))
    }

    fn publisher(&self, id: PublisherId) -> Known {
        lock(&self.shared.graph).publisher(&self.topic, id)
    }

    fn publishers(&self) -> usize {
        lock(&self.shared.graph).count(Kind::Publisher, &self.topic)
    }
}
