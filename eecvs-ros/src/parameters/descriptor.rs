//! Descriptions of parameters, derived from the flags of a command.

use std::any::TypeId;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::num::{
    NonZeroI32, NonZeroI64, NonZeroU8, NonZeroU16, NonZeroU32, NonZeroU64, NonZeroUsize,
};
use std::time::Duration;

use clap::builder::ValueParser;
use clap::{Arg, ArgAction, ArgMatches, Command};

use super::{Kind, Value};

/// The parameter that every node of ROS 2 has.
pub const USE_SIM_TIME: &str = "use_sim_time";

/// Why [`USE_SIM_TIME`] cannot be true.
pub const SIM_TIME_REFUSAL: &str = "use_sim_time: true is not supported: messages are stamped by the computer's clock, \
     and events have the sensor's times; leave it out, or set it to false";

/// The values that a number may have, both ends included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// For integers.
    Integer {
        /// Smallest value.
        from: i64,
        /// Largest value.
        to: i64,
    },
    /// For numbers with fractions.
    Double {
        /// Smallest value.
        from: f64,
        /// Largest value.
        to: f64,
    },
}

/// A parameter's description.
#[derive(Clone)]
pub struct Descriptor {
    /// Name of the parameter: that of the flag, with `_` for `-`.
    pub name: String,
    /// Type of its values.
    pub kind: Kind,
    /// What it does: the flag's help.
    pub description: String,
    /// What a value must fulfil beside its type and range.
    pub constraints: String,
    /// Whether it can be set only when the node starts.
    pub read_only: bool,
    /// Whether it may be without a value.
    pub is_optional: bool,
    /// The flag with its dashes; `None` for an argument without a flag.
    flag: Option<String>,
    /// Parser of the flag's value; `None` for [`USE_SIM_TIME`].
    parser: Option<ValueParser>,
    /// A value that is in the range, if one is known.
    valid: Option<String>,
}

impl Descriptor {
    /// Describes [`USE_SIM_TIME`].
    #[must_use]
    pub fn use_sim_time() -> Self {
        Self {
            name: USE_SIM_TIME.to_owned(),
            kind: Kind::Bool,
            description: "Take the time from /clock: not supported".to_owned(),
            constraints: "Must be false: messages are stamped by the computer's clock".to_owned(),
            read_only: false,
            is_optional: false,
            flag: None,
            parser: None,
            valid: None,
        }
    }

    /// Describes all parameters of a command; those named in `changeable` can be set while its node runs.
    #[must_use]
    pub fn all_of(command: &Command, changeable: &[&str]) -> Vec<Self> {
        let mut all: Vec<Self> = command
            .get_arguments()
            .filter(|arg| {
                !matches!(
                    arg.get_action(),
                    ArgAction::Help
                        | ArgAction::HelpShort
                        | ArgAction::HelpLong
                        | ArgAction::Version
                )
            })
            .map(|arg| Self::of(arg, changeable.contains(&arg.get_id().as_str())))
            .collect();
        all.push(Self::use_sim_time());
        all
    }

    fn of(arg: &Arg, is_changeable: bool) -> Self {
        let takes_values = arg.get_action().takes_values();
        let parser = arg.get_value_parser();
        let is_list = matches!(arg.get_action(), ArgAction::Append);
        let kind = match (takes_values, number_of(parser)) {
            (false, _) => Kind::Bool,
            (true, Some(Number::Integer { .. })) if is_list => Kind::Integers,
            (true, Some(Number::Integer { .. })) => Kind::Integer,
            (true, Some(_)) if is_list => Kind::Doubles,
            (true, Some(_)) => Kind::Double,
            (true, None) if is_list => Kind::Texts,
            (true, None) => Kind::Text,
        };
        let mut constraints = Vec::new();
        let possible: Vec<String> = arg
            .get_possible_values()
            .iter()
            .map(|value| value.get_name().to_owned())
            .collect();
        if takes_values && !possible.is_empty() {
            constraints.push(format!("One of: {}", possible.join(", ")));
        }
        if !is_changeable {
            constraints.push("Takes effect when the node starts".to_owned());
        }
        let long = arg.get_long().map(|long| format!("--{long}"));
        let short = || arg.get_short().map(|short| format!("-{short}"));
        let default = arg.get_default_values().first();
        Self {
            name: arg.get_id().to_string(),
            kind,
            description: arg.get_help().map(ToString::to_string).unwrap_or_default(),
            constraints: constraints.join(". "),
            read_only: !is_changeable,
            is_optional: takes_values && default.is_none(),
            flag: long.or_else(short),
            parser: takes_values.then(|| parser.clone()),
            valid: default.and_then(|default| default.to_str().map(str::to_owned)),
        }
    }

    /// Checks a value's type, and that [`USE_SIM_TIME`] is false. Ranges are checked by the flag's parser.
    ///
    /// # Errors
    /// The reason why the value is refused.
    pub fn check(&self, value: &Value) -> Result<(), String> {
        if value.kind() != self.kind {
            return Err(self.kind.refusal(&self.name, value.kind()));
        }
        if self.name == USE_SIM_TIME && *value == Value::Bool(true) {
            return Err(SIM_TIME_REFUSAL.to_owned());
        }
        Ok(())
    }

    /// Appends the flags for a value, whose type has been checked.
    ///
    /// # Errors
    /// The parameter is an argument without a flag, or a list is empty.
    pub fn put(&self, value: &Value, line: &mut Vec<OsString>) -> Result<(), String> {
        if self.name == USE_SIM_TIME {
            return Ok(());
        }
        let name = &self.name;
        let Some(flag) = &self.flag else {
            return Err(format!(
                "{name}: give it as an argument, not as a parameter"
            ));
        };
        match value {
            Value::Bool(true) => line.push(flag.into()),
            Value::Bool(false) => {}
            value => {
                let texts = value.texts();
                if texts.is_empty() {
                    return Err(format!(
                        "{name}: the list is empty: leave the parameter out"
                    ));
                }
                line.extend(texts.iter().map(|text| format!("{flag}={text}").into()));
            }
        }
        Ok(())
    }

    /// Returns the parameter's value in a parsed command; `None` if it has none, or one that the type cannot hold.
    pub(super) fn value_in(&self, matches: &ArgMatches) -> Option<Value> {
        if self.name == USE_SIM_TIME {
            return Some(Value::Bool(false));
        }
        let raw = matches.try_get_raw(&self.name).ok().flatten()?;
        let texts: Vec<String> = raw
            .map(|text| text.to_string_lossy().into_owned())
            .collect();
        let first = texts.first();
        match self.kind {
            Kind::Bool => first?.parse().ok().map(Value::Bool),
            Kind::Integer => first?.parse().ok().map(Value::Integer),
            Kind::Double => first?.parse().ok().map(Value::Double),
            Kind::Text => first.cloned().map(Value::Text),
            Kind::Integers => numbers(&texts).map(Value::Integers),
            Kind::Doubles => numbers(&texts).map(Value::Doubles),
            Kind::Texts => Some(Value::Texts(texts)),
            Kind::Bytes | Kind::Bools => None,
        }
    }

    /// Returns the range of a number: the numbers around a valid one that the flag's parser accepts. `None` for
    /// other types, and for doubles without limits.
    #[must_use]
    pub fn range(&self) -> Option<Range> {
        let parser = self.parser.as_ref()?;
        let probe = Probe::new(parser);
        match number_of(parser)? {
            Number::Integer { from, to } => {
                let guesses = (0..63).flat_map(|bit| [1 << bit, -1 << bit]);
                let valid = self.valid.as_ref().and_then(|valid| valid.parse().ok());
                let valid = valid.into_iter().chain([0]).chain(guesses);
                let valid = valid.into_iter().find(|value: &i64| probe.accepts(value))?;
                let accepts = |value: i64| probe.accepts(&value);
                Some(Range::Integer {
                    from: farthest(valid, from, accepts),
                    to: farthest(valid, to, accepts),
                })
            }
            Number::Single => {
                let valid = self.valid.as_ref().and_then(|valid| valid.parse().ok());
                let valid = ordered(valid.unwrap_or(1.0_f32));
                let accepts = |value: i64| probe.accepts(&single(value));
                let ends = [ordered(f32::MIN), ordered(f32::MAX)];
                if !accepts(valid) || ends.into_iter().all(accepts) {
                    return None;
                }
                let [from, to] = ends.map(|end| single(farthest(valid, end, accepts)));
                Some(Range::Double {
                    from: from.into(),
                    to: to.into(),
                })
            }
            Number::Double => None,
        }
    }
}

/// Appends the flags of parameters; the descriptions are those of the command.
///
/// # Errors
/// As for [`Descriptor::put`]; a parameter is not described.
pub fn put_flags(
    descriptors: &[Descriptor],
    values: &BTreeMap<String, Value>,
    line: &mut Vec<OsString>,
) -> Result<(), String> {
    for (name, value) in values {
        let descriptor = descriptors.iter().find(|known| known.name == *name);
        let descriptor = descriptor.ok_or_else(|| format!("parameter {name} is not declared"))?;
        descriptor.put(value, line)?;
    }
    Ok(())
}

/// Returns the reason in an error of the command line, without the advice on usage.
#[must_use]
pub fn reason(error: &clap::Error) -> String {
    let text = error.to_string();
    let lines: Vec<&str> = text
        .lines()
        .take_while(|line| !line.trim().is_empty())
        .map(str::trim)
        .collect();
    lines.join(" ").trim_start_matches("error: ").to_owned()
}

fn numbers<T: std::str::FromStr>(texts: &[String]) -> Option<Vec<T>> {
    texts.iter().map(|text| text.parse().ok()).collect()
}

/// The number that a parser returns.
enum Number {
    Integer { from: i64, to: i64 },
    Single,
    Double,
}

/// Returns which number a parser returns; `None` if it returns something else.
fn number_of(parser: &ValueParser) -> Option<Number> {
    let id = parser.type_id();
    let is = |of: TypeId| id == of;
    let signed = [
        (TypeId::of::<i8>(), i8::MIN.into(), i8::MAX.into()),
        (TypeId::of::<i16>(), i16::MIN.into(), i16::MAX.into()),
        (TypeId::of::<i32>(), i32::MIN.into(), i32::MAX.into()),
        (TypeId::of::<i64>(), i64::MIN, i64::MAX),
        (TypeId::of::<isize>(), i64::MIN, i64::MAX),
    ];
    if let Some((_, from, to)) = signed.into_iter().find(|(of, ..)| is(*of)) {
        return Some(Number::Integer { from, to });
    }
    // Parameters have integers of 64 bits with a sign.
    let unsigned = [
        (TypeId::of::<u8>(), u8::MAX.into()),
        (TypeId::of::<u16>(), u16::MAX.into()),
        (TypeId::of::<u32>(), u32::MAX.into()),
        (TypeId::of::<u64>(), i64::MAX),
        (TypeId::of::<usize>(), i64::MAX),
    ];
    if let Some((_, to)) = unsigned.into_iter().find(|(of, _)| is(*of)) {
        return Some(Number::Integer { from: 0, to });
    }
    let non_zero = [
        (TypeId::of::<NonZeroU8>(), u8::MAX.into()),
        (TypeId::of::<NonZeroU16>(), u16::MAX.into()),
        (TypeId::of::<NonZeroU32>(), u32::MAX.into()),
        (TypeId::of::<NonZeroU64>(), i64::MAX),
        (TypeId::of::<NonZeroUsize>(), i64::MAX),
    ];
    if let Some((_, to)) = non_zero.into_iter().find(|(of, _)| is(*of)) {
        return Some(Number::Integer { from: 1, to });
    }
    // Signed numbers other than 0 have no range.
    debug_assert!(!is(TypeId::of::<NonZeroI32>()) && !is(TypeId::of::<NonZeroI64>()));
    if is(TypeId::of::<f32>()) {
        return Some(Number::Single);
    }
    // A duration is written in seconds.
    let is_double = is(TypeId::of::<f64>()) || is(TypeId::of::<Duration>());
    is_double.then_some(Number::Double)
}

/// A command with a single argument, which asks a parser what it accepts.
struct Probe(Command);

impl Probe {
    fn new(parser: &ValueParser) -> Self {
        let value = Arg::new("value")
            .allow_hyphen_values(true)
            .value_parser(parser.clone());
        let command = Command::new("probe")
            .no_binary_name(true)
            .disable_help_flag(true)
            .arg(value);
        Self(command)
    }

    fn accepts(&self, value: &impl ToString) -> bool {
        let matches = self.0.clone().try_get_matches_from([value.to_string()]);
        matches.is_ok()
    }
}

/// Returns the value closest to `end` up to which all from `valid` on are accepted, as the values of a range are.
fn farthest(valid: i64, end: i64, accepts: impl Fn(i64) -> bool) -> i64 {
    if accepts(end) {
        return end;
    }
    // `valid` is accepted, `refused` is not.
    let (mut valid, mut refused) = (i128::from(valid), i128::from(end));
    while (valid - refused).abs() > 1 {
        let middle = (valid + refused).div_euclid(2);
        // Between two numbers of 64 bits.
        match accepts(middle as i64) {
            true => valid = middle,
            false => refused = middle,
        }
    }
    valid as i64
}

/// Returns the position of a number among all of its type.
fn ordered(value: f32) -> i64 {
    let bits = i64::from(value.to_bits() & 0x7fff_ffff);
    if value.is_sign_negative() {
        -bits
    } else {
        bits
    }
}

/// Returns the number at a position of [`ordered`].
fn single(position: i64) -> f32 {
    let value = f32::from_bits(u32::try_from(position.unsigned_abs()).unwrap_or(0));
    if position < 0 { -value } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_those_of_the_parsers() {
        let range = |arg: Arg| Descriptor::of(&arg.long("a"), false).range();
        let integer = |from, to| Some(Range::Integer { from, to });
        let arg = || Arg::new("a");
        let signed = clap::value_parser!(i8).range(-15..=8);
        assert_eq!(range(arg().value_parser(signed)), integer(-15, 8));
        let far = clap::value_parser!(u32).range(64..=100_000_000);
        assert_eq!(range(arg().value_parser(far)), integer(64, 100_000_000));
        let whole = clap::value_parser!(u64);
        assert_eq!(range(arg().value_parser(whole)), integer(0, i64::MAX));
        let positive = clap::value_parser!(NonZeroU32);
        assert_eq!(
            range(arg().value_parser(positive)),
            integer(1, u32::MAX.into())
        );
        assert_eq!(range(arg().value_parser(clap::value_parser!(f64))), None);
        assert_eq!(range(arg().value_parser(clap::value_parser!(f32))), None);
        assert_eq!(range(arg()), None);
        let limited = |text: &str| -> Result<f32, String> {
            let value: f32 = text.parse().map_err(|_| "no number".to_owned())?;
            let is_inside = (0.25..=1000.0).contains(&value);
            is_inside
                .then_some(value)
                .ok_or_else(|| "0.25 to 1000".to_owned())
        };
        let double = Some(Range::Double {
            from: 0.25,
            to: 1000.0,
        });
        assert_eq!(range(arg().value_parser(limited)), double);
    }
}
