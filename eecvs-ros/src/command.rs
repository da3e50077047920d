//! The `eecvs-ros` command: runs one node in a process, or several.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail};
use clap::builder::ValueParser;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};
use eecvs_cli::output::end;
use eecvs_cli::variable::have_zenoh_threads;
use usb_bridge::stop::Stop;

use crate::arguments::{Has, NodeArguments, RosArguments};
use crate::node::{
    Context, NAMESPACE, bridge, decode, delay, density, emulate, encode, log, play, record,
};
use crate::operator::{Operator, Operators};
use crate::transport::Transport;
use crate::transport::dds::Dds;
use crate::transport::local::Local;
use crate::transport::zenoh::{Links, ROUTER, Router, Zenoh};

/// ROS 2 nodes around the encoder; flags may also be given as parameters, after --ros-args: -p NAME:=VALUE, -r
/// FROM:=TO, --params-file FILE
#[derive(Debug, Parser)]
#[command(
    name = "eecvs-ros",
    version,
    arg_required_else_help = true,
    args_override_self = true
)]
struct EecvsRos {
    #[command(flatten)]
    network: NetworkOptions,

    #[command(subcommand)]
    command: Command,
}

/// The transport and its settings.
#[derive(Debug, Clone, Args)]
struct NetworkOptions {
    /// Transport that carries the messages
    #[arg(long, value_enum, default_value = "dds", global = true)]
    transport: Name,

    /// Domain; nodes of different domains do not see each other [default: the variable ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", global = true, value_parser = clap::value_parser!(u16).range(0..=232))]
    domain_id: Option<u16>,

    /// Stay on this computer [default: if ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST, or ROS_LOCALHOST_ONLY is 1]
    #[arg(long, global = true)]
    loopback: bool,

    #[command(flatten)]
    links: LinkOptions,
}

/// Zenoh's endpoints and settings.
#[derive(Debug, Clone, Args)]
struct LinkOptions {
    /// With Zenoh: an endpoint to connect to, such as tcp/HOST:7447 or tls/HOST:7447 [default: a router on this
    /// computer]
    #[arg(long, value_name = "ENDPOINT", global = true)]
    connect: Vec<String>,

    /// With Zenoh: an endpoint to listen on
    #[arg(long, value_name = "ENDPOINT", global = true)]
    listen: Vec<String>,

    /// With Zenoh: its settings, in JSON5 [default: the variable ZENOH_SESSION_CONFIG_URI, for a router
    /// ZENOH_ROUTER_CONFIG_URI]
    #[arg(long, value_name = "FILE", global = true)]
    zenoh_config: Option<PathBuf>,
}

impl LinkOptions {
    fn links(&self, variable: &str) -> Links {
        let config = self.zenoh_config.clone();
        Links {
            connect: self.connect.clone(),
            listen: self.listen.clone(),
            config: config.or_else(|| std::env::var_os(variable).map(PathBuf::from)),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Name {
    /// DDS, which ROS 2 uses by default
    Dds,
    /// Zenoh, which ROS 2 uses with RMW_IMPLEMENTATION=rmw_zenoh_cpp; needs a router: eecvs-ros router, or another
    Zenoh,
}

#[derive(Debug, Clone, Subcommand)]
#[command(args_override_self = true)]
enum Command {
    Emulate(emulate::Emulate),
    Bridge(bridge::Bridge),
    Encode(encode::Encode),
    Decode(decode::Decode),
    Density(density::Monitor),
    Delay(delay::Delay),
    Log(log::Log),
    Record(record::Record),
    Play(play::Play),
    Compose(Compose),
    Router(Route),
}

/// Route the messages of Zenoh nodes until stopped; routers can connect to other routers
#[derive(Debug, Clone, Args)]
struct Route {}

/// Run several nodes in one process, where messages between them pass through memory
#[derive(Debug, Clone, Args)]
struct Compose {
    /// Nodes, by their commands; give their flags as parameters: --ros-args -p encode:window_us:=5000
    #[arg(value_name = "NODE", required = true, value_parser = ValueParser::string())]
    nodes: Vec<String>,
}

/// Returns the command line. A node's default window is shorter than that of files, so that frames are not delayed.
fn command_line() -> clap::Command {
    EecvsRos::command().mut_subcommand("encode", |encode| {
        encode.mut_arg("window_us", |window| {
            window.default_value(encode::WINDOW_US)
        })
    })
}

/// Runs the command, with operators beside the project's own. A program must call this before it does anything
/// else, since the process may replace itself in order to set an environment variable.
pub fn run(operators: Vec<Box<dyn Operator>>) -> ExitCode {
    have_zenoh_threads();
    let operators = Arc::new(Operators::new(operators));
    end("eecvs-ros", start(&operators))
}

fn start(operators: &Arc<Operators>) -> Result<()> {
    let arguments: Result<Vec<String>> = std::env::args_os().map(text).collect();
    let (ros, rest) = RosArguments::split(arguments?)?;
    let matches = command_line().try_get_matches_from(&rest);
    // A first pass, to find the node: only then are its parameters known, which become flags too.
    let line = match matches.and_then(|matches| EecvsRos::from_arg_matches(&matches)) {
        Ok(line) => line,
        Err(error) => error.exit(),
    };
    let stop = Stop::on_signals()?;
    if let Command::Compose(compose) = line.command {
        return composed(&compose, &line.network, &ros, operators, &stop);
    }
    if let Command::Router(_) = line.command {
        return route(&line.network.links, &stop);
    }
    let name = line.command.name();
    let arguments = named(&ros, &[name.to_owned()])?.remove(0);
    let (line, parameters) = parse(rest, &arguments)?;
    let transport = line.network.open()?;
    let context = Context::new(transport.as_ref(), arguments, &parameters, stop)?;
    line.command.run(context, operators)
}

/// Converts an argument to text, since names and values in ROS 2 are text.
fn text(argument: OsString) -> Result<String> {
    argument.into_string().map_err(|other| {
        anyhow!("the argument {other:?} is not UTF-8: rename the file, or give a link to it")
    })
}

/// Parses the command line with a node's parameters inserted as flags in front of its own; also returns all of its
/// flags as parameters.
fn parse(mut line: Vec<String>, node: &NodeArguments) -> Result<(EecvsRos, Vec<(String, String)>)> {
    let names: Vec<String> = command_line()
        .get_subcommands()
        .map(|command| command.get_name().to_owned())
        .collect();
    let at = line.iter().position(|word| names.contains(word));
    let at = at.map_or(line.len(), |at| at + 1);
    line.splice(at..at, node.flags.iter().cloned());
    let mut matches = match command_line().try_get_matches_from(&line) {
        Ok(matches) => matches,
        Err(error) => error.exit(),
    };
    let parameters = match matches.subcommand() {
        Some((_, matches)) => matches
            .ids()
            .filter_map(|id| {
                let values = matches.get_raw(id.as_str())?;
                let values: Vec<_> = values.map(std::ffi::OsStr::to_string_lossy).collect();
                Some((id.to_string(), values.join(" ")))
            })
            .collect(),
        None => Vec::new(),
    };
    Ok((EecvsRos::from_arg_matches_mut(&mut matches)?, parameters))
}

/// Returns the arguments of the nodes of these commands, all of which run in this process.
fn named(ros: &RosArguments, commands: &[String]) -> Result<Vec<NodeArguments>> {
    let mut line = command_line();
    // Gives each command the global flags.
    line.build();
    let parameters: Vec<Vec<String>> = commands
        .iter()
        .map(|name| match line.find_subcommand(name) {
            Some(command) => command
                .get_arguments()
                .map(|argument| argument.get_id().to_string())
                .collect(),
            None => Vec::new(),
        })
        .collect();
    let has: Vec<_> = parameters
        .iter()
        .map(|parameters| move |name: &str| parameters.iter().any(|known| known == name))
        .collect();
    let mut nodes = Vec::new();
    for (name, has) in commands.iter().zip(&has) {
        nodes.push(ros.node(NAMESPACE, name, has)?);
    }
    let all: Vec<(_, Has<'_>)> = nodes
        .iter()
        .zip(&has)
        .map(|(node, has)| (node.name.clone(), has as Has<'_>))
        .collect();
    ros.check(&all, |node, name| {
        eprintln!("eecvs-ros: --ros-args: {node}: {name} is no parameter of a node here");
    })?;
    Ok(nodes)
}

fn composed(
    compose: &Compose,
    network: &NetworkOptions,
    ros: &RosArguments,
    operators: &Arc<Operators>,
    stop: &Stop,
) -> Result<()> {
    let transport = Local::before(network.open()?);
    let arguments = named(ros, &compose.nodes)?;
    let mut nodes = Vec::new();
    for (name, arguments) in compose.nodes.iter().zip(arguments) {
        let line = vec!["eecvs-ros".to_owned(), name.clone()];
        let (line, parameters) = parse(line, &arguments)?;
        if matches!(line.command, Command::Compose(_) | Command::Router(_)) {
            bail!("compose: {name} is no node");
        }
        for topic in line.command.publishes() {
            transport.expect(arguments.topic(topic)?);
        }
        let context = Context::new(&transport, arguments, &parameters, stop.clone())?;
        nodes.push((name.clone(), line.command, context));
    }
    let mut threads = Vec::new();
    for (name, command, context) in nodes {
        let operators = Arc::clone(operators);
        let thread = thread::Builder::new()
            .name(name.clone())
            .spawn(move || command.run(context, &operators))
            .context("a thread of a node")?;
        threads.push((name, thread));
    }
    let mut result = Ok(());
    for (name, thread) in threads {
        let ended = match thread.join() {
            Ok(ended) => ended.context(name),
            Err(_) => bail!("{name}: panicked: please report this"),
        };
        if ended.is_err() {
            // The other nodes do not go on without it.
            stop.ask();
        }
        result = result.and(ended);
    }
    result
}

fn route(options: &LinkOptions, stop: &Stop) -> Result<()> {
    let links = options.links("ZENOH_ROUTER_CONFIG_URI");
    let router = Router::start(&links)?;
    let listens = if links.listen.is_empty() && links.config.is_none() {
        ROUTER.to_owned()
    } else {
        links.listen.join(", ")
    };
    eprintln!("eecvs-ros: a router listens at {listens}");
    let mut told = (0, 0);
    while !stop.is_asked() {
        let (routers, others) = router.connected();
        if (routers, others) != told {
            eprintln!("eecvs-ros: connected: {routers} routers, {others} others");
            told = (routers, others);
        }
        thread::sleep(LOOK);
    }
    Ok(())
}

/// Interval at which a router checks its connections.
const LOOK: Duration = Duration::from_millis(200);

impl NetworkOptions {
    fn open(&self) -> Result<Arc<dyn Transport>> {
        let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let domain_id = match (self.domain_id, variable("ROS_DOMAIN_ID")) {
            (Some(domain_id), _) => domain_id,
            (None, None) => 0,
            (None, Some(text)) => {
                let domain_id = text.parse().ok().filter(|id| (0..=232).contains(id));
                domain_id.with_context(|| format!("ROS_DOMAIN_ID is {text:?}: give 0 to 232"))?
            }
        };
        let loopback = self.loopback
            || variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() == Some("LOCALHOST")
            || variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1");
        match self.transport {
            Name::Dds => Ok(Arc::new(Dds::join(domain_id, loopback)?)),
            Name::Zenoh => {
                let links = self.links.links("ZENOH_SESSION_CONFIG_URI");
                Ok(Arc::new(Zenoh::join(domain_id, &links)?))
            }
        }
    }
}

impl Command {
    const fn name(&self) -> &'static str {
        match self {
            Self::Emulate(_) => "emulate",
            Self::Bridge(_) => "bridge",
            Self::Encode(_) => "encode",
            Self::Decode(_) => "decode",
            Self::Density(_) => "density",
            Self::Delay(_) => "delay",
            Self::Log(_) => "log",
            Self::Record(_) => "record",
            Self::Play(_) => "play",
            Self::Compose(_) => "compose",
            Self::Router(_) => "router",
        }
    }

    /// Returns the topics that the node publishes.
    const fn publishes(&self) -> &'static [&'static str] {
        match self {
            Self::Emulate(_) => emulate::PUBLISHES,
            Self::Bridge(_) => bridge::PUBLISHES,
            Self::Encode(_) => encode::PUBLISHES,
            Self::Decode(_) => decode::PUBLISHES,
            Self::Density(_) => density::PUBLISHES,
            Self::Delay(_)
            | Self::Log(_)
            | Self::Record(_)
            | Self::Play(_)
            | Self::Compose(_)
            | Self::Router(_) => &[],
        }
    }

    fn run(self, context: Context, operators: &Operators) -> Result<()> {
        match self {
            Self::Emulate(node) => node.run(context),
            Self::Bridge(node) => node.run(context),
            Self::Encode(node) => node.run(context, operators),
            Self::Decode(node) => node.run(context, operators),
            Self::Density(node) => node.run(context),
            Self::Delay(node) => node.run(context),
            Self::Log(node) => node.run(context, operators),
            Self::Record(node) => node.run(context),
            Self::Play(node) => node.run(context),
            Self::Compose(_) | Self::Router(_) => bail!("this is no node"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_of_nodes_are_short_unless_they_are_said() {
        let window_us = |arguments: &[&str]| {
            let words = ["eecvs-ros", "encode"].iter().chain(arguments);
            let words = words.map(|word| (*word).to_owned()).collect();
            let node = named(&RosArguments::default(), &["encode".to_owned()]);
            let node = node.unwrap().remove(0);
            let (_, parameters) = parse(words, &node).unwrap();
            let found = parameters.into_iter().find(|(name, _)| name == "window_us");
            found.unwrap().1
        };
        assert_eq!(window_us(&[]), encode::WINDOW_US);
        assert_eq!(window_us(&["--window-us", "32768"]), "32768");
    }
}
