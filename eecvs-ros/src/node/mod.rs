//! The nodes: one file each, named after its command.
//!
//! ```text
//! emulate, bridge --events--> encode --frames--> decode --decoded/events, volume, image-->
//!                     +-----> density --density, /diagnostics-->
//! frames --> log
//! ```
//!
//! Topics are relative to the namespace, which is `/event_camera` unless `-r __ns:=` sets another: one namespace
//! per camera. A driver named `event_camera` publishes its `~/events` there.

pub mod bridge;
pub mod decode;
pub mod delay;
pub mod density;
pub mod emulate;
pub mod encode;
pub mod frame_reader;
pub mod frames;
pub mod log;
pub mod play;
pub mod record;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::{Args, FromArgMatches};
use eecvs_cli::say;
use usb_bridge::stop::Stop;

use crate::arguments::NodeArguments;
use crate::message::{Message, Type, TypeName, put_cdr};
use crate::one_publisher::OnePublisher;
use crate::parameters::Parameters;
use crate::transport::{self, Publisher, Qos, Subscription, Transport};

/// Default namespace of the nodes of one camera.
pub const NAMESPACE: &str = "/event_camera";

/// Quality of service of a node's topics.
#[derive(Debug, Clone, Copy, Args)]
pub struct QosOptions {
    /// Messages queued for this node; when more arrive, the oldest are dropped
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    depth: u32,

    /// Have lost messages resent, if the other side asks for it too; the publisher then waits for a slow link
    #[arg(long)]
    reliable: bool,
}

impl QosOptions {
    /// Returns the options as the [`Qos`] that transports take.
    #[must_use]
    pub const fn qos(self) -> Qos {
        Qos {
            depth: self.depth as usize,
            reliable: self.reliable,
        }
    }
}

/// Whether losses are an error.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct LossOptions {
    /// Exit with 0 even if messages were lost or left out
    #[arg(long)]
    pub allow_loss: bool,
}

/// Error: something was lost. The node has come to its end all the same, and has used everything else.
#[derive(Debug, thiserror::Error)]
#[error("{0}; with --allow-loss this is not an error")]
pub struct Lost(String);

/// Ends a node: fails if any of the counts, each with what it counts, is not 0, unless loss is allowed.
///
/// # Errors
/// [`Lost`].
pub fn refuse_losses(allow_loss: bool, losses: &[(u64, &str)]) -> Result<()> {
    let losses: Vec<String> = losses
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if allow_loss || losses.is_empty() {
        return Ok(());
    }
    Err(Lost(losses.join(", ")).into())
}

/// A node's environment: its name and arguments, its transport and the request to stop.
pub struct Context {
    arguments: NodeArguments,
    node: Box<dyn transport::Node>,
    parameters: Arc<Parameters>,
    /// The latest change of parameters that the node has taken.
    seen: AtomicU64,
    /// The request to stop.
    pub stop: Stop,
}

impl Context {
    /// Announces a node; `parameters` are served to clients that ask for them, if the transport serves parameters.
    ///
    /// # Errors
    /// The network cannot be used.
    pub fn new(
        transport: &dyn Transport,
        arguments: NodeArguments,
        parameters: Arc<Parameters>,
        stop: Stop,
    ) -> Result<Self> {
        let node = transport.node(&arguments.name, &parameters)?;
        Ok(Self {
            arguments,
            node,
            parameters,
            seen: AtomicU64::new(0),
            stop,
        })
    }

    /// Returns whether parameters have been set that the node has not taken with [`Context::changed`].
    #[must_use]
    pub fn has_changed(&self) -> bool {
        self.parameters.is_newer(self.seen.load(Ordering::Relaxed))
    }

    /// Returns the node's command with its present parameters if some have been set since the latest call.
    #[must_use]
    pub fn changed<T: FromArgMatches>(&self) -> Option<T> {
        let (seen, matches) = self.parameters.newer(self.seen.load(Ordering::Relaxed))?;
        self.seen.store(seen, Ordering::Relaxed);
        T::from_arg_matches(&matches).ok()
    }

    /// Returns the node's own name without its namespace, for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.arguments.name.base
    }

    /// Creates a publisher of messages of type `M` on a topic, whose name is resolved and remapped.
    ///
    /// # Errors
    /// ROS 2 does not allow the name, or the transport refuses the topic.
    pub fn publisher<M: Message>(&mut self, topic: &str, qos: Qos) -> Result<Sender<M>> {
        let topic = self.arguments.topic(topic)?;
        let publisher = self.node.publisher(&topic, M::TYPE, qos)?;
        Ok(Sender {
            publisher,
            bytes: Vec::new(),
            sent: Sent::default(),
            kind: std::marker::PhantomData,
        })
    }

    /// Subscribes to a topic of messages of type `M`, whose name is resolved and remapped, and keeps to one of its
    /// publishers.
    ///
    /// # Errors
    /// ROS 2 does not allow the name, or the transport refuses the topic.
    pub fn one_publisher<M: Message>(&mut self, topic: &str, qos: Qos) -> Result<OnePublisher> {
        let topic = self.arguments.topic(topic)?;
        let subscription = self.node.subscription(&topic, M::TYPE, qos)?;
        let speaker = self.speaker();
        let say = Box::new(move |line: &str| speaker.say(line));
        Ok(OnePublisher::new(subscription, &topic, say))
    }

    /// Returns the absolute name of a topic after remapping.
    ///
    /// # Errors
    /// ROS 2 does not allow the name.
    pub fn topic(&self, name: &str) -> Result<String> {
        self.arguments.topic(name)
    }

    /// Creates a publisher of already serialised messages on the topic with this absolute name.
    ///
    /// # Errors
    /// The transport refuses the topic.
    pub fn publisher_of(
        &mut self,
        topic: &str,
        kind: TypeName<'_>,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>> {
        self.node.publisher_of(topic, kind, qos)
    }

    /// Subscribes to the topic with this absolute name, for messages that stay serialised.
    ///
    /// # Errors
    /// The transport refuses the topic.
    pub fn subscription_of(
        &mut self,
        topic: &str,
        kind: Type,
        qos: Qos,
    ) -> Result<Box<dyn Subscription>> {
        self.node.subscription(topic, kind, qos)
    }

    /// Prints one line to stderr, preceded by the node's full name.
    pub fn say(&self, line: &str) {
        self.speaker().say(line);
    }

    /// Returns a handle that prints lines as [`Context::say`] does.
    #[must_use]
    pub fn speaker(&self) -> Speaker {
        Speaker(self.arguments.name.full())
    }

    /// Waits until the topic has a subscriber, a stop is requested, or `most` has elapsed.
    pub fn wait_for_subscriber<M>(&self, sender: &Sender<M>, most: Duration) {
        self.wait_until(most, || sender.subscribers() > 0);
    }

    /// Waits until `is_there` returns true, a stop is requested, or `most` has elapsed.
    pub fn wait_until(&self, most: Duration, is_there: impl Fn() -> bool) {
        let started = Instant::now();
        while !is_there() && !self.stop.is_asked() && started.elapsed() < most {
            std::thread::sleep(Duration::from_millis(10));
        }
        if !most.is_zero() && is_there() {
            // The other side may discover this node a little later than this node discovers it.
            std::thread::sleep(Duration::from_millis(300));
        }
    }
}

/// Prints lines to stderr, preceded by a node's full name.
#[derive(Debug, Clone)]
pub struct Speaker(String);

impl Speaker {
    /// Prints one line.
    pub fn say(&self, line: &str) {
        say!("eecvs-ros: {}: {line}", self.0);
    }
}

/// Counts of published messages and bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sent {
    /// Number of messages.
    pub messages: u64,
    /// Their serialised size in bytes.
    pub bytes: u64,
}

/// Publisher of messages of one type.
pub struct Sender<M> {
    publisher: Box<dyn Publisher>,
    bytes: Vec<u8>,
    sent: Sent,
    kind: std::marker::PhantomData<fn(M)>,
}

impl<M> Sender<M> {
    /// Returns the number of subscribers.
    #[must_use]
    pub fn subscribers(&self) -> usize {
        self.publisher.subscribers()
    }

    /// Returns the counts of what has been published.
    #[must_use]
    pub const fn sent(&self) -> Sent {
        self.sent
    }
}

impl<M: Message> Sender<M> {
    /// Serialises and publishes a message.
    ///
    /// # Errors
    /// The transport does not accept the message.
    pub fn send(&mut self, message: &M) -> Result<()> {
        self.bytes.clear();
        put_cdr(message, &mut self.bytes);
        self.sent.messages += 1;
        self.sent.bytes += self.bytes.len() as u64;
        self.publisher
            .publish(&self.bytes)
            .with_context(|| format!("publishing {}", M::TYPE.name))
    }
}

/// Timer for something that is repeated at an interval.
pub struct Now {
    every: Duration,
    last: Instant,
}

impl Now {
    /// Creates a timer that is due once per interval, counted from now.
    #[must_use]
    pub fn every(every: Duration) -> Self {
        Self {
            every,
            last: Instant::now(),
        }
    }

    /// Returns whether the interval has elapsed, and if so starts the next one.
    pub fn is_due(&mut self) -> bool {
        let is_due = self.last.elapsed() >= self.every;
        if is_due {
            self.last = Instant::now();
        }
        is_due
    }
}
