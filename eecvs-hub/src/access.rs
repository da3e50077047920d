//! Who may what: a list beside the keys, and the rules that a hub makes of it.
//!
//! ```toml
//! hubs = ["north", "south"]
//! sensors = ["hall-1/left", "hall-1/right"]
//!
//! [receivers]
//! desk = ["hall-1/**"]
//! ```
//!
//! A certificate's common name is `hub:NAME`, `sensor:NAME` or `receiver:NAME`. A sensor speaks under its own name
//! alone, a receiver hears the names that are listed, and asks them for frames again; hubs may everything. Who has a
//! good certificate and is not listed may nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};

use crate::key::{self, Kind, Name};

/// The file's name in the folder of keys.
pub const FILE: &str = "access.toml";

/// What tokens of receivers begin with.
pub const RECEIVERS: &str = "eecvs-receivers";

/// The list.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Access {
    /// Hubs' names.
    pub hubs: Vec<String>,
    /// Sensors' names.
    pub sensors: Vec<Name>,
    /// What receivers may hear.
    pub receivers: BTreeMap<String, Vec<String>>,
}

/// Who somebody is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Role {
    /// A router.
    Hub(String),
    /// Somebody who sends.
    Sensor(Name),
    /// Somebody who receives.
    Receiver(String),
}

impl Role {
    /// The common name of its certificate.
    #[must_use]
    pub fn common_name(&self) -> String {
        match self {
            Self::Hub(name) => format!("hub:{name}"),
            Self::Sensor(name) => format!("sensor:{name}"),
            Self::Receiver(name) => format!("receiver:{name}"),
        }
    }
}

/// What Zenoh takes as `access_control`.
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

/// From a client to the hub, and back.
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

impl Access {
    /// Reads the list of a folder; an empty one where there is none.
    ///
    /// # Errors
    /// The file cannot be read, or is no list.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = file(folder);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Self::default());
            }
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        let access: Self = toml::from_str(&text).with_context(|| path.display().to_string())?;
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
            "# Who may connect; a hub reads it when it starts. Who is taken out of it may nothing any more.\n{}",
            toml::to_string(self)?
        );
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    }

    /// Adds somebody; a receiver with the names that it may hear.
    pub fn add(&mut self, role: &Role, hears: &[String]) {
        match role {
            Role::Hub(name) => insert(&mut self.hubs, name),
            Role::Sensor(name) => insert(&mut self.sensors, name),
            Role::Receiver(name) => {
                self.receivers.insert(name.clone(), hears.to_vec());
            }
        }
    }

    /// The rules.
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
            rules.allow(
                &Role::Sensor(name.clone()),
                [
                    (
                        &["put"],
                        IN,
                        vec![name.key(Kind::Frames), name.key(Kind::Status)],
                    ),
                    (&["declare_queryable", "reply"], IN, key(Kind::Again)),
                    (&["liveliness_token"], IN, key(Kind::Alive)),
                    (&["declare_subscriber"], IN, key(Kind::Budget)),
                    (&["put"], OUT, key(Kind::Budget)),
                    (&["query"], OUT, key(Kind::Again)),
                    // Whoever publishes is told that somebody hears it, by keys that may stand for many sensors.
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
            rules.allow(
                &Role::Receiver(name.clone()),
                [
                    (&["declare_subscriber"], IN, keys(&heard)),
                    (&["query"], IN, keys(&[Kind::Again])),
                    (
                        &["liveliness_query", "declare_liveliness_subscriber"],
                        IN,
                        keys(&[Kind::Alive]),
                    ),
                    (&["liveliness_token"], IN, vec![format!("{RECEIVERS}/**")]),
                    (&["put"], OUT, keys(&heard)),
                    (&["reply", "declare_queryable"], OUT, keys(&[Kind::Again])),
                    (&["liveliness_token"], OUT, keys(&[Kind::Alive])),
                ],
            );
        }
        // Zenoh wants no empty lists: nobody has this name, as no certificate has it.
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
        // Nobody listed: everything is denied all the same.
        assert!(Access::default().rules().enabled);
    }
}
