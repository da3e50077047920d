//! `record`: records topics into a bag.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::Args;

use super::{Context, LossOptions, Now, QosOptions, refuse_losses};
use crate::bag::{Storage, Topic, Writer};
use crate::message::{TYPES, Time, Type, sequence_of};
use crate::sequence::Sequence;
use crate::transport::{Known, NAMED, PUBLISHERS_MAX, PublisherId, Subscription, UNNAMED};

/// Record topics into a ROS 2 bag
#[derive(Debug, Clone, Args)]
pub struct Record {
    /// Folder to create
    #[arg(short, long, value_name = "BAG")]
    output: PathBuf,

    /// Storage format of the messages
    #[arg(long, value_enum, default_value = "mcap")]
    storage: Storage,

    /// Topics, each with its type: /dvs/events:event_camera_msgs/msg/EventPacket
    #[arg(long, value_name = "NAME:TYPE", value_parser = topic,
          default_values = ["events:event_camera_msgs/msg/EventPacket", "frames:eecvs_msgs/msg/Frame",
                            "density:eecvs_msgs/msg/Density"])]
    topic: Vec<(String, Type)>,

    /// End after this many seconds
    #[arg(long, value_name = "S")]
    duration_s: Option<u32>,

    /// End after this many seconds without messages, once one has arrived
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    losses: LossOptions,

    #[command(flatten)]
    qos: QosOptions,
}

/// Longest wait for the messages of one topic while those of others may be waiting.
const WAIT: Duration = Duration::from_millis(5);

fn topic(text: &str) -> Result<(String, Type), String> {
    let (name, kind) = text
        .split_once(':')
        .ok_or_else(|| "expected NAME:TYPE".to_owned())?;
    let known = Type::of(kind);
    let known = known.ok_or_else(|| {
        let names: Vec<&str> = TYPES.iter().map(|known| known.name).collect();
        format!("unknown type {kind}; known types: {}", names.join(", "))
    })?;
    Ok((name.to_owned(), known))
}

/// A topic being recorded.
struct Recorded {
    name: String,
    kind: Type,
    subscription: Box<dyn Subscription>,
    /// The numbers of each publisher's messages.
    publishers: HashMap<PublisherId, Sequence>,
    /// Whether the publishers have been named.
    is_reported: bool,
    /// When the second publisher came, whose name may become known a little later.
    second: Option<Instant>,
    messages: u64,
    /// Messages that could not be read, and are not in the bag.
    unreadable: u64,
}

impl Recorded {
    fn lost(&self) -> u64 {
        self.publishers.values().map(|sequence| sequence.lost).sum()
    }

    /// Counts a message; messages of each publisher are numbered on their own.
    fn count(&mut self, cdr: &[u8], publisher: PublisherId) {
        self.messages += 1;
        let publisher = match self.publishers.len() {
            PUBLISHERS_MAX.. if !self.publishers.contains_key(&publisher) => PublisherId::default(),
            _ => publisher,
        };
        let sequence = self.publishers.entry(publisher).or_default();
        if let Some(number) = sequence_of(self.kind, cdr) {
            sequence.follow(number);
        }
        if self.publishers.len() > 1 {
            self.second.get_or_insert_with(Instant::now);
        }
    }

    /// Names the publishers if there are several.
    fn tell(&mut self, context: &Context, is_over: bool) {
        let Some(second) = self.second.filter(|_| !self.is_reported) else {
            return;
        };
        let known: Vec<Known> = self
            .publishers
            .keys()
            .map(|id| self.subscription.publisher(*id))
            .collect();
        // A publisher that has gone was followed by its successor.
        let mut names: Vec<String> = known
            .iter()
            .filter_map(|known| match known {
                Known::Node(name) => Some(name.clone()),
                Known::Unnamed => Some(UNNAMED.to_owned()),
                Known::Gone => None,
            })
            .collect();
        let is_named = !known.contains(&Known::Unnamed);
        if !is_named && !is_over && second.elapsed() < NAMED {
            return;
        }
        self.is_reported = true;
        if names.len() > 1 {
            names.sort();
            context.say(&format!(
                "{} has several publishers, and the bag holds the messages of all of them: {}",
                self.name,
                names.join(", ")
            ));
        }
    }
}

impl Record {
    /// Records until a stop is requested, or until the set or the idle time is over.
    ///
    /// # Errors
    /// The folder exists already or cannot be written, the transport fails, or something was lost and the options do
    /// not allow it.
    pub fn run(self, mut context: Context) -> Result<()> {
        let qos = self.qos.qos();
        let mut recorded = Vec::new();
        let mut topics = Vec::new();
        for (name, kind) in &self.topic {
            let name = context.topic(name)?;
            topics.push((
                Topic {
                    name: name.clone(),
                    kind: kind.name.to_owned(),
                    ..Topic::default()
                },
                *kind,
            ));
            recorded.push(Recorded {
                subscription: context.subscription_of(&name, *kind, qos)?,
                name,
                kind: *kind,
                publishers: HashMap::new(),
                is_reported: false,
                second: None,
                messages: 0,
                unreadable: 0,
            });
        }
        let mut writer = Writer::create(&self.output, self.storage, topics)?;
        let written = self.write(&context, &mut recorded, &mut writer);
        for topic in &mut recorded {
            topic.tell(&context, true);
        }
        // Complete the bag even after an error, so that what was recorded before it can be read.
        let messages = writer.messages();
        writer.finish()?;
        written?;
        for topic in &recorded {
            context.say(&format!(
                "{}: {} messages, {} lost, {} left out",
                topic.name,
                topic.messages,
                topic.lost(),
                topic.unreadable
            ));
        }
        context.say(&format!("{}: {messages} messages", self.output.display()));
        let losses = [
            (
                recorded.iter().map(Recorded::lost).sum(),
                "messages have not arrived",
            ),
            (
                recorded.iter().map(|topic| topic.unreadable).sum(),
                "messages could not be read",
            ),
        ];
        refuse_losses(self.losses.allow_loss, &losses)
    }

    fn write(
        &self,
        context: &Context,
        recorded: &mut [Recorded],
        writer: &mut Writer,
    ) -> Result<()> {
        let started = Instant::now();
        let duration = self.duration_s.map(|s| Duration::from_secs(s.into()));
        let idle = self.idle_s.map(|s| Duration::from_secs(s.into()));
        let mut latest = None;
        let mut tell = Now::every(Duration::from_secs(5));
        let mut told = 0;
        while !context.stop.is_asked() {
            let is_over = duration.is_some_and(|duration| started.elapsed() >= duration);
            let is_idle = latest
                .zip(idle)
                .is_some_and(|(at, idle): (Instant, _)| at.elapsed() >= idle);
            if is_over || is_idle {
                break;
            }
            for (number, topic) in recorded.iter_mut().enumerate() {
                let mut wait = WAIT;
                // Take everything that is waiting before turning to the next topic.
                while let Some((cdr, publisher)) = topic.subscription.take_from(wait)? {
                    wait = Duration::ZERO;
                    latest = Some(Instant::now());
                    if cdr.is_empty() {
                        topic.unreadable += 1;
                        continue;
                    }
                    topic.count(&cdr, publisher);
                    let now_ns = u64::try_from(Time::now().ns()).context(
                        "the computer's clock is \
                                                                          before 1970",
                    )?;
                    writer.message(number, now_ns, &cdr)?;
                }
                topic.tell(context, false);
            }
            if tell.is_due() {
                let lost = recorded.iter().map(Recorded::lost).sum();
                if lost > told {
                    context.say(&format!("{lost} messages have not arrived"));
                    told = lost;
                }
            }
        }
        Ok(())
    }
}
