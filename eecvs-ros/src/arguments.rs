//! The ROS 2 arguments on a command line, between `--ros-args` and `--`.
//!
//! | argument | effect |
//! |---|---|
//! | `-r`, `--remap` `[NODE:]FROM:=TO` | renames a topic; `__node`, `__name`: the node; `__ns`: sets its namespace |
//! | `-p`, `--param` `[NODE:]NAME:=VALUE` | sets a parameter |
//! | `--params-file FILE` | sets parameters by node name, from YAML |
//! | `--log-level`, `--enable-rosout-logs`, ... | accepted, without effect |
//!
//! A node's parameters are its command's flags: `-p window_us:=5000` is `--window-us 5000`. Parameters become flags
//! in front of those on the command line, which take precedence; among parameters, a later one does. A parameter
//! given for all nodes applies to the nodes that have it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

use crate::names::NodeName;

/// A remapping rule.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Remap {
    /// Own name of the node that the rule is for; `None` for all nodes.
    node: Option<String>,
    from: String,
    to: String,
}

/// Value of a parameter.
#[derive(Debug, Clone, PartialEq)]
enum Given {
    Bool(bool),
    /// Any other single value, as written.
    Text(String),
    List(Vec<String>),
}

/// A parameter with its value and the nodes that it is for.
#[derive(Debug, Clone, PartialEq)]
struct Assignment {
    /// `/**`, a node's own name, or its full name with `*` and `**` for tokens.
    node: String,
    name: String,
    value: Given,
    /// Whether it was given on the command line and not in a file.
    on_line: bool,
}

/// The parsed ROS 2 arguments of a command line.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    assignments: Vec<Assignment>,
}

/// Predicate: whether a node has the parameter of this name.
pub type Has<'a> = &'a dyn Fn(&str) -> bool;

/// The arguments that apply to one node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeArguments {
    /// The node's name after remapping.
    pub name: NodeName,
    remaps: Vec<(String, String)>,
    /// The node's parameters as flags.
    pub flags: Vec<String>,
}

impl RosArguments {
    /// Separates the ROS 2 arguments from a command line; returns them, parsed, and the other arguments.
    ///
    /// # Errors
    /// An argument is not a ROS 2 argument, or a parameter file cannot be read.
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

    /// Parses arguments up to `--`.
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

    /// Returns the arguments of the node that is called `base` in `namespace` unless remapped, and whose parameters
    /// `has` knows.
    ///
    /// # Errors
    /// ROS 2 does not allow a name.
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

    /// Checks that each parameter is for some of these nodes, each given with a test for its parameters.
    ///
    /// # Errors
    /// A parameter from the command line is one that none of the nodes has. For parameters from files, `warn`
    /// receives the node and the name instead, since a file may serve other programs too.
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
    /// Returns the absolute name of a topic, remapped if a rule applies.
    ///
    /// # Errors
    /// ROS 2 does not allow the name.
    pub fn topic(&self, topic: &str) -> Result<String> {
        let resolved = self.name.resolve(topic)?;
        let rule = self.remaps.iter().find(|(from, _)| *from == resolved);
        Ok(rule.map_or(resolved, |(_, to)| to.clone()))
    }
}

impl Given {
    /// Appends the flag for this parameter value.
    fn put(&self, name: &str, flags: &mut Vec<String>) -> Result<()> {
        if name == "use_sim_time" {
            ensure!(
                *self == Self::Bool(false),
                "use_sim_time: stamps are the computer's time; leave it out"
            );
            return Ok(());
        }
        // A parameter with a one-letter name is a short flag.
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

/// Splits `[NODE:]LEFT:=RIGHT` into the node, if given, and both sides.
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

/// Returns whether a node's name in a parameter file matches a node: by its own name, or by its full name, in which
/// `*` stands for any token and `**` for any number of tokens.
fn is_for(pattern: &str, name: &NodeName) -> bool {
    if pattern == name.base {
        return true;
    }
    let full = name.full();
    let tokens: Vec<&str> = full.split('/').skip(1).collect();
    let pattern: Vec<&str> = pattern.trim_start_matches('/').split('/').collect();
    matches(&pattern, &tokens)
}

/// Returns whether a pattern may match nodes that its author did not have in mind.
fn is_for_many(pattern: &str) -> bool {
    pattern.contains('*')
}

fn matches(pattern: &[&str], tokens: &[&str]) -> bool {
    match (pattern.split_first(), tokens.split_first()) {
        (None, None) => true,
        (Some((&"**", rest)), _) => {
            // The recursion is bounded: the longest names have about a dozen tokens.
            (0..=tokens.len()).any(|n| matches(rest, tokens.get(n..).unwrap_or_default()))
        }
        (Some((first, pattern)), Some((token, tokens))) => {
            (*first == "*" || first == token) && matches(pattern, tokens)
        }
        _ => false,
    }
}

/// A YAML value.
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

/// Largest parameter file, in bytes.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Reads the parameters of a file: `NODE: { ros__parameters: { NAME: VALUE } }`; namespaces may be nested or part
/// of the node's name.
fn file(path: &Path) -> Result<Vec<Assignment>> {
    let name = path.display();
    let length = std::fs::metadata(path).map(|data| data.len());
    let length = length.with_context(|| format!("{name}: cannot be read"))?;
    ensure!(
        length <= FILE_BYTES_MAX,
        "{name}: {length} bytes are no file of parameters"
    );
    let text = std::fs::read_to_string(path).with_context(|| format!("{name}: cannot be read"))?;
    // Some editors put a byte-order mark in front.
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let nodes: BTreeMap<String, Yaml> = serde_saphyr::from_str(text)
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
        // `encode:m:=8` passes the check above although `has` does not know `m`: a node addressed by name reports
        // unknown parameters itself. Here that node is missing.
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
        // As editors of Windows save it.
        let yaml = yaml.replace('\n', "\r\n");
        std::fs::write(&path, format!("\u{feff}{yaml}")).unwrap();
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
        // A file's patterns are sorted by name, so the one for all nodes comes first.
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
