//! Serves a simulated device to hosts that come and go; each host gets it from the beginning.

use std::io::ErrorKind;
use std::net::{TcpListener, TcpStream};
use std::thread::ScopedJoinHandle;
use std::time::Duration;

use anyhow::{Context, Result};

use super::Peripheral;
use super::socket::{self, Change, Report};
use super::usbip::{self, Operation, UsbIp};
use crate::stop::Stop;

/// Wait between two checks for a host.
pub(super) const LOOK: Duration = Duration::from_millis(20);

/// What is served, until when, and who is informed.
pub struct Service<'s> {
    /// Creates the device anew for every host.
    pub device: &'s mut dyn FnMut() -> Result<Box<dyn Peripheral>>,
    /// Ends the service.
    pub stop: &'s Stop,
    /// Whether to end after the first host that had the device.
    pub once: bool,
    /// Called when a host has left, or was turned away with an error.
    pub left: &'s mut dyn FnMut(&Result<Report>),
}

/// Serves hosts over USB/IP: one host has the device, and others can only list it.
///
/// # Errors
/// The device cannot be created, or the system refuses the socket; with `once`, also the host's protocol error.
pub fn serve_usbip(listener: &TcpListener, service: &mut Service<'_>) -> Result<()> {
    listener.set_nonblocking(true).context("socket")?;
    let stop = service.stop;
    let stopped = || stop.is_asked();
    let mut device = Some((service.device)()?);
    let descriptors = device
        .as_ref()
        .map(|device| device.descriptors().clone())
        .context("there is no device to serve")?;
    std::thread::scope(|scope| {
        let mut busy: Option<ScopedJoinHandle<'_, Result<Report>>> = None;
        loop {
            if let Some(host) = busy.take_if(|host| host.is_finished()) {
                let served = host.join().unwrap_or_else(|_| {
                    Err(anyhow::anyhow!(
                        "the device's thread panicked: please report this"
                    ))
                });
                (service.left)(&served);
                if service.once {
                    return served.map(|_| ());
                }
            }
            if stopped() && busy.is_none() {
                return Ok(());
            }
            let mut socket = match listener.accept() {
                Ok((socket, _)) => socket,
                Err(error) if is_later(&error) => {
                    std::thread::sleep(LOOK);
                    continue;
                }
                Err(error) => return Err(error).context("socket"),
            };
            // Answers are small and awaited, so they must not be delayed.
            let _ = socket.set_nodelay(true);
            match usbip::operation(&mut socket, &descriptors, busy.is_none() && !stopped()) {
                Ok(Operation::Imported) => {
                    let device = match device.take() {
                        Some(device) => device,
                        None => (service.device)()?,
                    };
                    let one = move || carry(socket, device, stop);
                    busy = Some(scope.spawn(one));
                }
                Ok(Operation::Listed | Operation::Refused) => {}
                Err(error) => (service.left)(&Err(error)),
            }
        }
    })
}

/// Carries an imported device until its host leaves.
fn carry(mut socket: TcpStream, device: Box<dyn Peripheral>, stop: &Stop) -> Result<Report> {
    let mut session = UsbIp::new(device);
    socket::serve(&mut socket, &mut session, &mut || {
        stop.is_asked().then_some(Change::End)
    })
}

/// Returns whether the error only means that no host has connected yet.
pub(super) fn is_later(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionAborted
    )
}
