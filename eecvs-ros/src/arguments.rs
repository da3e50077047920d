//! What a command line says in the language of ROS 2, between `--ros-args` and `--`.
//!
//! | argument | what it does |
//! |---|---|
//! | `-r`, `--remap` `[NODE:]FROM:=TO` | another name of a topic; `__node`, `__name`, `__ns` of the node |
//! | `-p`, `--param` `[NODE:]NAME:=VALUE` | a parameter |
//! | `--params-file FILE` | parameters by nodes' names, in YAML |
//! | `--log-level`, `--enable-rosout-logs`, ... | taken, without effect |
//!
//! A node's parameters are its command's flags: `-p window_us:=5000` is `--window-us 5000`. Parameters become
//! flags in front of those that are given, which count for more; of parameters the later ones do. One that is given
//! for all nodes is for those that have it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

use crate::names::NodeName;

/// A rule for a node's name.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Remap {
    /// The node that it is for, by its own name; all without it.
    node: Option<String>,
    from: String,
    to: String,
}

/// A value of a parameter.
#[derive(Debug, Clone, PartialEq)]
enum Given {
    Bool(bool),
    /// As it is written.
    Text(String),
    List(Vec<String>),
}

/// A parameter and whom it is for.
#[derive(Debug, Clone, PartialEq)]
struct Assignment {
    /// `/**`, a node's own name, or its full one with `*` and `**` for tokens.
    node: String,
    name: String,
    value: Given,
    /// It stands on the command line, not in a file.
    on_line: bool,
}

/// What ROS 2's part of a command line says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    assignments: Vec<Assignment>,
}

/// Tells whether a node has a parameter.
pub type Has<'a> = &'a dyn Fn(&str) -> bool;

/// What it says of one node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeArguments {
    /// Its name.
    pub name: NodeName,
    remaps: Vec<(String, String)>,
    /// Its parameters as flags.
    pub flags: Vec<String>,
}

impl RosArguments {
    /// Takes ROS 2's part out of a command line, and returns it and the rest.
    ///
    /// # Errors
    /// An argument that is none, or a file of parameters that cannot be read.
    pub fn split(arguments: impl IntoIterator<Item = String>) -> Result<(Self, Vec<String>)> {
        let mut ros = Self::default();
        let mut rest = Vec::new();
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            if argument == "--ros-args" {
                ros.take(&mut arguments)?;
            } else {
                rest.push(argument);
            }
        }
        Ok((ros, rest))
    }

    /// Takes arguments up to `--`.
    fn take(&mut self, arguments: &mut impl Iterator<Item = String>) -> Result<()> {
        while let Some(argument) = arguments.next() {
            let mut value = || {
                let value = arguments.next();
                value.with_context(|| format!("--ros-args: {argument} wants something behind it"))
            };
            match argument.as_str() {
                "--" => break,
                "-r" | "--remap" => self.remaps.push(remap(&value()?)?),
                "-p" | "--param" => self.assignments.push(assignment(&value()?)?),
                "--params-file" => self.assignments.extend(file(Path::new(&value()?))?),
                "--log-level" | "--log-config-file" | "--log-file-name" => {
                    value()?;
                }
                _ if is_of_logs(&argument) => {}
                other => bail!(
                    "--ros-args: {other} is not known: -r FROM:=TO, -p NAME:=VALUE, --params-file FILE"
                ),
            }
        }
        Ok(())
    }

    /// What it says of the node that is called `base` in `namespace` unless it says something else, and `has` some
    /// parameters.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow.
    pub fn node(&self, namespace: &str, base: &str, has: Has<'_>) -> Result<NodeArguments> {
        let rules = || {
            let of_node = |rule: &&Remap| rule.node.as_deref().is_none_or(|node| node == base);
            self.remaps.iter().filter(of_node)
        };
        let rule = |names: &[&str], otherwise: &str| {
            let found = rules().find(|rule| names.contains(&rule.from.as_str()));
            found.map_or(otherwise.to_owned(), |rule| rule.to.clone())
        };
        let name = NodeName::new(
            &rule(&["__ns"], namespace),
            &rule(&["__node", "__name"], base),
        )?;
        let mut remaps = Vec::new();
        for Remap { from, to, .. } in rules().filter(|rule| !rule.from.starts_with("__")) {
            remaps.push((name.resolve(from)?, name.resolve(to)?));
        }
        let mut values = BTreeMap::new();
        for Assignment {
            node,
            name: parameter,
            value,
            ..
        } in &self.assignments
        {
            if is_for(node, &name) && (has(parameter) || !is_for_many(node)) {
                values.insert(parameter, value);
            }
        }
        let mut flags = Vec::new();
        for (parameter, value) in values {
            value.put(parameter, &mut flags)?;
        }
        Ok(NodeArguments {
            name,
            remaps,
            flags,
        })
    }

    /// Whether parameters are for some of these nodes, each with what tells its parameters.
    ///
    /// # Errors
    /// One of the command line that none of them has. Of those in files, `warn` gets the nodes and the names: the
    /// file may be one for other programs too.
    pub fn check(
        &self,
        nodes: &[(NodeName, Has<'_>)],
        mut warn: impl FnMut(&str, &str),
    ) -> Result<()> {
        for given in &self.assignments {
            let takes = |(name, has): &(NodeName, Has<'_>)| {
                is_for(&given.node, name) && (has(&given.name) || !is_for_many(&given.node))
            };
            if nodes.iter().any(takes) || given.name == "use_sim_time" {
                continue;
            }
            ensure!(
                !given.on_line,
                "--ros-args: no node here has the parameter {}",
                given.name
            );
            warn(&given.node, &given.name);
        }
        Ok(())
    }
}

impl NodeArguments {
    /// The absolute name of a topic, remapped where a rule says so.
    ///
    /// # Errors
    /// A name that ROS 2 does not allow.
    pub fn topic(&self, topic: &str) -> Result<String> {
        let resolved = self.name.resolve(topic)?;
        let rule = self.remaps.iter().find(|(from, _)| *from == resolved);
        Ok(rule.map_or(resolved, |(_, to)| to.clone()))
    }
}

impl Given {
    /// Appends the flag of a parameter.
    fn put(&self, name: &str, flags: &mut Vec<String>) -> Result<()> {
        if name == "use_sim_time" {
            ensure!(
                *self == Self::Bool(false),
                "use_sim_time: stamps are the computer's time; leave it out"
            );
            return Ok(());
        }
        // A parameter of one letter is a short flag.
        let dashes = if name.len() == 1 { "-" } else { "--" };
        let flag = format!("{dashes}{}", name.replace('_', "-"));
        match self {
            Self::Bool(true) => flags.push(flag),
            Self::Bool(false) => {}
            Self::Text(text) => flags.push(format!("{flag}={text}")),
            Self::List(texts) => flags.extend(texts.iter().map(|text| format!("{flag}={text}"))),
        }
        Ok(())
    }

    fn parse(text: &str) -> Self {
        match text {
            "true" | "True" => Self::Bool(true),
            "false" | "False" => Self::Bool(false),
            other => Self::Text(other.trim_matches(['"', '\'']).to_owned()),
        }
    }
}

fn is_of_logs(argument: &str) -> bool {
    let argument = argument
        .strip_prefix("--enable-")
        .or_else(|| argument.strip_prefix("--disable-"));
    matches!(
        argument,
        Some("rosout-logs" | "stdout-logs" | "external-lib-logs")
    )
}

/// Both sides of `:=`, and the node in front of it.
fn rule(text: &str) -> Result<(Option<String>, String, String)> {
    let (left, right) = text
        .split_once(":=")
        .with_context(|| format!("{text:?} is no rule: NAME:=VALUE"))?;
    let (node, left) = match left.split_once(':') {
        Some((node, left)) => (Some(node.to_owned()), left),
        None => (None, left),
    };
    ensure!(
        !left.is_empty() && !right.is_empty(),
        "{text:?} is no rule: NAME:=VALUE"
    );
    Ok((node, left.to_owned(), right.to_owned()))
}

fn remap(text: &str) -> Result<Remap> {
    let (node, from, to) = rule(text)?;
    Ok(Remap { node, from, to })
}

fn assignment(text: &str) -> Result<Assignment> {
    let (node, name, value) = rule(text)?;
    Ok(Assignment {
        node: node.unwrap_or_else(|| "/**".to_owned()),
        name,
        value: Given::parse(&value),
        on_line: true,
    })
}

/// Whether a node's name in a file of parameters is that of a node: its own, or its full one, in which `*` is any
/// token and `**` any number of them.
fn is_for(pattern: &str, name: &NodeName) -> bool {
    if pattern == name.base {
        return true;
    }
    let full = name.full();
    let tokens: Vec<&str> = full.split('/').skip(1).collect();
    let pattern: Vec<&str> = pattern.trim_start_matches('/').split('/').collect();
    matches(&pattern, &tokens)
}

/// Whether a pattern may be for nodes that whoever wrote it did not think of.
fn is_for_many(pattern: &str) -> bool {
    pattern.contains('*')
}

fn matches(pattern: &[&str], tokens: &[&str]) -> bool {
    match (pattern.split_first(), tokens.split_first()) {
        (None, None) => true,
        (Some((&"**", rest)), _) => {
            // The longest of names has some dozen tokens.
            (0..=tokens.len()).any(|n| matches(rest, tokens.get(n..).unwrap_or_default()))
        }
        (Some((first, pattern)), Some((token, tokens))) => {
            (*first == "*" || first == token) && matches(pattern, tokens)
        }
        _ => false,
    }
}

/// A value in YAML.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Yaml {
    Bool(bool),
    Whole(i64),
    Float(f64),
    Text(String),
    List(Vec<Yaml>),
    Map(BTreeMap<String, Yaml>),
}

/// Largest file of parameters.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// The parameters of a file: `NODE: { ros__parameters: { NAME: VALUE } }`, nodes in namespaces nested or named.
fn file(path: &Path) -> Result<Vec<Assignment>> {
    let name = path.display();
    let length = std::fs::metadata(path).map(|data| data.len());
    let length = length.with_context(|| format!("{name}: cannot be read"))?;
    ensure!(
        length <= FILE_BYTES_MAX,
        "{name}: {length} bytes are no file of parameters"
    );
    let text = std::fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
    let nodes: BTreeMap<String, Yaml> = serde_saphyr::from_str(&text)
        .map_err(|error| anyhow::anyhow!("{name}: not YAML of parameters: {error}"))?;
    let mut assignments = Vec::new();
    for (node, value) in nodes {
        node_of_file(&node, value, &mut assignments).with_context(|| name.to_string())?;
    }
    Ok(assignments)
}

fn node_of_file(node: &str, value: Yaml, assignments: &mut Vec<Assignment>) -> Result<()> {
    let Yaml::Map(map) = value else {
        bail!("{node}: wants ros__parameters below it");
    };
    for (key, value) in map {
        if key == "ros__parameters" {
            let Yaml::Map(parameters) = value else {
                bail!("{node}: ros__parameters: wants NAME: VALUE below it");
            };
            for (name, value) in parameters {
                parameter_of_file(node, name, value, assignments)?;
            }
        } else {
            let inner = format!("{}/{key}", node.trim_end_matches('/'));
            node_of_file(&inner, value, assignments)?;
        }
    }
    Ok(())
}

fn parameter_of_file(
    node: &str,
    name: String,
    value: Yaml,
    assignments: &mut Vec<Assignment>,
) -> Result<()> {
    let value = match value {
        Yaml::Map(inner) => {
            for (key, value) in inner {
                parameter_of_file(node, format!("{name}.{key}"), value, assignments)?;
            }
            return Ok(());
        }
        Yaml::Bool(is) => Given::Bool(is),
        Yaml::List(values) => {
            let texts = values.into_iter().map(|value| match text(value) {
                Some(text) => Ok(text),
                None => bail!("{node}: {name}: a list of lists is no parameter"),
            });
            Given::List(texts.collect::<Result<_>>()?)
        }
        other => Given::Text(text(other).unwrap_or_default()),
    };
    assignments.push(Assignment {
        node: node.to_owned(),
        name,
        value,
        on_line: false,
    });
    Ok(())
}

fn text(value: Yaml) -> Option<String> {
    match value {
        Yaml::Bool(is) => Some(is.to_string()),
        Yaml::Whole(whole) => Some(whole.to_string()),
        Yaml::Float(float) => Some(float.to_string()),
        Yaml::Text(text) => Some(text),
        Yaml::List(_) | Yaml::Map(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(line: &str) -> Result<(RosArguments, Vec<String>)> {
        RosArguments::split(line.split_whitespace().map(str::to_owned))
    }

    #[test]
    fn what_is_for_ros_is_taken_out() {
        let (ros, rest) = split(
            "encode --ros-args -p window_us:=5000 -r events:=/dvs/events -- --coder dense \
             --ros-args --remap __ns:=/left --log-level debug",
        )
        .unwrap();
        assert_eq!(rest, ["encode", "--coder", "dense"]);
        let node = ros.node("/event_camera", "encode", &|_| true).unwrap();
        assert_eq!(node.name.full(), "/left/encode");
        assert_eq!(node.flags, ["--window-us=5000"]);
        assert_eq!(node.topic("events").unwrap(), "/dvs/events");
        assert_eq!(node.topic("frames").unwrap(), "/left/frames");
        assert_eq!(node.topic("~/x").unwrap(), "/left/encode/x");
    }

    #[test]
    fn rules_may_name_their_node() {
        let (ros, _) = split(
            "--ros-args -r encode:events:=a -r decode:events:=b -r decode:__node:=viewer \
             -p encode:m:=8 -p keep_order:=true -p isolated:=false",
        )
        .unwrap();
        let encode = ros.node("/", "encode", &|_| true).unwrap();
        assert_eq!(encode.topic("events").unwrap(), "/a");
        assert_eq!(encode.flags, ["--keep-order", "-m=8"]);
        let decode = ros.node("/", "decode", &|_| true).unwrap();
        assert_eq!(decode.name.full(), "/viewer");
        assert_eq!(decode.topic("events").unwrap(), "/b");
        assert_eq!(decode.flags, ["--keep-order"]);
        let has = |name: &str| ["keep_order", "isolated"].contains(&name);
        let both = [(encode.name, &has as Has<'_>), (decode.name, &has)];
        ros.check(&both, |_, _| panic!()).unwrap();
        // What is for a node by its name it has to know, or says so itself.
        assert!(ros.check(&both[1..], |_, _| panic!()).is_err());
        let none = |_: &str| false;
        let error = ros.check(&[(both[0].0.clone(), &none)], |_, _| panic!());
        assert!(error.unwrap_err().to_string().contains("keep_order"));
        let flags = ros.node("/", "encode", &none).unwrap().flags;
        assert_eq!(flags, ["-m=8"]);
    }

    #[test]
    fn files_name_nodes_by_patterns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        let yaml = "/**:\n  ros__parameters: {window_us: 5000, coder: dense}\n\
                    encode:\n  ros__parameters:\n    window_us: 4000\n    step_log2: -3\n    x: [1, two]\n\
                    left:\n  decode:\n    ros__parameters: {max_error: 0.5, keep_order: true}\n\
                    /*/log:\n  ros__parameters: {a: {b: 1}}\n";
        std::fs::write(&path, yaml).unwrap();
        let line = format!("--ros-args --params-file {} -p coder:=fast", path.display());
        let (ros, _) = split(&line).unwrap();
        let flags =
            |namespace: &str, base: &str| ros.node(namespace, base, &|_| true).unwrap().flags;
        assert_eq!(
            flags("/left", "decode"),
            [
                "--coder=fast",
                "--keep-order",
                "--max-error=0.5",
                "--window-us=5000"
            ]
        );
        assert_eq!(
            flags("/right", "decode"),
            ["--coder=fast", "--window-us=5000"]
        );
        assert!(flags("/left", "log").contains(&"--a.b=1".to_owned()));
        assert!(!flags("/", "log").contains(&"--a.b=1".to_owned()));
        // Patterns of a file stand in the order of their names: the one for all comes first.
        let encode = flags("/", "encode");
        for flag in ["--window-us=4000", "--step-log2=-3", "-x=1", "-x=two"] {
            assert!(encode.contains(&flag.to_owned()), "{encode:?}");
        }
    }

    #[test]
    fn what_is_no_argument_is_refused() {
        for bad in [
            "--ros-args -p",
            "--ros-args -p window_us=5",
            "--ros-args -r :=x",
            "--ros-args --enclave /x",
            "--ros-args --params-file /nowhere.yaml",
            "--ros-args events",
        ] {
            assert!(split(bad).is_err(), "{bad}");
        }
        let (ros, _) = split("--ros-args -p use_sim_time:=true").unwrap();
        assert!(ros.node("/", "encode", &|_| true).is_err());
        let (ros, _) = split("--ros-args -r __node:=9").unwrap();
        assert!(ros.node("/", "encode", &|_| true).is_err());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        for bad in [
            "[1, 2]",
            "encode: 5",
            "encode: {ros__parameters: 5}",
            "a: {b: [",
            "a:\n - [[1]]",
        ] {
            std::fs::write(&path, bad).unwrap();
            assert!(file(&path).is_err(), "{bad}");
        }
    }
}
