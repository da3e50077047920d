//! A bag's `metadata.yaml`.
//!
//! It has version 8, the newest that Humble, Jazzy and Kilted all read. The lists of offered quality-of-service
//! profiles are empty, here as in the message files, which must agree with it: a player then uses its default.

use std::path::Path;

use anyhow::{Context, Result};
use event_types::stream::small_file::read_text;
use serde::Deserialize;

use super::{Storage, Topic};
use crate::message::Type;

/// Name of the file that makes a folder a bag.
pub const METADATA: &str = "metadata.yaml";

/// Empty list of offered quality-of-service profiles.
pub const OFFERS: &str = "[]";

/// Value of the field for the ROS distribution that wrote the bag.
pub const WRITTEN_BY: &str = "eecvs";

/// Version of the metadata format.
pub const VERSION: i64 = 8;

/// Largest metadata file accepted, in bytes.
const BYTES_MAX: u64 = 1 << 24;

/// Message counts and time range of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Counts {
    of_topics: Vec<u64>,
    times_ns: Option<(u64, u64)>,
}

impl Counts {
    /// Starts the counts of a bag with this number of topics.
    pub fn new(topics: usize) -> Self {
        Self {
            of_topics: vec![0; topics],
            times_ns: None,
        }
    }

    /// Counts a message and returns its number among those of its topic, from 0.
    pub fn add(&mut self, topic: usize, time_ns: u64) -> u64 {
        let (first_ns, last_ns) = self.times_ns.unwrap_or((time_ns, time_ns));
        self.times_ns = Some((first_ns.min(time_ns), last_ns.max(time_ns)));
        let Some(messages) = self.of_topics.get_mut(topic) else {
            return 0;
        };
        *messages += 1;
        *messages - 1
    }

    /// Returns the number of messages of all topics.
    pub fn messages(&self) -> u64 {
        self.of_topics.iter().sum()
    }
}

/// Returns rosbag2's `BagMetadata` of a bag with one file, as YAML.
pub fn text(storage: Storage, file: &str, topics: &[(Topic, Type)], counts: &Counts) -> String {
    let (first_ns, last_ns) = counts.times_ns.unwrap_or_default();
    let (messages, duration_ns) = (counts.messages(), last_ns - first_ns);
    let storage = storage.name();
    // A JSON string is a valid YAML string.
    let file = serde_json::Value::from(file);
    let mut listed = String::new();
    for ((topic, kind), messages) in topics.iter().zip(&counts.of_topics) {
        let (name, hash) = (&topic.name, kind.hash);
        listed += &format!(
            "  - topic_metadata:
      name: {name}
      type: {}
      serialization_format: cdr
      offered_qos_profiles: \"{OFFERS}\"
      type_description_hash: {hash}
    message_count: {messages}
",
            topic.kind
        );
    }
    format!(
        "version: {VERSION}
storage_identifier: {storage}
duration:
  nanoseconds: {duration_ns}
starting_time:
  nanoseconds_since_epoch: {first_ns}
message_count: {messages}
topics_with_message_count:
{listed}compression_format: \"\"
compression_mode: \"\"
relative_file_paths:
  - {file}
files:
  - path: {file}
    starting_time:
      nanoseconds_since_epoch: {first_ns}
    duration:
      nanoseconds: {duration_ns}
    message_count: {messages}
custom_data: ~
ros_distro: {WRITTEN_BY}
"
    )
}

/// Wraps the metadata `text` into the content of a `metadata.yaml` file.
pub fn document(text: &str) -> String {
    let lines = text.lines().map(|line| format!("  {line}\n"));
    format!(
        "rosbag2_bagfile_information:\n{}",
        lines.collect::<String>()
    )
}

#[derive(Deserialize)]
struct Document {
    rosbag2_bagfile_information: Metadata,
}

/// The part of the metadata that a reader needs.
#[derive(Debug, Deserialize)]
pub struct Metadata {
    /// Message files, in their order.
    pub relative_file_paths: Vec<String>,
}

impl Metadata {
    /// Reads the metadata of the bag in a folder.
    ///
    /// # Errors
    /// The file is missing, too long, or not the metadata of a bag.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(METADATA);
        let name = path.display();
        std::fs::metadata(&path)
            .with_context(|| format!("{name}: cannot be read: the folder is not a ROS 2 bag"))?;
        let text = read_text(&path, BYTES_MAX)?;
        // Some editors put a byte-order mark in front.
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let document: Document = serde_saphyr::from_str(text)
            .map_err(|error| anyhow::anyhow!("{name}: not the metadata of a bag: {error}"))?;
        Ok(document.rosbag2_bagfile_information)
    }
}
