//! Names of nodes and topics, as ROS 2 resolves them.
//!
//! `events` is relative to the node's namespace, `~/events` is relative to the node, and `/events` is absolute;
//! `--remap` rules apply to the resolved name.

use anyhow::{Result, ensure};

/// Longest name of a node without its namespace, as in ROS 2.
const NODE_BYTES_MAX: usize = 255;

/// Name and namespace of a node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeName {
    /// `/`, or tokens that are each preceded by `/`.
    pub namespace: String,
    /// A single token.
    pub base: String,
}

impl NodeName {
    /// Checks both names; adds a missing `/` in front of the namespace.
    ///
    /// # Errors
    /// ROS 2 does not allow a name.
    pub fn new(namespace: &str, base: &str) -> Result<Self> {
        check_token(base)?;
        ensure!(
            base.len() <= NODE_BYTES_MAX,
            "the node's name has {} characters: at most {NODE_BYTES_MAX} are allowed",
            base.len()
        );
        let tokens = namespace.trim_matches('/');
        let namespace = format!("/{tokens}");
        if !tokens.is_empty() {
            check_tokens(&namespace)?;
        }
        Ok(Self {
            namespace,
            base: base.to_owned(),
        })
    }

    /// Returns namespace and name joined: `/event_camera/encode`.
    #[must_use]
    pub fn full(&self) -> String {
        join(&self.namespace, &self.base)
    }

    /// Returns the absolute name of a topic.
    ///
    /// # Errors
    /// ROS 2 does not allow the name.
    pub fn resolve(&self, topic: &str) -> Result<String> {
        let absolute = if let Some(rest) = topic.strip_prefix("~/") {
            join(&self.full(), rest)
        } else if topic.starts_with('/') {
            topic.to_owned()
        } else {
            join(&self.namespace, topic)
        };
        check_tokens(&absolute)?;
        Ok(absolute)
    }
}

fn join(namespace: &str, name: &str) -> String {
    format!("{}/{name}", namespace.trim_end_matches('/'))
}

fn check_tokens(absolute: &str) -> Result<()> {
    let tokens = absolute.strip_prefix('/').unwrap_or(absolute);
    tokens.split('/').try_for_each(check_token)
}

/// Checks one token: letters, digits and `_`, not beginning with a digit.
fn check_token(token: &str) -> Result<()> {
    let is_good = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let is_digit_first = token.starts_with(|c: char| c.is_ascii_digit());
    ensure!(
        !token.is_empty() && token.chars().all(is_good) && !is_digit_first,
        "{token:?} is not a valid part of a ROS 2 name: use letters, digits and _, with no digit first"
    );
    // The DDS used here refuses names of topics and nodes that contain these.
    ensure!(
        !token.contains("__"),
        "{token:?} has two underscores in a row, which are not supported in names"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_resolve_as_in_ros() {
        let root = NodeName::new("/", "encode").unwrap();
        let inside = NodeName::new("robot/left", "encode").unwrap();
        assert_eq!(root.full(), "/encode");
        assert_eq!(inside.full(), "/robot/left/encode");
        for (name, at_root, inside_of) in [
            ("events", "/events", "/robot/left/events"),
            ("a/b", "/a/b", "/robot/left/a/b"),
            ("~/events", "/encode/events", "/robot/left/encode/events"),
            ("/events", "/events", "/events"),
        ] {
            assert_eq!(root.resolve(name).unwrap(), at_root);
            assert_eq!(inside.resolve(name).unwrap(), inside_of);
        }
    }

    #[test]
    fn bad_names_are_refused() {
        let node = NodeName::new("/", "encode").unwrap();
        for bad in ["", "a//b", "/", "a b", "9a", "a/9", "~", "ä", "a/", "a__b"] {
            assert!(node.resolve(bad).is_err(), "{bad}");
        }
        let long = "a".repeat(256);
        assert!(NodeName::new("/", &long).is_err() && NodeName::new("/", &long[1..]).is_ok());
        for (namespace, base) in [("/a b", "c"), ("/a", "b/c"), ("/a", ""), ("/a//b", "c")] {
            assert!(NodeName::new(namespace, base).is_err());
        }
    }
}
