//! Access control: a list next to the keys, and the rules that a hub derives from it.
//!
//! ```toml
//! hubs = ["north", "south"]
//! sensors = ["hall-1/left", "hall-1/right"]
//!
//! [receivers]
//! desk = ["hall-1/**"]
//! ```
//!
//! A certificate's common name is `hub:NAME`, `sensor:NAME` or `receiver:NAME`. A sensor may publish only under its
//! own name. A receiver may receive from the listed names, request their frames again, and ask for their clocks. Hubs
//! are permitted everything. A valid certificate whose name is not listed is permitted nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use event_types::stream::small_file::read_text;
use serde::{Deserialize, Serialize};

use crate::key::{self, Kind, Name};

/// Name of the list's file.
pub const FILE: &str = "access.toml";

/// First part of the keys of receivers' tokens.
pub const RECEIVERS: &str = "eecvs-receivers";

/// The list of who may connect.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Access {
    /// Names of the hubs.
    pub hubs: Vec<String>,
    /// Names of the sensors.
    pub sensors: Vec<Name>,
    /// For each receiver, the patterns of sensors' names that it may receive.
    pub receivers: BTreeMap<String, Vec<String>>,
}

/// A member of a fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Role {
    /// A router.
    Hub(String),
    /// A sensor, which sends frames.
    Sensor(Name),
    /// A receiver of frames.
    Receiver(String),
}

impl Role {
    /// Returns the common name of the member's certificate.
    #[must_use]
    pub fn common_name(&self) -> String {
        match self {
            Self::Hub(name) => format!("hub:{name}"),
            Self::Sensor(name) => format!("sensor:{name}"),
            Self::Receiver(name) => format!("receiver:{name}"),
        }
    }
}

/// The value of Zenoh's setting `access_control`.
#[derive(Debug, Serialize)]
pub struct Rules {
    enabled: bool,
    default_permission: &'static str,
    rules: Vec<Rule>,
    subjects: Vec<Subject>,
    policies: Vec<Policy>,
}

#[derive(Debug, Serialize)]
struct Rule {
    id: String,
    key_exprs: Vec<String>,
    messages: Vec<&'static str>,
    flows: Vec<&'static str>,
    permission: &'static str,
}

#[derive(Debug, Serialize)]
struct Subject {
    id: String,
    cert_common_names: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Policy {
    rules: Vec<String>,
    subjects: Vec<String>,
}

/// Directions of messages: from a client to the hub, and back.
const IN: &[&str] = &["ingress"];
const OUT: &[&str] = &["egress"];

const ALL_MESSAGES: &[&str] = &[
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Largest list, in bytes.
const BYTES_MAX: u64 = 16 << 20;

impl Access {
    /// Reads the list in a folder; returns an empty one if there is no file.
    ///
    /// # Errors
    /// The file cannot be read, or is not a valid list.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = file(folder);
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = read_text(&path, BYTES_MAX)?;
        // Some editors put a byte-order mark in front.
        let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
        let access: Self = toml::from_str(text).with_context(|| path.display().to_string())?;
        for names in access.receivers.values().flatten() {
            key::names(names).with_context(|| path.display().to_string())?;
        }
        Ok(access)
    }

    /// Writes the list into a folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = file(folder);
        let text = format!(
            "# Who may connect. A hub reads this file when it starts; whoever has been removed \
             from it has no access.\n{}",
            toml::to_string(self)?
        );
        Ok(event_files::output::write(&path, text)?)
    }

    /// Adds a member to the list; a receiver with the names that it may receive.
    pub fn add(&mut self, role: &Role, hears: &[String]) {
        match role {
            Role::Hub(name) => insert(&mut self.hubs, name),
            Role::Sensor(name) => insert(&mut self.sensors, name),
            Role::Receiver(name) => {
                self.receivers.insert(name.clone(), hears.to_vec());
            }
        }
    }

    /// Returns Zenoh's access rules for the list.
    #[must_use]
    pub fn rules(&self) -> Rules {
        let mut rules = Rules {
            enabled: true,
            default_permission: "deny",
            rules: Vec::new(),
            subjects: Vec::new(),
            policies: Vec::new(),
        };
        for name in &self.hubs {
            let all = || vec!["**".to_owned()];
            rules.allow(
                &Role::Hub(name.clone()),
                [(ALL_MESSAGES, IN, all()), (ALL_MESSAGES, OUT, all())],
            );
        }
        for name in &self.sensors {
            let key = |kind| vec![name.key(kind)];
            let asked = vec![name.key(Kind::Again), name.key(Kind::Clock)];
            rules.allow(
                &Role::Sensor(name.clone()),
                [
                    (
                        &["put"],
                        IN,
                        vec![name.key(Kind::Frames), name.key(Kind::Status)],
                    ),
                    (&["declare_queryable", "reply"], IN, asked.clone()),
                    (&["liveliness_token"], IN, key(Kind::Alive)),
                    (&["declare_subscriber"], IN, key(Kind::Budget)),
                    (&["put"], OUT, key(Kind::Budget)),
                    (&["query"], OUT, asked),
                    // Publishers are notified of subscribers, by key expressions that may match many sensors.
                    (&["declare_subscriber"], OUT, vec!["**".to_owned()]),
                ],
            );
        }
        for (name, hears) in &self.receivers {
            let keys = |kinds: &[Kind]| -> Vec<String> {
                let of = |names: &String| kinds.iter().map(|kind| kind.of_all(names)).collect();
                hears
                    .iter()
                    .flat_map(|names| -> Vec<String> { of(names) })
                    .collect()
            };
            let heard = [Kind::Frames, Kind::Status];
            let asked = [Kind::Again, Kind::Clock];
            rules.allow(
                &Role::Receiver(name.clone()),
                [
                    (&["declare_subscriber"], IN, keys(&heard)),
                    (&["query"], IN, keys(&asked)),
                    (
                        &["liveliness_query", "declare_liveliness_subscriber"],
                        IN,
                        keys(&[Kind::Alive]),
                    ),
                    (&["liveliness_token"], IN, vec![format!("{RECEIVERS}/**")]),
                    (&["put"], OUT, keys(&heard)),
                    (&["reply", "declare_queryable"], OUT, keys(&asked)),
                    (&["liveliness_token"], OUT, keys(&[Kind::Alive])),
                ],
            );
        }
        // Zenoh rejects empty lists: allow a name that no certificate has.
        if rules.rules.is_empty() {
            let nobody = Role::Hub(String::new());
            rules.allow(&nobody, [(ALL_MESSAGES, IN, vec!["**".to_owned()])]);
        }
        rules
    }
}

impl Rules {
    fn allow<const N: usize>(
        &mut self,
        role: &Role,
        allowed: [(&[&'static str], &[&'static str], Vec<String>); N],
    ) {
        let subject = role.common_name();
        let mut ids = Vec::new();
        for (number, (messages, flows, key_exprs)) in allowed.into_iter().enumerate() {
            if key_exprs.is_empty() {
                continue;
            }
            let id = format!("{subject} {number}");
            ids.push(id.clone());
            self.rules.push(Rule {
                id,
                key_exprs,
                messages: messages.to_vec(),
                flows: flows.to_vec(),
                permission: "allow",
            });
        }
        if ids.is_empty() {
            return;
        }
        self.subjects.push(Subject {
            id: subject.clone(),
            cert_common_names: vec![subject.clone()],
        });
        self.policies.push(Policy {
            rules: ids,
            subjects: vec![subject],
        });
    }
}

fn file(folder: &Path) -> PathBuf {
    folder.join(FILE)
}

fn insert<T: Clone + Ord>(list: &mut Vec<T>, item: &T) {
    if let Err(at) = list.binary_search(item) {
        list.insert(at, item.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Access::read(folder.path()).unwrap(), Access::default());
        let mut access = Access::default();
        access.add(&Role::Hub("north".to_owned()), &[]);
        for name in ["b", "a/c", "b"] {
            access.add(&Role::Sensor(name.parse().unwrap()), &[]);
        }
        access.add(&Role::Receiver("desk".to_owned()), &["a/**".to_owned()]);
        access.write(folder.path()).unwrap();
        assert_eq!(access.sensors.len(), 2);
        assert_eq!(Access::read(folder.path()).unwrap(), access);
        // As editors of Windows save it.
        let path = folder.path().join(FILE);
        let text = std::fs::read_to_string(&path)
            .unwrap()
            .replace('\n', "\r\n");
        std::fs::write(&path, format!("\u{feff}{text}")).unwrap();
        assert_eq!(Access::read(folder.path()).unwrap(), access);
        for bad in [
            "hubs = 1",
            "sensors = [\"a b\"]",
            "[receivers]\nx = [\"a//b\"]",
            "other = 1",
        ] {
            std::fs::write(folder.path().join(FILE), bad).unwrap();
            assert!(Access::read(folder.path()).is_err(), "{bad}");
        }
    }

    #[test]
    fn nobody_is_allowed_what_is_another_ones() {
        let mut access = Access::default();
        access.add(&Role::Sensor("a".parse().unwrap()), &[]);
        access.add(&Role::Receiver("desk".to_owned()), &["a/**".to_owned()]);
        access.add(&Role::Receiver("deaf".to_owned()), &[]);
        let rules = access.rules();
        let puts = |subject: &str, flow| -> Vec<String> {
            rules
                .rules
                .iter()
                .filter(|rule| rule.id.starts_with(subject))
                .filter(|rule| rule.messages.contains(&"put") && rule.flows.contains(&flow))
                .flat_map(|rule| rule.key_exprs.clone())
                .collect()
        };
        assert_eq!(
            puts("sensor:a ", "ingress"),
            ["eecvs/a/frames", "eecvs/a/status"]
        );
        assert!(puts("receiver:", "ingress").is_empty());
        assert_eq!(
            puts("receiver:desk ", "egress"),
            ["eecvs/a/**/frames", "eecvs/a/**/status"]
        );
        assert_eq!(rules.default_permission, "deny");
        // With an empty list, everything is still denied.
        assert!(Access::default().rules().enabled);
    }
}
