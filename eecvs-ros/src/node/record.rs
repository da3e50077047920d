//! `record`: records topics into a bag.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result};
use clap::Args;

use super::{Context, Now, QosOptions};
use crate::bag::{Storage, Topic, Writer};
use crate::message::{TYPES, Time, Type, sequence_of};
use crate::sequence::Sequence;
use crate::transport::Subscription;

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

    /// End after this many seconds without messages, once there was one
    #[arg(long, value_name = "S")]
    idle_s: Option<u32>,

    #[command(flatten)]
    qos: QosOptions,
}

/// Longest wait for the messages of one topic while those of others may be waiting.
const WAIT: Duration = Duration::from_millis(5);

fn topic(text: &str) -> Result<(String, Type), String> {
    let (name, kind) = text
        .split_once(':')
        .ok_or_else(|| "a name, a colon, a type".to_owned())?;
    let known = TYPES.into_iter().find(|known| known.name == kind);
    let known = known.ok_or_else(|| {
        let names: Vec<&str> = TYPES.iter().map(|known| known.name).collect();
        format!("type {kind} is not known here: {}", names.join(", "))
    })?;
    Ok((name.to_owned(), known))
}

/// A topic being recorded.
struct Recorded {
    name: String,
    kind: Type,
    subscription: Box<dyn Subscription>,
    sequence: Sequence,
    messages: u64,
}

impl Record {
    /// Records until a stop is requested, or until the set or the idle time is over.
    ///
    /// # Errors
    /// The folder exists already or cannot be written, or the transport fails.
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
                },
                *kind,
            ));
            recorded.push(Recorded {
                subscription: context.subscription_of(&name, *kind, qos)?,
                name,
                kind: *kind,
                sequence: Sequence::default(),
                messages: 0,
            });
        }
        let mut writer = Writer::create(&self.output, self.storage, topics)?;
        let written = self.write(&context, &mut recorded, &mut writer);
        // Complete the bag even after an error, so that what was recorded before it can be read.
        let messages = writer.messages();
        writer.finish()?;
        written?;
        for topic in &recorded {
            context.say(&format!(
                "{}: {} messages, {} lost",
                topic.name, topic.messages, topic.sequence.lost
            ));
        }
        context.say(&format!("{}: {messages} messages", self.output.display()));
        Ok(())
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
                while let Some(cdr) = topic.subscription.take(wait)? {
                    wait = Duration::ZERO;
                    latest = Some(Instant::now());
                    if let Some(sequence) = sequence_of(topic.kind, &cdr) {
                        topic.sequence.follow(sequence);
                    }
                    topic.messages += 1;
                    let now_ns = u64::try_from(Time::now().ns()).context("a time before 1970")?;
                    writer.message(number, now_ns, &cdr)?;
                }
            }
            if tell.is_due() {
                let lost = recorded.iter().map(|topic| topic.sequence.lost).sum();
                if lost > told {
                    context.say(&format!("{lost} messages have not come"));
                    told = lost;
                }
            }
        }
        Ok(())
    }
}
