//! A node's parameters: their types, ranges and values, as ROS 2 describes, checks and sets them.
//!
//! A node's parameters are the flags of its command ([`descriptor`]). Most of them take effect when the node starts
//! and are read-only from then on; the others can be set while the node runs, and [`Parameters::newer`] gives the
//! node its command with the new values. All rules and reasons are those of rclcpp: types are never converted, so an
//! integer is not a value of a parameter of type double; undeclared parameters can be neither read nor set; no
//! parameter can be undeclared.

pub mod descriptor;
mod value;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use clap::ArgMatches;

pub use descriptor::{Descriptor, Range, USE_SIM_TIME};
pub use value::{Kind, Value};

/// Parses a node's command with parameters that were set in addition to its own flags; the error says what is wrong.
pub type Accept = Box<dyn Fn(&BTreeMap<String, Value>) -> Result<ArgMatches, String> + Send + Sync>;

/// The parameters of a running node.
pub struct Parameters {
    declared: BTreeMap<String, Descriptor>,
    accept: Accept,
    state: Mutex<State>,
    /// Number of changes so far.
    version: AtomicU64,
}

struct State {
    /// Parameters without a value are absent.
    values: BTreeMap<String, Value>,
    /// What has been set since the start.
    set: BTreeMap<String, Value>,
    /// The node's command with these values.
    matches: ArgMatches,
}

impl Parameters {
    /// Declares parameters, whose values are in `matches`, the node's parsed command.
    #[must_use]
    pub fn new(declared: Vec<Descriptor>, matches: ArgMatches, accept: Accept) -> Arc<Self> {
        let values = declared.iter().filter_map(|descriptor| {
            let value = descriptor.value_in(&matches)?;
            Some((descriptor.name.clone(), value))
        });
        let values = values.collect();
        let declared = declared
            .into_iter()
            .map(|descriptor| (descriptor.name.clone(), descriptor));
        Arc::new(Self {
            declared: declared.collect(),
            accept,
            state: Mutex::new(State {
                values,
                set: BTreeMap::new(),
                matches,
            }),
            version: AtomicU64::new(0),
        })
    }

    /// Declares only the parameter that every node has.
    #[must_use]
    pub fn none() -> Arc<Self> {
        let accept: Accept = Box::new(|_| Ok(ArgMatches::default()));
        Self::new(
            vec![Descriptor::use_sim_time()],
            ArgMatches::default(),
            accept,
        )
    }

    /// Locks the state. Poisoning is ignored: a panic while it is locked leaves it consistent.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns all parameters with their values; `None` for those without one.
    #[must_use]
    pub fn all(&self) -> Vec<(String, Option<Value>)> {
        let state = self.state();
        let names = self.declared.keys();
        names
            .map(|name| (name.clone(), state.values.get(name).cloned()))
            .collect()
    }

    /// Returns the names below any of `prefixes`, or all without prefixes, and the prefixes of these names. `depth`
    /// limits the number of levels; 0 does not.
    #[must_use]
    pub fn list(&self, prefixes: &[String], depth: u64) -> (Vec<String>, Vec<String>) {
        let is_within = |levels: &str| depth == 0 || (levels.matches('.').count() as u64) < depth;
        let is_below = |name: &str, prefix: &String| {
            name == prefix
                || name
                    .strip_prefix(prefix.as_str())
                    .and_then(|rest| rest.strip_prefix('.'))
                    .is_some_and(&is_within)
        };
        let (mut names, mut found) = (Vec::new(), Vec::new());
        for name in self.declared.keys() {
            let is_listed = match prefixes {
                [] => is_within(name),
                prefixes => prefixes.iter().any(|prefix| is_below(name, prefix)),
            };
            if !is_listed {
                continue;
            }
            names.push(name.clone());
            if let Some((prefix, _)) = name.rsplit_once('.')
                && !found.iter().any(|known| known == prefix)
            {
                found.push(prefix.to_owned());
            }
        }
        (names, found)
    }

    /// Returns the values of these parameters, `None` for one without a value; or `None` if one is not declared.
    #[must_use]
    pub fn get(&self, names: &[String]) -> Option<Vec<Option<Value>>> {
        let state = self.state();
        let value = |name: &String| {
            self.declared
                .contains_key(name)
                .then(|| state.values.get(name).cloned())
        };
        names.iter().map(value).collect()
    }

    /// Returns the descriptions of these parameters; `None` if one is not declared.
    #[must_use]
    pub fn describe(&self, names: &[String]) -> Option<Vec<&Descriptor>> {
        names.iter().map(|name| self.declared.get(name)).collect()
    }

    /// Sets all of these parameters, or none. A value of `None` would undeclare its parameter.
    ///
    /// # Errors
    /// A parameter is not declared or read-only, or a value is of another type, out of range or not supported; the
    /// error is the reason.
    pub fn set(&self, changes: &[(String, Option<Value>)]) -> Result<(), String> {
        let mut state = self.state();
        let mut set = state.set.clone();
        for (name, value) in changes {
            let descriptor = self.declared.get(name).ok_or_else(|| {
                format!("parameter '{name}' cannot be set because it was not declared")
            })?;
            if descriptor.read_only {
                return Err(format!(
                    "parameter '{name}' cannot be set because it is read-only: it takes effect when the node starts, \
                     with -p {name}:=VALUE"
                ));
            }
            let Some(value) = value else {
                return Err(format!(
                    "parameter '{name}': cannot undeclare a statically typed parameter"
                ));
            };
            descriptor.check(value)?;
            if name != USE_SIM_TIME {
                set.insert(name.clone(), value.clone());
            }
        }
        let matches = (self.accept)(&set)?;
        for (name, value) in &set {
            state.values.insert(name.clone(), value.clone());
        }
        state.set = set;
        state.matches = matches;
        self.version.fetch_add(1, Ordering::Release);
        Ok(())
    }

    /// Returns whether parameters have been set since `seen`.
    #[must_use]
    pub fn is_newer(&self, seen: u64) -> bool {
        self.version.load(Ordering::Acquire) != seen
    }

    /// Returns the node's command with the present values, and the number for `seen`, if parameters have been set
    /// since `seen`.
    #[must_use]
    pub fn newer(&self, seen: u64) -> Option<(u64, ArgMatches)> {
        if !self.is_newer(seen) {
            return None;
        }
        let state = self.state();
        let version = self.version.load(Ordering::Acquire);
        Some((version, state.matches.clone()))
    }
}

#[cfg(test)]
mod tests {
    use clap::{Arg, ArgAction, Command};

    use super::*;

    fn command() -> Command {
        Command::new("node")
            .args_override_self(true)
            .arg(
                Arg::new("rate_hz")
                    .long("rate-hz")
                    .default_value("30")
                    .value_parser(clap::value_parser!(u16).range(1..=100)),
            )
            .arg(
                Arg::new("gain")
                    .long("gain")
                    .value_parser(clap::value_parser!(f64)),
            )
            .arg(
                Arg::new("window_us")
                    .long("window-us")
                    .default_value("5")
                    .value_parser(clap::value_parser!(u32)),
            )
            .arg(Arg::new("names").long("names").action(ArgAction::Append))
            .arg(Arg::new("a.b").long("a-b").default_value("x"))
            .arg(Arg::new("a.b.c").long("a-b-c").default_value("x"))
            .arg(Arg::new("quick").long("quick").action(ArgAction::SetTrue))
    }

    fn parameters() -> Arc<Parameters> {
        let declared = Descriptor::all_of(&command(), &["rate_hz", "gain", "names"]);
        let matches = command().get_matches_from(["node", "--quick"]);
        let flags = Descriptor::all_of(&command(), &[]);
        let accept: Accept = Box::new(move |set| {
            let mut line = vec!["node".into()];
            descriptor::put_flags(&flags, set, &mut line)?;
            let matches = command().try_get_matches_from(line);
            matches.map_err(|error| descriptor::reason(&error))
        });
        Parameters::new(declared, matches, accept)
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn set(parameters: &Parameters, name: &str, value: Value) -> Result<(), String> {
        parameters.set(&[(name.to_owned(), Some(value))])
    }

    #[test]
    fn values_have_the_types_of_their_flags() {
        let parameters = parameters();
        let all = ["rate_hz", "gain", "quick", "a.b", "use_sim_time"];
        let values = parameters.get(&names(&all)).unwrap();
        let want = [
            Some(Value::Integer(30)),
            None,
            Some(Value::Bool(true)),
            Some(Value::Text("x".to_owned())),
            Some(Value::Bool(false)),
        ];
        assert_eq!(values, want);
        assert_eq!(parameters.get(&names(&["rate_hz", "other"])), None);
        assert!(parameters.describe(&names(&["other"])).is_none());
        let described = parameters
            .describe(&names(&["gain", "names", "rate_hz"]))
            .unwrap();
        let kinds: Vec<_> = described.iter().map(|each| each.kind.name()).collect();
        assert_eq!(kinds, ["double", "string_array", "integer"]);
        assert_eq!(
            described[2].range(),
            Some(Range::Integer { from: 1, to: 100 })
        );
        assert!(!described[2].read_only);
    }

    #[test]
    fn what_is_set_takes_effect_or_is_refused_with_its_reason() {
        let parameters = parameters();
        assert!(parameters.newer(0).is_none());
        set(&parameters, "rate_hz", Value::Integer(50)).unwrap();
        set(&parameters, "gain", Value::Double(0.5)).unwrap();
        let (seen, matches) = parameters.newer(0).unwrap();
        assert_eq!(matches.get_one::<u16>("rate_hz"), Some(&50));
        assert_eq!(matches.get_one::<f64>("gain"), Some(&0.5));
        assert!(parameters.newer(seen).is_none());
        for (name, value, reason) in [
            ("rate_hz", Value::Integer(101), "101 is not in 1..=100"),
            (
                "rate_hz",
                Value::Double(50.0),
                "is of type {integer}, setting it to {double}",
            ),
            (
                "gain",
                Value::Integer(1),
                "is of type {double}, setting it to {integer}",
            ),
            ("window_us", Value::Integer(5), "read-only"),
            ("other", Value::Integer(5), "was not declared"),
            ("use_sim_time", Value::Bool(true), "computer's"),
            ("use_sim_time", Value::Integer(1), "is of type {bool}"),
        ] {
            let refused = set(&parameters, name, value).unwrap_err();
            assert!(refused.contains(reason), "{refused}");
        }
        assert!(parameters.set(&[("gain".to_owned(), None)]).is_err());
        set(&parameters, "use_sim_time", Value::Bool(false)).unwrap();
        // All or none.
        let both = [
            ("gain".to_owned(), Some(Value::Double(2.0))),
            ("rate_hz".to_owned(), Some(Value::Integer(0))),
        ];
        parameters.set(&both).unwrap_err();
        let values = parameters.get(&names(&["gain", "rate_hz"])).unwrap();
        assert_eq!(values, [Some(Value::Double(0.5)), Some(Value::Integer(50))]);
    }

    #[test]
    fn names_are_listed_by_prefix_and_depth() {
        let parameters = parameters();
        let list = |prefixes: &[&str], depth| parameters.list(&names(prefixes), depth);
        let (all, prefixes) = list(&[], 0);
        assert_eq!(all.len(), 8);
        assert_eq!(prefixes, ["a", "a.b"]);
        assert_eq!(list(&[], 1).0.len(), 6);
        assert_eq!(
            list(&["a"], 0),
            (names(&["a.b", "a.b.c"]), names(&["a", "a.b"]))
        );
        assert_eq!(list(&["a"], 1), (names(&["a.b"]), names(&["a"])));
        assert_eq!(list(&["a.b"], 1).0, ["a.b", "a.b.c"]);
        assert_eq!(list(&["rate"], 0), (Vec::new(), Vec::new()));
    }
}
