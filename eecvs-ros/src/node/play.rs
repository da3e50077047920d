//! `play`: publishes the messages of a bag.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, ensure};
use clap::Args;
use usb_bridge::peripheral::stream::Pace;

use super::emulate::Pacer;
use super::{Context, QosOptions};
use crate::bag::Reader;
use crate::transport::Publisher;

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
    qos: QosOptions,
}

impl Play {
    /// Plays until the end, or until a stop is requested.
    ///
    /// # Errors
    /// The path is not a bag, the bag is damaged or has no messages of known types, or the transport fails.
    pub fn run(self, mut context: Context) -> Result<()> {
        ensure!(
            self.start_s.is_finite() && self.start_s >= 0.0,
            "start_s is {}: give seconds from the bag's start",
            self.start_s
        );
        let mut publishers: Vec<Option<Box<dyn Publisher>>> = Vec::new();
        let mut from_ns = None;
        let (mut messages, mut unknown) = (0_u64, 0_u64);
        let mut pacer = Pacer::new(self.rate);
        loop {
            let mut reader = Reader::open(&self.bag, from_ns.unwrap_or(0))?;
            if from_ns.is_none() {
                let Some(first) = reader.next_message()? else {
                    break;
                };
                let start_ns = (self.start_s * 1e9) as u64;
                from_ns = Some(first.time_ns.saturating_add(start_ns));
                reader = Reader::open(&self.bag, from_ns.unwrap_or(0))?;
            }
            pacer.restart();
            while let Some(stored) = reader.next_message()? {
                for topic in &reader.topics()[publishers.len()..] {
                    let Some(kind) = topic.known() else {
                        context.say(&format!(
                            "{}: type {} is not known here: its messages are left out",
                            topic.name, topic.kind
                        ));
                        publishers.push(None);
                        continue;
                    };
                    let name = context.topic(&topic.name)?;
                    let publisher = context.publisher_of(&name, kind, self.qos.qos())?;
                    context.wait_until(Duration::from_secs(self.wait_s.into()), || {
                        publisher.subscribers() > 0
                    });
                    publishers.push(Some(publisher));
                }
                if context.stop.is_asked() {
                    break;
                }
                match publishers.get_mut(stored.topic) {
                    Some(Some(publisher)) => {
                        pacer.wait(stored.time_ns / 1000, messages + 1, &context.stop);
                        publisher.publish(&stored.cdr)?;
                        messages += 1;
                    }
                    _ => unknown += 1,
                }
            }
            if !self.repeat || context.stop.is_asked() {
                break;
            }
        }
        context.say(&format!(
            "{messages} messages, {unknown} of unknown types left out"
        ));
        ensure!(
            messages > 0 || context.stop.is_asked(),
            "{}: no message was played: {unknown} are of types that are not known here, and there are no others",
            self.bag.display()
        );
        Ok(())
    }
}
