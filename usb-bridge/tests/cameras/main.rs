//! Cameras and encoders on USB: what devices send, what is made of it, and the command.

mod consumers;
mod inivation;
mod kills;
mod list;
mod mcu;
mod nested;
mod order;
mod prophesee_cameras;
mod prophesee_streams;
mod receivers;
mod signals;
mod silence;
mod simulate;
mod stream;
mod support;
mod trace;
mod usb_class;
mod usbip;
#[cfg(unix)]
mod usbredir;
