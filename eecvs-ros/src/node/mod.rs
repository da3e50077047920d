//! The nodes: one file each, named as its command is.
//!
//! ```text
//! emulate, bridge --events--> encode --frames--> decode --decoded/events, volume, image-->
//!                     +-----> density --density, /diagnostics-->
//! frames --> log
//! ```
//!
//! Topics are relative to the namespace, which is `/event_camera` unless `-r __ns:=` says otherwise: one namespace
//! for each camera. A driver that is called `event_camera` publishes `~/events` there.

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

use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::Args;
use usb_bridge::stop::Stop;

use crate::arguments::NodeArguments;
use crate::message::{Malformed, Message, Type, from_cdr, put_cdr};
use crate::transport::{self, Publisher, Qos, Subscription, Transport};

/// The namespace of the nodes of one camera.
pub const NAMESPACE: &str = "/event_camera";

/// Care that a topic's messages get.
#[derive(Debug, Clone, Copy, Args)]
pub struct QosOptions {
    /// Messages that wait for this node; beyond, the oldest are let go of
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    depth: u32,

    /// Have lost messages sent again, where the other side asks for it too; of a slow link the publisher then
    /// waits
    #[arg(long)]
    reliable: bool,
}

impl QosOptions {
    /// As transports take it.
    #[must_use]
    pub const fn qos(self) -> Qos {
        Qos {
            depth: self.depth as usize,
            reliable: self.reliable,
        }
    }
}

/// What a node has at hand.
pub struct Context {
    arguments: NodeArguments,
    node: Box<dyn transport::Node>,
    /// The wish to stop.
    pub stop: Stop,
}

impl Context {
    /// Announces a node; `parameters` are told to those who ask.
    ///
    /// # Errors
    /// The network cannot be used.
    pub fn new(
        transport: &dyn Transport,
        arguments: NodeArguments,
        parameters: &[(String, String)],
        stop: Stop,
    ) -> Result<Self> {
        let node = transport.node(&arguments.name, parameters)?;
        Ok(Self {
            arguments,
            node,
            stop,
        })
    }

    /// The node's own name, for messages.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.arguments.name.base
    }

    /// Begins to publish.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow, or the transport refuses.
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

    /// Begins to receive, as messages come.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow, or the transport refuses.
    pub fn subscription<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
    ) -> Result<Box<dyn Subscription>> {
        let topic = self.arguments.topic(topic)?;
        self.node.subscription(&topic, M::TYPE, qos)
    }

    /// The absolute name of a topic, remapped.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow.
    pub fn topic(&self, name: &str) -> Result<String> {
        self.arguments.topic(name)
    }

    /// Begins to publish messages that are bytes already, on a topic of this absolute name.
    ///
    /// # Errors
    /// The transport refuses.
    pub fn publisher_of(
        &mut self,
        topic: &str,
        kind: Type,
        qos: Qos,
    ) -> Result<Box<dyn Publisher>> {
        self.node.publisher(topic, kind, qos)
    }

    /// Begins to receive messages that stay bytes, of a topic of this absolute name.
    ///
    /// # Errors
    /// The transport refuses.
    pub fn subscription_of(
        &mut self,
        topic: &str,
        kind: Type,
        qos: Qos,
    ) -> Result<Box<dyn Subscription>> {
        self.node.subscription(topic, kind, qos)
    }

    /// One line on stderr.
    pub fn say(&self, line: &str) {
        eprintln!("eecvs-ros: {}: {line}", self.arguments.name.full());
    }

    /// Waits until somebody has subscribed, or it is to stop, or the time has run.
    pub fn wait_for_subscriber<M>(&self, sender: &Sender<M>, most: Duration) {
        self.wait_until(most, || sender.subscribers() > 0);
    }

    /// Waits until somebody `is_there`, or it is to stop, or the time has run.
    pub fn wait_until(&self, most: Duration, is_there: impl Fn() -> bool) {
        let started = Instant::now();
        while !is_there() && !self.stop.is_asked() && started.elapsed() < most {
            std::thread::sleep(Duration::from_millis(10));
        }
        if !most.is_zero() && is_there() {
            // It may find this node a moment later than it was found.
            std::thread::sleep(Duration::from_millis(300));
        }
    }
}

/// What has been published.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Sent {
    /// Messages.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// Publishes messages of one type.
pub struct Sender<M> {
    publisher: Box<dyn Publisher>,
    bytes: Vec<u8>,
    sent: Sent,
    kind: std::marker::PhantomData<fn(M)>,
}

impl<M> Sender<M> {
    /// How many have subscribed.
    #[must_use]
    pub fn subscribers(&self) -> usize {
        self.publisher.subscribers()
    }

    /// What has been published.
    #[must_use]
    pub const fn sent(&self) -> Sent {
        self.sent
    }
}

impl<M: Message> Sender<M> {
    /// Publishes a message.
    ///
    /// # Errors
    /// The transport does not take it.
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

/// The next message of a subscription, if one comes in time.
///
/// # Errors
/// The subscription has ended. Bytes that are no such message are the inner one.
pub fn receive<M: Message>(
    subscription: &mut dyn Subscription,
    wait: Duration,
) -> Result<Option<Result<M, Malformed>>> {
    Ok(subscription.take(wait)?.map(|cdr| from_cdr(&cdr)))
}

/// Something that is said now and then.
pub struct Now {
    every: Duration,
    last: Instant,
}

impl Now {
    /// So often.
    #[must_use]
    pub fn every(every: Duration) -> Self {
        Self {
            every,
            last: Instant::now(),
        }
    }

    /// Whether it is time again.
    pub fn is_due(&mut self) -> bool {
        let is_due = self.last.elapsed() >= self.every;
        if is_due {
            self.last = Instant::now();
        }
        is_due
    }
}
