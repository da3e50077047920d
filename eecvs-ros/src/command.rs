//! The `eecvs-ros` command: runs one node in a process, or several.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow, bail, ensure};
use clap::builder::ValueParser;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};
use eecvs_cli::output::{end, exit_at};
use eecvs_cli::say;
use eecvs_cli::variable::have_zenoh_threads;
use usb_bridge::stop::Stop;

use crate::arguments::{NodeArguments, RosArguments};
use crate::node::{
    Context, Lost, NAMESPACE, bridge, decode, delay, density, emulate, encode, log, play, record,
};
use crate::operator::{Operator, Operators};
use crate::parameters::{Accept, Descriptor, Parameters, descriptor};
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

/// Error: arguments that cannot be used, with exit status 2 as for a wrong flag.
#[derive(Debug, thiserror::Error)]
#[error("{0:#}")]
struct Usage(anyhow::Error);

/// Runs the command, with operators beside the project's own. A program must call this before it does anything
/// else, since the process may replace itself in order to set an environment variable.
pub fn run(operators: Vec<Box<dyn Operator>>) -> ExitCode {
    have_zenoh_threads();
    let operators = Arc::new(Operators::new(operators));
    let ended = start(&operators).and_then(|()| {
        ensure!(
            !HAS_PANICKED.load(Ordering::Relaxed),
            "a thread of this program panicked, see above: messages after that are lost; please report this"
        );
        Ok(())
    });
    let is_usage = ended.as_ref().is_err_and(anyhow::Error::is::<Usage>);
    match end("eecvs-ros", ended) {
        _ if is_usage => ExitCode::from(2),
        status => status,
    }
}

/// Whether any thread has panicked.
static HAS_PANICKED: AtomicBool = AtomicBool::new(false);

/// Returns the stop of the program, which is also asked where a thread panics: the nodes then finish their files. A
/// node whose transport has ended would otherwise wait for messages that never come, and count none of them as lost.
fn stop_of_all() -> Result<Stop> {
    let stop = Stop::on_signals()?;
    let (report, asked) = (std::panic::take_hook(), stop.clone());
    std::panic::set_hook(Box::new(move |panic| {
        HAS_PANICKED.store(true, Ordering::Relaxed);
        report(panic);
        asked.ask();
    }));
    Ok(stop)
}

fn start(operators: &Arc<Operators>) -> Result<()> {
    let (ros, rest) = RosArguments::split(std::env::args_os()).map_err(Usage)?;
    // A first pass, to find the node: only then are its parameters known, which become flags too.
    let first = command_line().ignore_errors(true);
    let first = first.try_get_matches_from(&rest);
    let first = first.unwrap_or_else(|error| exit_at(&error));
    let name = match first.subcommand_name() {
        Some(name) if is_node(name) => name.to_owned(),
        _ => {
            let line = parsed(command_line().try_get_matches_from(&rest))?;
            let stop = stop_of_all()?;
            return match line.command {
                Command::Compose(compose) => {
                    composed(&compose, &line.network, &ros, operators, &stop)
                }
                Command::Router(_) => {
                    named(&ros, &[])?;
                    route(&line.network.links, &stop)
                }
                _ => bail!("this is not a command"),
            };
        }
    };
    let stop = stop_of_all()?;
    let (arguments, declared) = named(&ros, &[name])?.remove(0);
    let (line, parameters) = parse(rest, &arguments, declared)?;
    let transport = line.network.open()?;
    let context = Context::new(transport.as_ref(), arguments, parameters, stop)?;
    line.command.run(context, operators)
}

/// Returns the parsed command line; an error ends the process.
fn parsed(matches: clap::error::Result<clap::ArgMatches>) -> Result<EecvsRos> {
    match matches.and_then(|matches| EecvsRos::from_arg_matches(&matches)) {
        Ok(line) => Ok(line),
        Err(error) => exit_at(&error),
    }
}

/// Returns whether a command is a node.
fn is_node(command: &str) -> bool {
    !["compose", "router", "help"].contains(&command)
}

/// Returns a command line with a node's parameters inserted as flags: `before` in front of its own, and `behind`
/// behind them.
fn with_flags(line: &[OsString], before: &[OsString], behind: &[OsString]) -> Vec<OsString> {
    let names: Vec<OsString> = command_line()
        .get_subcommands()
        .map(|command| command.get_name().into())
        .collect();
    let at = line.iter().position(|word| names.contains(word));
    let (front, own) = line.split_at(at.map_or(line.len(), |at| at + 1));
    // What follows this mark is no flag.
    let end = own.iter().position(|word| word == "--");
    let (own, rest) = own.split_at(end.unwrap_or(own.len()));
    [front, before, own, behind, rest].concat()
}

/// Parses the command line with a node's parameters; also returns all of its flags as parameters.
fn parse(
    line: Vec<OsString>,
    node: &NodeArguments,
    declared: Vec<Descriptor>,
) -> Result<(EecvsRos, Arc<Parameters>)> {
    let mut given = Vec::new();
    descriptor::put_flags(&declared, &node.parameters, &mut given)
        .map_err(|why| Usage(anyhow::anyhow!("--ros-args: {}: {why}", node.name.full())))?;
    let matches = command_line().try_get_matches_from(with_flags(&line, &given, &[]));
    let matches = matches.unwrap_or_else(|error| exit_at(&error));
    let of_node = matches.subcommand().map(|(_, matches)| matches.clone());
    let all = declared.clone();
    let accept: Accept = Box::new(move |set| {
        let mut behind = Vec::new();
        descriptor::put_flags(&all, set, &mut behind)?;
        let matches = command_line().try_get_matches_from(with_flags(&line, &given, &behind));
        let matches = matches.map_err(|error| descriptor::reason(&error))?;
        let of_node = matches.subcommand().map(|(_, matches)| matches.clone());
        Ok(of_node.unwrap_or_default())
    });
    let parameters = Parameters::new(declared, of_node.unwrap_or_default(), accept);
    Ok((EecvsRos::from_arg_matches(&matches)?, parameters))
}

/// Returns the arguments of the nodes of these commands, all of which run in this process, and their parameters.
fn named(ros: &RosArguments, commands: &[String]) -> Result<Vec<(NodeArguments, Vec<Descriptor>)>> {
    let mut line = command_line();
    // Gives each command the global flags.
    line.build();
    let mut nodes = Vec::new();
    for name in commands {
        let declared = match line.find_subcommand(name) {
            Some(command) => Descriptor::all_of(command, changeable(name)),
            None => vec![Descriptor::use_sim_time()],
        };
        let node = ros.node(NAMESPACE, name, &declared).map_err(Usage)?;
        nodes.push((node, declared));
    }
    let all: Vec<_> = nodes
        .iter()
        .map(|(node, declared)| (node.name.clone(), declared.as_slice()))
        .collect();
    ros.check(&all, |node, name| {
        say!("eecvs-ros: --ros-args: {node}: no node here has the parameter {name}");
    })
    .map_err(Usage)?;
    Ok(nodes)
}

/// Returns the parameters of a node that can be set while it runs.
fn changeable(command: &str) -> &'static [&'static str] {
    match command {
        "emulate" => emulate::CHANGEABLE,
        "play" => play::CHANGEABLE,
        "decode" => decode::CHANGEABLE,
        _ => &[],
    }
}

fn composed(
    compose: &Compose,
    network: &NetworkOptions,
    ros: &RosArguments,
    operators: &Arc<Operators>,
    stop: &Stop,
) -> Result<()> {
    if let Some(name) = compose.nodes.iter().find(|name| !is_node(name)) {
        return Err(Usage(anyhow::anyhow!("compose: {name} is not a node")).into());
    }
    let nodes = named(ros, &compose.nodes)?;
    let mut parsed = Vec::new();
    for (name, (arguments, declared)) in compose.nodes.iter().zip(nodes) {
        let line = vec!["eecvs-ros".into(), name.into()];
        let (line, parameters) = parse(line, &arguments, declared)?;
        parsed.push((name, line.command, arguments, parameters));
    }
    let transport = Local::before(network.open()?);
    for (_, command, arguments, _) in &parsed {
        for topic in command.publishes() {
            transport.expect(arguments.topic(topic)?);
        }
    }
    let mut nodes = Vec::new();
    for (name, command, arguments, parameters) in parsed {
        let context = Context::new(&transport, arguments, parameters, stop.clone())?;
        nodes.push((name.clone(), command, context));
    }
    let mut threads = Vec::new();
    for (name, command, context) in nodes {
        let operators = Arc::clone(operators);
        let thread = thread::Builder::new()
            .name(name.clone())
            .spawn(move || command.run(context, &operators))
            .context("starting the thread of a node")?;
        threads.push((name, thread));
    }
    let mut result = Ok(());
    for (name, thread) in threads {
        let ended = match thread.join() {
            Ok(ended) => ended.context(name),
            Err(_) => Err(anyhow!("{name}: the node panicked: please report this")),
        };
        if ended.as_ref().is_err_and(|error| !error.is::<Lost>()) {
            // The other nodes do not go on without it; one that has lost messages has come to its end.
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
    say!("eecvs-ros: a router listens on {listens}");
    let mut told = (0, 0);
    while !stop.is_asked() {
        let (routers, others) = router.connected();
        if (routers, others) != told {
            say!("eecvs-ros: connected: {routers} routers, {others} others");
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
                domain_id
                    .with_context(|| format!("ROS_DOMAIN_ID is {text:?}: it must be 0 to 232"))?
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
            Self::Compose(_) | Self::Router(_) => bail!("this is not a node"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::Kind;

    #[test]
    fn windows_of_nodes_are_short_unless_they_are_said() {
        let window_us = |arguments: &[&str]| {
            let words = ["eecvs-ros", "encode"].iter().chain(arguments);
            let words = words.map(OsString::from).collect();
            let nodes = named(&RosArguments::default(), &["encode".to_owned()]);
            let (node, declared) = nodes.unwrap().remove(0);
            let (_, parameters) = parse(words, &node, declared).unwrap();
            let value = parameters.get(&["window_us".to_owned()]).unwrap();
            value[0].as_ref().unwrap().to_string()
        };
        assert_eq!(window_us(&[]), encode::WINDOW_US);
        assert_eq!(window_us(&["--window-us", "32768"]), "32768");
    }

    /// Each parameter of every node has a description; one that can be set later is not a switch, which a flag could
    /// not turn off again.
    #[test]
    fn parameters_are_described() {
        let mut line = command_line();
        line.build();
        let nodes = line.get_subcommands().map(clap::Command::get_name);
        for name in nodes.filter(|name| is_node(name)) {
            let (_, declared) = named(&RosArguments::default(), &[name.to_owned()])
                .unwrap()
                .remove(0);
            let found = |name: &&&str| declared.iter().any(|known| known.name == ***name);
            let changeable = changeable(name);
            assert_eq!(changeable.iter().filter(found).count(), changeable.len());
            for each in declared {
                assert!(!each.description.is_empty(), "{name}: {}", each.name);
                let is_sim_time = each.name == descriptor::USE_SIM_TIME;
                assert!(each.read_only || is_sim_time || each.kind != Kind::Bool);
            }
        }
    }
}
