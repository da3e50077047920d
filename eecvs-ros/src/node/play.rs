//! `play`: publishes the messages of a bag.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use event_files::ros::message::Kind;
use usb_bridge::peripheral::stream::Pace;

use super::emulate::Pacer;
use super::{Context, LossOptions, QosOptions, refuse_losses};
use crate::bag::event_array::Packets;
use crate::bag::{CDR, Reader, Topic};
use crate::message::{ENCAPSULATION, EventPacket, Message as _, Type, TypeName, put_cdr};
use crate::transport::Publisher;

/// Parameters that can be set while the node runs.
pub const CHANGEABLE: &[&str] = &["rate"];

/// Publish the messages of a bag on their topics, as they were received
#[derive(Debug, Clone, Args)]
pub struct Play {
    /// Bag: a folder with metadata.yaml, an .mcap file or a .db3 file
    #[arg(value_name = "BAG")]
    bag: PathBuf,

    /// Pace: real (as recorded), max (as fast as possible), N messages per second, or Fx (F times as fast)
    #[arg(long, value_name = "real|max|N|Fx", default_value = "real")]
    rate: Pace,

    /// Start this many seconds after the bag's start
    #[arg(long, value_name = "S", default_value_t = 0.0)]
    start_s: f64,

    /// Start again at the end
    #[arg(long)]
    repeat: bool,

    /// Wait at most this many seconds for a subscriber to each topic
    #[arg(long, value_name = "S", default_value_t = 0)]
    wait_s: u32,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// A topic of the bag.
struct Played {
    topic: Topic,
    /// `None` if its messages are left out.
    publisher: Option<Box<dyn Publisher>>,
    /// Turns structures of single events into packets; `None` for messages that are published as they are.
    packets: Option<Packets>,
    /// Messages that were left out, and why the first of them was.
    left_out: u64,
    why: Option<String>,
}

impl Played {
    /// Announces a topic; if its messages are left out, says why.
    fn new(context: &mut Context, topic: Topic, options: &Play) -> Self {
        let mut played = Self {
            packets: None,
            publisher: None,
            left_out: 0,
            why: None,
            topic,
        };
        let Topic {
            name,
            kind,
            encoding,
            hash,
        } = &played.topic;
        // Some writers leave the middle out.
        let kind = match kind.split_once('/') {
            Some((package, base)) if !base.contains('/') => format!("{package}/msg/{base}"),
            _ => kind.clone(),
        };
        let refusal = if encoding != CDR {
            Some(format!(
                "is serialised as {encoding:?}: `eecvs convert` writes its events to a ROS 2 bag"
            ))
        } else if !kind.contains("/msg/") {
            Some(format!("has no ROS 2 type ({kind:?})"))
        } else {
            None
        };
        let published = match (refusal, Kind::of(&kind)) {
            (Some(refusal), _) => Err(refusal),
            (None, Some(events)) => {
                if kind != EventPacket::TYPE.name {
                    let own = EventPacket::TYPE.name;
                    context.say(&format!("{name}: {kind} is published as {own}"));
                }
                played.packets = (events == Kind::EventArray).then(Packets::default);
                Ok(EventPacket::TYPE.into())
            }
            (None, None) => {
                let known = Type::of(&kind).map(TypeName::from);
                Ok(known.unwrap_or(TypeName { name: &kind, hash }))
            }
        };
        let qos = options.qos.qos();
        let published = published.and_then(|kind| {
            let publisher = context
                .topic(name)
                .and_then(|topic| context.publisher_of(&topic, kind, qos));
            publisher.map_err(|error| format!("cannot be published: {error:#}"))
        });
        match published {
            Err(why) => context.say(&format!("{name} {why}; its messages are left out")),
            Ok(publisher) => {
                context.wait_until(Duration::from_secs(options.wait_s.into()), || {
                    publisher.subscribers() > 0
                });
                played.publisher = Some(publisher);
            }
        }
        played
    }

    /// Publishes a message; returns whether that was possible.
    fn publish(&mut self, cdr: &[u8]) -> Result<bool> {
        let Some(publisher) = &mut self.publisher else {
            return Ok(false);
        };
        if let Some(packets) = &mut self.packets {
            let packets = match packets.convert(cdr) {
                Ok(packets) => packets,
                Err(why) => {
                    self.why.get_or_insert_with(|| format!("{why:#}"));
                    return Ok(false);
                }
            };
            let mut bytes = Vec::new();
            for packet in &packets {
                bytes.clear();
                put_cdr(packet, &mut bytes);
                publisher.publish(&bytes)?;
            }
            return Ok(true);
        }
        if !cdr.starts_with(&ENCAPSULATION[..2]) {
            let why = "it is big-endian, or of another version of CDR";
            self.why.get_or_insert_with(|| why.to_owned());
            return Ok(false);
        }
        publisher.publish(cdr)?;
        Ok(true)
    }
}

impl Play {
    /// Plays until the end, or until a stop is requested.
    ///
    /// # Errors
    /// The path is not a bag, the bag is damaged, the transport fails, or messages were left out and the options do
    /// not allow it.
    pub fn run(self, mut context: Context) -> Result<()> {
        ensure!(
            self.start_s.is_finite() && self.start_s >= 0.0,
            "start_s is {}: give seconds from the bag's start",
            self.start_s
        );
        let mut topics: Vec<Played> = Vec::new();
        let mut messages = 0_u64;
        let played = self.play(&mut context, &mut topics, &mut messages);
        let left_out: u64 = topics.iter().map(|topic| topic.left_out).sum();
        context.say(&format!("{messages} messages, {left_out} left out"));
        for topic in topics.iter().filter(|topic| topic.left_out > 0) {
            let Topic { name, kind, .. } = &topic.topic;
            let why = topic.why.as_ref();
            let why = why.map_or_else(String::new, |why| format!("; the first: {why}"));
            context.say(&format!(
                "{name}: {} messages of {kind} were left out{why}",
                topic.left_out
            ));
        }
        // Everything before the damage has been played.
        played?;
        let is_empty = messages == 0 && left_out == 0 && !context.stop.is_asked();
        ensure!(
            !is_empty,
            "{}: there are no messages to play{}",
            self.bag.display(),
            if self.start_s > 0.0 {
                format!(" from {} s on", self.start_s)
            } else {
                String::new()
            }
        );
        refuse_losses(
            self.losses.allow_loss,
            &[(left_out, "messages were left out")],
        )
    }

    fn play(
        &self,
        context: &mut Context,
        topics: &mut Vec<Played>,
        messages: &mut u64,
    ) -> Result<()> {
        let mut from_ns = 0;
        let mut pacer = Pacer::new(self.rate);
        if self.start_s > 0.0 {
            let Some(first) = Reader::open(&self.bag, 0)?.next_message()? else {
                return Ok(());
            };
            let start_ns = (self.start_s * 1e9) as u64;
            from_ns = first.time_ns.saturating_add(start_ns);
        }
        loop {
            let mut reader = Reader::open(&self.bag, from_ns)?;
            let before = *messages;
            pacer.restart();
            while let Some(stored) = reader.next_message()? {
                for topic in reader.topics().get(topics.len()..).unwrap_or_default() {
                    topics.push(Played::new(context, topic.clone(), self));
                }
                loop {
                    let is_disturbed = || context.stop.is_asked() || context.has_changed();
                    pacer.wait(stored.time_ns / 1000, *messages + 1, &is_disturbed);
                    match context.changed::<Self>() {
                        Some(now) => pacer.set(now.rate),
                        None => break,
                    }
                }
                if context.stop.is_asked() {
                    return Ok(());
                }
                if let Some(topic) = topics.get_mut(stored.topic) {
                    match topic.publish(&stored.cdr)? {
                        true => *messages += 1,
                        false => topic.left_out += 1,
                    }
                }
            }
            // A bag with nothing to play would be repeated without end or pause.
            if !self.repeat || *messages == before {
                return Ok(());
            }
        }
    }
}
