//! Values of flags that are types of a library, which knows of no command line.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use eecvs::reconstruct::events::Finder;
use event_emulator::{PRESETS, Preset};
use mcu_link::qemu::Machine;

/// Parses the name of a scene; the help has a line about each.
pub fn preset() -> impl TypedValueParser<Value = Preset> {
    let values = PRESETS.map(|preset| PossibleValue::new(preset.name()).help(preset.about()));
    named(values, Preset::from_name)
}

/// Parses the name of a way to find event times; the help has a line about each.
pub fn finder() -> impl TypedValueParser<Value = Finder> {
    let values = Finder::ALL.map(|finder| PossibleValue::new(finder.name()).help(finder.about()));
    named(values, Finder::from_name)
}

/// Parses the name of a machine that QEMU emulates; the help has a line about each.
pub fn machine() -> impl TypedValueParser<Value = Machine> {
    let values =
        Machine::ALL.map(|machine| PossibleValue::new(machine.name()).help(machine.about()));
    named(values, Machine::from_name)
}

fn named<T: Clone + Send + Sync + 'static, const N: usize>(
    values: [PossibleValue; N],
    from_name: fn(&str) -> Option<T>,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(values).try_map(move |name| from_name(&name).ok_or("no such name"))
}
