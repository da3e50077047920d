//! Values of parameters, and their types.

use std::fmt::{self, Display, Formatter};

/// A parameter's type, by its number in `rcl_interfaces/msg/ParameterType`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `bool`.
    Bool = 1,
    /// `integer`, of 64 bits.
    Integer = 2,
    /// `double`.
    Double = 3,
    /// `string`.
    Text = 4,
    /// `byte_array`, which no parameter here has.
    Bytes = 5,
    /// `bool_array`, which no parameter here has.
    Bools = 6,
    /// `integer_array`.
    Integers = 7,
    /// `double_array`.
    Doubles = 8,
    /// `string_array`.
    Texts = 9,
}

impl Kind {
    /// Returns the name that ROS 2 has for the type.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Integer => "integer",
            Self::Double => "double",
            Self::Text => "string",
            Self::Bytes => "byte_array",
            Self::Bools => "bool_array",
            Self::Integers => "integer_array",
            Self::Doubles => "double_array",
            Self::Texts => "string_array",
        }
    }

    /// Returns an example of how a value is written in YAML.
    const fn example(self) -> &'static str {
        match self {
            Self::Bool => "true",
            Self::Integer => "30",
            Self::Double => "30.0",
            Self::Text => "'30', with quotes",
            Self::Bytes | Self::Integers => "[30]",
            Self::Bools => "[true]",
            Self::Doubles => "[30.0]",
            Self::Texts => "['30'], with quotes",
        }
    }

    /// Returns why a value of another type is refused, as rclcpp says it, and how a value of this type is written.
    #[must_use]
    pub fn refusal(self, name: &str, other: Self) -> String {
        format!(
            "Wrong parameter type, parameter {{{name}}} is of type {{{}}}, setting it to {{{}}} is not allowed: write \
             it like {}.",
            self.name(),
            other.name(),
            self.example()
        )
    }
}

/// A parameter's value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// A truth value.
    Bool(bool),
    /// An integer.
    Integer(i64),
    /// A number with a fraction.
    Double(f64),
    /// A text.
    Text(String),
    /// Bytes.
    Bytes(Vec<u8>),
    /// Truth values.
    Bools(Vec<bool>),
    /// Integers.
    Integers(Vec<i64>),
    /// Numbers with fractions.
    Doubles(Vec<f64>),
    /// Texts.
    Texts(Vec<String>),
}

impl Value {
    /// Returns the type.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Bool(_) => Kind::Bool,
            Self::Integer(_) => Kind::Integer,
            Self::Double(_) => Kind::Double,
            Self::Text(_) => Kind::Text,
            Self::Bytes(_) => Kind::Bytes,
            Self::Bools(_) => Kind::Bools,
            Self::Integers(_) => Kind::Integers,
            Self::Doubles(_) => Kind::Doubles,
            Self::Texts(_) => Kind::Texts,
        }
    }

    /// Returns the value, or its elements, as a flag takes them.
    #[must_use]
    pub fn texts(&self) -> Vec<String> {
        fn all<T: Display>(values: &[T]) -> Vec<String> {
            values.iter().map(T::to_string).collect()
        }
        match self {
            Self::Bool(value) => vec![value.to_string()],
            Self::Integer(value) => vec![value.to_string()],
            Self::Double(value) => vec![value.to_string()],
            Self::Text(text) => vec![text.clone()],
            Self::Bytes(values) => all(values),
            Self::Bools(values) => all(values),
            Self::Integers(values) => all(values),
            Self::Doubles(values) => all(values),
            Self::Texts(texts) => texts.clone(),
        }
    }
}

impl Display for Value {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.texts().join(", "))
    }
}
