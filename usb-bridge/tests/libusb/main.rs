//! The link over the real libusb, against a device that libumockdev mocks: enumeration, control
//! requests, the stream, everything that can go wrong with it, and every model.
//!
//! Most tests run twice: once as the device, and once more in a process that sees its USB.

#[path = "../cameras/usb_class/application.rs"]
#[allow(dead_code, reason = "shared with the tests on the bus in memory")]
mod application;
mod attached;
mod clients;
mod counter;
mod encoder;
mod faults;
mod models;
#[path = "../../guest/recordings.rs"]
mod recordings;
mod run;
mod stream;
mod umockdev;
mod waiting;
