//! Simulated cameras against the drivers of others, by tests/peers/cameras.py, which open them unmodified.

use crate::counter::Counter;
use crate::umockdev::Mocked;

#[path = "../../../tests/peers/script.rs"]
mod peers;

#[test]
fn drivers_of_others_open_every_camera() {
    if Mocked::new(Counter::boxed()).is_some() {
        peers::compare("cameras.py", &[env!("CARGO_BIN_EXE_eecvs-usb").into()]);
    }
}
