//! Zenoh sessions: sensors and receivers are clients of hubs, and hubs are routers.
//!
//! Settings that differ from Zenoh's defaults, and why:
//!
//! * There is no discovery by multicast: endpoints are given explicitly.
//! * Sixteen batches of 64 KiB may wait for each link, since the frames of a window are sent in a burst.
//! * A sensor waits when its link takes no more, so that it notices and lowers its rate. A hub drops what a
//!   receiver does not take at once, so that one hanging receiver does not hold up the others. Receivers request
//!   dropped frames again.
//! * Hubs put no times of their own on messages: nothing depends on the clocks of different computers.
//! * A link that is silent for 4 s has failed, and a failed link is tried again within a second.

use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, ensure};
use usb_bridge::stop::wait_at_most;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::{Config, Session, Wait};

use crate::access::Access;
use crate::clock::{Clock, RoundTrip};
use crate::key::{Kind, Name};
use crate::message::{Message as _, Time};

/// Default endpoint of a hub.
pub const HUB: &str = "tcp/127.0.0.1:7447";

/// The endpoints and keys of a client or a hub.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Links {
    /// Endpoints to connect to, as Zenoh spells them: `tls/HOST:PORT`, `tcp/HOST:PORT`.
    pub connect: Vec<String>,
    /// Endpoints to listen on.
    pub listen: Vec<String>,
    /// Folder with `ca.pem`, `cert.pem` and `key.pem`, for `tls/` endpoints.
    pub keys: Option<PathBuf>,
}

/// Converts Zenoh's boxed errors, which `anyhow` does not accept, and puts `what` in front.
pub(crate) fn said(what: impl Display) -> impl FnOnce(zenoh::Error) -> anyhow::Error {
    move |error| anyhow!("{what}: {error}")
}

/// Settings of clients and hubs.
const SETTINGS: &[(&str, &str)] = &[
    ("scouting/multicast/enabled", "false"),
    ("transport/link/tx/lease", "4000"),
    ("transport/link/tx/keep_alive", "4"),
    ("transport/link/tx/queue/size/data", "16"),
    ("transport/link/tx/queue/size/data_low", "16"),
    ("transport/link/rx/max_message_size", "16777216"),
    ("transport/unicast/open_timeout", "5000"),
    ("transport/unicast/accept_timeout", "5000"),
    (
        "connect/retry",
        "{period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 1.5}",
    ),
    ("connect/timeout_ms", "-1"),
    ("connect/exit_on_failure", "false"),
];

/// Settings of clients: a message that may be dropped waits a little (20 ms) for room before it is.
const CLIENT_SETTINGS: &[(&str, &str)] = &[(
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
    "20000",
)];

/// Settings of hubs.
const HUB_SETTINGS: &[(&str, &str)] = &[
    ("timestamping/enabled", "false"),
    ("transport/unicast/max_sessions", "10000"),
    // Maximum number of concurrent handshakes, whose peers have not been authenticated yet.
    ("transport/unicast/accept_pending", "1000"),
    (
        "qos/network",
        "[{id: \"hold-up-nobody\", messages: [\"put\", \"query\"], flows: [\"ingress\"], \
          key_exprs: [\"**\"], overwrite: {congestion_control: \"drop\"}}]",
    ),
];

impl Links {
    fn config(&self, mode: &str) -> Result<Config> {
        let mut config = Config::default();
        set(&mut config, "mode", &format!("{mode:?}"))?;
        for (name, value) in SETTINGS {
            set(&mut config, name, value)?;
        }
        for (name, endpoints) in [
            ("connect/endpoints", &self.connect),
            ("listen/endpoints", &self.listen),
        ] {
            set(&mut config, name, &serde_json::to_string(endpoints)?)?;
        }
        let endpoints = self.connect.iter().chain(&self.listen);
        let is_tls = |endpoint: &String| endpoint.starts_with("tls/");
        match &self.keys {
            Some(folder) => {
                for endpoint in endpoints {
                    ensure!(
                        is_tls(endpoint),
                        "{endpoint}: with --keys all links are encrypted: give tls/HOST:PORT"
                    );
                }
                authenticate(&mut config, folder)?;
            }
            None => {
                for endpoint in endpoints {
                    ensure!(
                        !is_tls(endpoint),
                        "{endpoint}: give --keys with the folder of the certificate, which eecvs-hub keys makes"
                    );
                }
            }
        }
        Ok(config)
    }
}

fn set(config: &mut Config, name: &str, value: &str) -> Result<()> {
    let inserted = config.insert_json5(name, value);
    inserted.map_err(said(format_args!("{name}: {value}")))
}

fn authenticate(config: &mut Config, folder: &Path) -> Result<()> {
    let path = |name: &str| -> Result<String> {
        let path = folder.join(name);
        ensure!(
            path.is_file(),
            "{}: no such file: eecvs-hub keys makes it",
            path.display()
        );
        let text = path.to_str();
        let text = text.with_context(|| format!("{}: the path is not UTF-8", path.display()))?;
        Ok(serde_json::to_string(text)?)
    };
    let (root, certificate, key) = (path("ca.pem")?, path("cert.pem")?, path("key.pem")?);
    for (name, value) in [
        ("root_ca_certificate", root.as_str()),
        ("listen_certificate", &certificate),
        ("listen_private_key", &key),
        ("connect_certificate", &certificate),
        ("connect_private_key", &key),
        ("enable_mtls", "true"),
        ("close_link_on_expiration", "true"),
    ] {
        set(config, &format!("transport/link/tls/{name}"), value)?;
    }
    Ok(())
}

/// A hub's router, which runs until it is dropped.
pub struct Router {
    session: Session,
}

impl Router {
    /// Starts a router: listens and connects. With `access`, nobody is permitted more than it states.
    ///
    /// # Errors
    /// Settings or keys are invalid, or an endpoint cannot be listened on.
    pub fn start(links: &Links, access: Option<&Access>) -> Result<Self> {
        let mut config = links.config("router")?;
        for (name, value) in HUB_SETTINGS {
            set(&mut config, name, value)?;
        }
        if let Some(access) = access {
            let rules = serde_json::to_string(&access.rules())?;
            set(&mut config, "access_control", &rules)?;
        }
        let opened = zenoh::open(config).wait();
        let session = opened.map_err(said(format_args!(
            "cannot start a hub at {}",
            links.listen.join(", ")
        )))?;
        Ok(Self { session })
    }

    /// Returns the router's own session, which is permitted everything.
    #[must_use]
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Returns the number of other hubs that are connected.
    #[must_use]
    pub fn routers(&self) -> usize {
        self.session.info().routers_zid().wait().count()
    }
}

/// How long an answer to a question for a clock is accepted: a slower one says little.
const CLOCK: Duration = Duration::from_secs(5);

/// Asks the sensors of a name what their clocks show; `answered` is called with each answer.
pub(crate) fn ask_clock(
    session: &Session,
    name: &Name,
    clock: Clock,
    answered: impl Fn(RoundTrip) + Send + Sync + 'static,
) -> Result<()> {
    let key = name.key(Kind::Clock);
    let asked_us = clock.now_us();
    let asked = session
        .get(key.as_str())
        .target(QueryTarget::All)
        .consolidation(ConsolidationMode::None)
        // Question and answer overtake frames, so that the round trip is short.
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::InteractiveHigh)
        .timeout(CLOCK)
        .callback(move |reply| {
            let answered_us = clock.now_us();
            let sample = reply.result().ok();
            let time = sample.and_then(|sample| Time::from_bytes(&sample.payload().to_bytes()));
            if let Some(time) = time {
                answered(RoundTrip {
                    run: time.run,
                    asked_us,
                    shown_us: time.now_us,
                    answered_us,
                });
            }
        })
        .wait();
    asked.map_err(said(key))
}

/// A client's session, which is opened in the background: there is none until a hub answers.
#[derive(Clone)]
pub struct Client(Arc<Opening>);

struct Opening {
    session: OnceLock<Session>,
    failure: Mutex<Option<String>>,
    /// Whether the client was closed before the session was opened.
    is_given_up: AtomicBool,
}

impl Client {
    /// Starts to connect; `opened` is called with the session as soon as it exists.
    ///
    /// # Errors
    /// Settings or keys are invalid.
    pub fn start(
        links: &Links,
        opened: impl FnOnce(&Session) -> Result<()> + Send + 'static,
    ) -> Result<Self> {
        let mut config = links.config("client")?;
        for (name, value) in CLIENT_SETTINGS {
            set(&mut config, name, value)?;
        }
        let opening = Arc::new(Opening {
            session: OnceLock::new(),
            failure: Mutex::new(None),
            is_given_up: AtomicBool::new(false),
        });
        let own = Arc::clone(&opening);
        thread::Builder::new()
            .name("connecting".to_owned())
            .spawn(move || {
                let session = match zenoh::open(config).wait() {
                    Ok(session) => session,
                    Err(error) => return own.fail(&error.to_string()),
                };
                if own.is_given_up.load(Ordering::Relaxed) {
                    return;
                }
                if let Err(error) = opened(&session) {
                    return own.fail(&format!("{error:#}"));
                }
                let _ = own.session.set(session);
            })
            .context("starting the thread that connects")?;
        Ok(Self(opening))
    }

    /// Returns the session, once a hub has answered.
    #[must_use]
    pub fn session(&self) -> Option<&Session> {
        self.0.session.get()
    }

    /// Returns whether a hub is connected at present.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.session()
            .is_some_and(|session| session.info().routers_zid().wait().next().is_some())
    }

    /// Checks that connecting has not failed for good.
    ///
    /// # Errors
    /// There will be no session; the error says why.
    pub fn check(&self) -> Result<()> {
        let failure = self.0.failure.lock();
        match &*failure.unwrap_or_else(PoisonError::into_inner) {
            Some(failure) => Err(anyhow!("connecting: {failure}")),
            None => Ok(()),
        }
    }

    /// Closes the session, after giving the latest messages time to be sent.
    pub fn close(&self) {
        self.0.is_given_up.store(true, Ordering::Relaxed);
        if let Some(session) = self.session() {
            thread::sleep(LEAVES);
            close(session, CLOSES_SOON);
        }
    }
}

/// Time within which the latest messages have certainly been sent.
const LEAVES: Duration = Duration::from_millis(200);

/// Wait until a session is closed that nobody listens at, or whose process is about to end: one that is connecting to
/// somebody who does not answer takes seconds.
pub(crate) const CLOSES_SOON: Duration = Duration::from_millis(300);

/// Closes a session, or leaves that to a thread of its own where it takes longer than `most`.
pub(crate) fn close(session: &Session, most: Duration) {
    let session = session.clone();
    // Closing a session whose other side is gone may fail, which does not matter.
    let _ = wait_at_most(move || session.close().wait().is_ok(), most);
}

impl Opening {
    fn fail(&self, why: &str) {
        let failure = self.failure.lock();
        *failure.unwrap_or_else(PoisonError::into_inner) = Some(why.to_owned());
    }
}
