//! The `eecvs` command.
fn main() {}
