//! Parsers for flags whose values are types of libraries that know nothing of a command line.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use eecvs::reconstruct::events::Finder;
use event_emulator::{Model, PRESETS, Preset};
use mcu_link::qemu::Machine;

/// Returns the parser of a scene name; the help describes each scene in one line.
pub fn preset() -> impl TypedValueParser<Value = Preset> {
    let values = PRESETS.map(|preset| PossibleValue::new(preset.name()).help(preset.about()));
    named(values, Preset::from_name)
}

/// Returns the parser of the number of an emulator's model; the help describes each model in one line.
pub fn model() -> impl TypedValueParser<Value = Model> {
    let values = Model::ALL.map(|model| PossibleValue::new(model.name()).help(model.about()));
    named(values, |name| {
        Model::ALL.into_iter().find(|model| model.name() == name)
    })
}

/// Returns the parser for a method of finding event times; the help describes each method in one line.
pub fn finder() -> impl TypedValueParser<Value = Finder> {
    let values = Finder::ALL.map(|finder| PossibleValue::new(finder.name()).help(finder.about()));
    named(values, Finder::from_name)
}

/// Returns the parser of the name of an emulated machine; the help describes each machine in one line.
pub fn machine() -> impl TypedValueParser<Value = Machine> {
    let values =
        Machine::ALL.map(|machine| PossibleValue::new(machine.name()).help(machine.about()));
    named(values, Machine::from_name)
}

fn named<T: Clone + Send + Sync + 'static, const N: usize>(
    values: [PossibleValue; N],
    from_name: fn(&str) -> Option<T>,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(values).try_map(move |name| from_name(&name).ok_or("unknown name"))
}
