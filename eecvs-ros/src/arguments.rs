//! The ROS 2 arguments on a command line, between `--ros-args` and `--`.
//!
//! | argument | effect |
//! |---|---|
//! | `-r`, `--remap` `[NODE:]FROM:=TO` | renames a topic; `__node`, `__name`: the node; `__ns`: sets its namespace |
//! | `-p`, `--param` `[NODE:]NAME:=VALUE` | sets a parameter |
//! | `--params-file FILE` | sets parameters by node name, from YAML |
//! | `--log-level`, `--enable-rosout-logs`, ... | accepted, without effect |
//!
//! A node's parameters are its command's flags: `-p window_us:=5000` is `--window-us 5000`. Values are YAML, and have
//! the parameter's type: an integer is not a double, and `'5'` is a string. Parameters become flags in front of those
//! on the command line, which take precedence; among parameters, a later one does. A parameter given for all nodes
//! applies to the nodes that have it.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use event_types::stream::small_file::read_text;
use serde::Deserialize;

use crate::names::NodeName;
use crate::parameters::{Descriptor, USE_SIM_TIME, Value, descriptor};

/// A remapping rule.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Remap {
    /// Own name of the node that the rule is for; `None` for all nodes.
    node: Option<String>,
    from: String,
    to: String,
}

/// A parameter with its value and the nodes that it is for.
#[derive(Debug, Clone, PartialEq)]
struct Assignment {
    /// `/**`, a node's own name, or its full name with `*` and `**` for tokens.
    node: String,
    name: String,
    /// `None` for null, which leaves the parameter without a value.
    value: Option<Value>,
    /// Whether it was given on the command line and not in a file.
    on_line: bool,
}

/// The parsed ROS 2 arguments of a command line.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    assignments: Vec<Assignment>,
}

/// The arguments that apply to one node.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeArguments {
    /// The node's name after remapping.
    pub name: NodeName,
    remaps: Vec<(String, String)>,
    /// The parameters that are given, with values of their types.
    pub parameters: BTreeMap<String, Value>,
}

impl RosArguments {
    /// Separates the ROS 2 arguments from a command line; returns them, parsed, and the other arguments.
    ///
    /// # Errors
    /// An argument is not a ROS 2 argument, or a parameter file cannot be read.
    pub fn split(arguments: impl IntoIterator<Item = OsString>) -> Result<(Self, Vec<OsString>)> {
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
    fn take(&mut self, arguments: &mut impl Iterator<Item = OsString>) -> Result<()> {
        while let Some(argument) = arguments.next() {
            let argument = text(&argument)?;
            let mut value = || {
                let value = arguments.next();
                value.with_context(|| format!("--ros-args: {argument} needs a value after it"))
            };
            match argument {
                "--" => break,
                "-r" | "--remap" => self.remaps.push(remap(text(&value()?)?)?),
                "-p" | "--param" => self.assignments.push(assignment(text(&value()?)?)?),
                "--params-file" => self.assignments.extend(file(Path::new(&value()?))?),
                "--log-level" | "--log-config-file" | "--log-file-name" => {
                    value()?;
                }
                _ if is_of_logs(argument) => {}
                other => bail!(
                    "--ros-args: unknown argument {other}: use -r FROM:=TO, -p NAME:=VALUE or \
                     --params-file FILE"
                ),
            }
        }
        Ok(())
    }

    /// Returns the arguments of the node that is called `base` in `namespace` unless remapped, and has the parameters
    /// `declared`.
    ///
    /// # Errors
    /// ROS 2 does not allow a name; the node does not have a parameter that is given for it alone; a value is not of
    /// its parameter's type.
    pub fn node(
        &self,
        namespace: &str,
        base: &str,
        declared: &[Descriptor],
    ) -> Result<NodeArguments> {
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
        let mut parameters = BTreeMap::new();
        for given in self
            .assignments
            .iter()
            .filter(|given| is_for(&given.node, &name))
        {
            let Assignment {
                node,
                name: parameter,
                value,
                ..
            } = given;
            let descriptor = declared.iter().find(|known| known.name == *parameter);
            let Some(descriptor) = descriptor else {
                // What is given for many nodes is for those of them that have it.
                ensure!(
                    is_for_many(node),
                    "--ros-args: {node}: parameter '{parameter}' was not declared by {}",
                    name.full()
                );
                continue;
            };
            let refused = |why: String| anyhow!("--ros-args: {}: {why}", name.full());
            match value {
                Some(value) => {
                    descriptor.check(value).map_err(refused)?;
                    parameters.insert(parameter.clone(), value.clone());
                }
                None if descriptor.is_optional => {
                    parameters.remove(parameter);
                }
                None => return Err(refused(format!("{parameter}: null is not a value"))),
            }
        }
        Ok(NodeArguments {
            name,
            remaps,
            parameters,
        })
    }

    /// Checks that each parameter is for some of these nodes, each given with its declared parameters.
    ///
    /// # Errors
    /// A parameter from the command line is one that none of the nodes has. For parameters from files, `warn`
    /// receives the node and the name instead, since a file may serve other programs too.
    pub fn check(
        &self,
        nodes: &[(NodeName, &[Descriptor])],
        mut warn: impl FnMut(&str, &str),
    ) -> Result<()> {
        for given in &self.assignments {
            let takes = |(name, declared): &(NodeName, &[Descriptor])| {
                let has = || declared.iter().any(|known| known.name == given.name);
                is_for(&given.node, name) && has()
            };
            if nodes.iter().any(takes) {
                continue;
            }
            // No program follows another clock, whichever node it is asked of.
            ensure!(
                given.name != USE_SIM_TIME
                    || given.value != Some(Value::Bool(true))
                    || !given.on_line,
                "--ros-args: {}",
                descriptor::SIM_TIME_REFUSAL
            );
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

fn is_of_logs(argument: &str) -> bool {
    let argument = argument
        .strip_prefix("--enable-")
        .or_else(|| argument.strip_prefix("--disable-"));
    matches!(
        argument,
        Some("rosout-logs" | "stdout-logs" | "external-lib-logs")
    )
}

/// Returns an argument as text, as names and values in ROS 2 are.
fn text(argument: &OsStr) -> Result<&str> {
    let text = argument.to_str();
    text.with_context(|| {
        format!("--ros-args: {argument:?} is not UTF-8: names and values are text")
    })
}

/// Splits `[NODE:]LEFT:=RIGHT` into the node, if given, and both sides.
fn rule(text: &str) -> Result<(Option<String>, String, String)> {
    let (left, right) = text
        .split_once(":=")
        .with_context(|| format!("{text:?}: expected NAME:=VALUE"))?;
    let (node, left) = match left.split_once(':') {
        Some((node, left)) => (Some(node.to_owned()), left),
        None => (None, left),
    };
    ensure!(
        !left.is_empty() && !right.is_empty(),
        "{text:?}: expected NAME:=VALUE"
    );
    Ok((node, left.to_owned(), right.to_owned()))
}

fn remap(text: &str) -> Result<Remap> {
    let (node, from, to) = rule(text)?;
    Ok(Remap { node, from, to })
}

fn assignment(text: &str) -> Result<Assignment> {
    let (node, name, value) = rule(text)?;
    let yaml = serde_saphyr::from_str(&value)
        .map_err(|error| anyhow!("--ros-args: -p {text}: the value is not YAML: {error}"))?;
    Ok(Assignment {
        node: node.unwrap_or_else(|| "/**".to_owned()),
        value: value_of(yaml).with_context(|| format!("--ros-args: -p {text}"))?,
        name,
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
    Null(()),
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
    let text = read_text(path, FILE_BYTES_MAX).context("not a parameter file")?;
    // Some editors put a byte-order mark in front.
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let nodes: BTreeMap<String, Yaml> = serde_saphyr::from_str(text)
        .map_err(|error| anyhow::anyhow!("{name}: not a YAML file of parameters: {error}"))?;
    let mut assignments = Vec::new();
    for (node, value) in nodes {
        node_of_file(&node, value, &mut assignments).with_context(|| name.to_string())?;
    }
    Ok(assignments)
}

fn node_of_file(node: &str, value: Yaml, assignments: &mut Vec<Assignment>) -> Result<()> {
    let Yaml::Map(map) = value else {
        bail!("{node}: expected ros__parameters below it");
    };
    for (key, value) in map {
        if key == "ros__parameters" {
            let Yaml::Map(parameters) = value else {
                bail!("{node}: ros__parameters: expected NAME: VALUE below it");
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
    if let Yaml::Map(inner) = value {
        for (key, value) in inner {
            parameter_of_file(node, format!("{name}.{key}"), value, assignments)?;
        }
        return Ok(());
    }
    let value = value_of(value).with_context(|| format!("{node}: {name}"))?;
    assignments.push(Assignment {
        node: node.to_owned(),
        name,
        value,
        on_line: false,
    });
    Ok(())
}

/// Returns the value of a parameter in YAML; `None` for null.
fn value_of(yaml: Yaml) -> Result<Option<Value>> {
    Ok(Some(match yaml {
        Yaml::Null(()) => return Ok(None),
        Yaml::Bool(is) => Value::Bool(is),
        Yaml::Whole(whole) => Value::Integer(whole),
        Yaml::Float(float) => Value::Double(float),
        Yaml::Text(text) => Value::Text(text),
        Yaml::List(values) => list_of(&values)?,
        Yaml::Map(_) => bail!("a map is not a possible value of a parameter"),
    }))
}

/// Returns the value of a list, whose elements must be of one type.
fn list_of(yaml: &[Yaml]) -> Result<Value> {
    macro_rules! all {
        ($kind:ident) => {
            yaml.iter()
                .map(|each| match each {
                    Yaml::$kind(value) => Some(value.clone()),
                    _ => None,
                })
                .collect::<Option<Vec<_>>>()
        };
    }
    if let Some(texts) = all!(Text) {
        return Ok(Value::Texts(texts));
    }
    if let Some(values) = all!(Bool) {
        return Ok(Value::Bools(values));
    }
    if let Some(values) = all!(Whole) {
        return Ok(Value::Integers(values));
    }
    let values = all!(Float);
    let values = values.context(
        "a list of values of several types, or of lists, is not a possible \
                                 value of a parameter",
    )?;
    Ok(Value::Doubles(values))
}

#[cfg(test)]
mod tests {
    use clap::{Arg, ArgAction, Command};

    use super::*;

    fn split(line: &str) -> Result<(RosArguments, Vec<OsString>)> {
        RosArguments::split(line.split_whitespace().map(OsString::from))
    }

    /// The parameters of a node with flags of these names and types.
    fn declared() -> Vec<Descriptor> {
        let text = |name: &'static str| Arg::new(name).long(name);
        let command = Command::new("node")
            .arg(text("window_us").value_parser(clap::value_parser!(u32)))
            .arg(
                text("m")
                    .value_parser(clap::value_parser!(u8))
                    .default_value("16"),
            )
            .arg(text("step_log2").value_parser(clap::value_parser!(i8)))
            .arg(text("max_error").value_parser(clap::value_parser!(f64)))
            .arg(text("coder"))
            .arg(text("x").action(ArgAction::Append))
            .arg(text("keep_order").action(ArgAction::SetTrue))
            .arg(text("isolated").action(ArgAction::SetTrue));
        Descriptor::all_of(&command, &[])
    }

    /// A node's parameters as `name=value`.
    fn given(ros: &RosArguments, namespace: &str, base: &str) -> Vec<String> {
        let node = ros.node(namespace, base, &declared()).unwrap();
        let parameters = node.parameters.iter();
        parameters
            .map(|(name, value)| format!("{name}={value}"))
            .collect()
    }

    fn refused(line: &str) -> String {
        let node = split(line).and_then(|(ros, _)| ros.node("/", "encode", &declared()));
        format!("{:#}", node.unwrap_err())
    }

    #[test]
    fn what_is_for_ros_is_taken_out() {
        let (ros, rest) = split(
            "encode --ros-args -p window_us:=5000 -r events:=/dvs/events -- --coder dense \
             --ros-args --remap __ns:=/left --log-level debug",
        )
        .unwrap();
        assert_eq!(rest, ["encode", "--coder", "dense"]);
        let node = ros.node("/event_camera", "encode", &declared()).unwrap();
        assert_eq!(node.name.full(), "/left/encode");
        assert_eq!(node.topic("events").unwrap(), "/dvs/events");
        assert_eq!(node.topic("frames").unwrap(), "/left/frames");
        assert_eq!(node.topic("~/x").unwrap(), "/left/encode/x");
        assert_eq!(given(&ros, "/event_camera", "encode"), ["window_us=5000"]);
    }

    #[test]
    fn rules_may_name_their_node() {
        let (ros, _) = split(
            "--ros-args -r encode:events:=a -r decode:events:=b -r decode:__node:=viewer \
             -p encode:m:=8 -p keep_order:=true -p isolated:=false",
        )
        .unwrap();
        let encode = ros.node("/", "encode", &declared()).unwrap();
        assert_eq!(encode.topic("events").unwrap(), "/a");
        assert_eq!(
            given(&ros, "/", "encode"),
            ["isolated=false", "keep_order=true", "m=8"]
        );
        let decode = ros.node("/", "decode", &declared()).unwrap();
        assert_eq!(decode.name.full(), "/viewer");
        assert_eq!(decode.topic("events").unwrap(), "/b");
        assert_eq!(
            given(&ros, "/", "decode"),
            ["isolated=false", "keep_order=true"]
        );
        let all = declared();
        let both = [
            (encode.name.clone(), all.as_slice()),
            (decode.name, all.as_slice()),
        ];
        ros.check(&both, |_, _| panic!()).unwrap();
        // The node that `m` is for is missing.
        let error = ros.check(&both[1..], |_, _| panic!()).unwrap_err();
        assert!(error.to_string().contains(" m"), "{error}");
        let none = [Descriptor::use_sim_time()];
        let error = ros.check(&[(encode.name, none.as_slice())], |_, _| panic!());
        assert!(error.unwrap_err().to_string().contains(" m"));
        // A node that is named has to have the parameter.
        let error = ros.node("/", "encode", &none).unwrap_err().to_string();
        assert!(error.contains("'m' was not declared by /encode"), "{error}");
    }

    #[test]
    fn values_are_of_their_types() {
        let (ros, _) = split(
            "--ros-args -p max_error:=0.5 -p step_log2:=-3 -p coder:='17' -p x:=[a,'2'] -p keep_order:=on",
        )
        .unwrap();
        let want = [
            "coder=17",
            "keep_order=true",
            "max_error=0.5",
            "step_log2=-3",
            "x=a, 2",
        ];
        assert_eq!(given(&ros, "/", "encode"), want);
        for (line, why) in [
            (
                "-p window_us:='5000'",
                "{window_us} is of type {integer}, setting it to {string}",
            ),
            (
                "-p window_us:=5000.0",
                "{window_us} is of type {integer}, setting it to {double}",
            ),
            (
                "-p window_us:=99999999999999999999",
                "{window_us} is of type {integer}",
            ),
            (
                "-p max_error:=1",
                "{max_error} is of type {double}, setting it to {integer}",
            ),
            (
                "-p coder:=17",
                "{coder} is of type {string}, setting it to {integer}",
            ),
            (
                "-p coder:=true",
                "{coder} is of type {string}, setting it to {bool}",
            ),
            (
                "-p keep_order:=1",
                "{keep_order} is of type {bool}, setting it to {integer}",
            ),
            (
                "-p x:=a",
                "{x} is of type {string_array}, setting it to {string}",
            ),
            (
                "-p x:=[1]",
                "{x} is of type {string_array}, setting it to {integer_array}",
            ),
            ("-p x:=[1,a]", "several types"),
            ("-p x:={a:1}", "a map"),
            ("-p x:=[", "not YAML"),
            ("-p m:=null", "null"),
            ("-p use_sim_time:=true", "computer's clock"),
            ("-p use_sim_time:=1", "{use_sim_time} is of type {bool}"),
            ("-p encode:other:=1", "'other' was not declared"),
        ] {
            let said = refused(&format!("--ros-args {line}"));
            assert!(said.contains(why), "{line}: {said}");
        }
        // What has no default may be without a value, as `ros2 param dump` writes it.
        let (ros, _) = split("--ros-args -p window_us:=5 -p window_us:=null").unwrap();
        assert!(given(&ros, "/", "encode").is_empty());
    }

    #[test]
    fn files_name_nodes_by_patterns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        let yaml = "/**:\n  ros__parameters: {window_us: 5000, coder: dense, use_sim_time: false}\n\
                    encode:\n  ros__parameters:\n    window_us: 4000\n    step_log2: -3\n    x: [one, two]\n\
                    left:\n  decode:\n    ros__parameters: {max_error: 0.5, keep_order: true}\n\
                    /*/log:\n  ros__parameters: {m: 1}\n";
        // As editors of Windows save it.
        let yaml = yaml.replace('\n', "\r\n");
        std::fs::write(&path, format!("\u{feff}{yaml}")).unwrap();
        let line = format!("--ros-args --params-file {} -p coder:=fast", path.display());
        let (ros, _) = split(&line).unwrap();
        assert_eq!(
            given(&ros, "/left", "decode"),
            [
                "coder=fast",
                "keep_order=true",
                "max_error=0.5",
                "use_sim_time=false",
                "window_us=5000"
            ]
        );
        assert_eq!(
            given(&ros, "/right", "decode"),
            ["coder=fast", "use_sim_time=false", "window_us=5000"]
        );
        assert!(given(&ros, "/left", "log").contains(&"m=1".to_owned()));
        assert!(!given(&ros, "/", "log").contains(&"m=1".to_owned()));
        // A file's patterns are sorted by name, so the one for all nodes comes first.
        let encode = given(&ros, "/", "encode");
        for parameter in ["window_us=4000", "step_log2=-3", "x=one, two"] {
            assert!(encode.contains(&parameter.to_owned()), "{encode:?}");
        }
        for (yaml, why) in [
            (
                "/**: {ros__parameters: {use_sim_time: true}}",
                "computer's clock",
            ),
            (
                "encode: {ros__parameters: {window_us: '5'}}",
                "of type {integer}",
            ),
            ("/**: {ros__parameters: {max_error: 1}}", "of type {double}"),
            (
                "/encode: {ros__parameters: {other: 1}}",
                "'other' was not declared",
            ),
        ] {
            std::fs::write(&path, yaml).unwrap();
            let said = refused(&line);
            assert!(said.contains(why), "{yaml}: {said}");
        }
        // A file may serve several programs: parameters of others cause a warning.
        std::fs::write(&path, "/**: {ros__parameters: {other: 1}}").unwrap();
        let (ros, _) = split(&line).unwrap();
        let (all, mut warned) = (declared(), Vec::new());
        let node = ros.node("/", "encode", &all).unwrap();
        let nodes = [(node.name, all.as_slice())];
        ros.check(&nodes, |_, name| warned.push(name.to_owned()))
            .unwrap();
        assert_eq!(warned, ["other"]);
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
        let (ros, _) = split("--ros-args -r __node:=9").unwrap();
        assert!(ros.node("/", "encode", &declared()).is_err());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.yaml");
        for bad in [
            "[1, 2]",
            "encode: 5",
            "encode: {ros__parameters: 5}",
            "a: {b: [",
            "a:\n - [[1]]",
            "a: {ros__parameters: {x: [[1]]}}",
        ] {
            std::fs::write(&path, bad).unwrap();
            assert!(file(&path).is_err(), "{bad}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn arguments_of_ros_are_text() {
        use std::os::unix::ffi::OsStringExt as _;
        let bad = OsString::from_vec(vec![b'a', 0xff]);
        let (_, rest) = RosArguments::split([bad.clone()]).unwrap();
        assert_eq!(rest, std::slice::from_ref(&bad));
        for option in ["-p", "-r"] {
            let line = ["--ros-args".into(), option.into(), bad.clone()];
            let error = RosArguments::split(line).unwrap_err().to_string();
            assert!(error.contains("not UTF-8"), "{error}");
        }
    }
}
