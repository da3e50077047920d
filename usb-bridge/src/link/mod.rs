//! Links move bytes between a device and this host.
//!
//! A [`Link`] is a stream of bytes from a device, and a way to send bytes to it. Some implementations move the
//! bytes themselves; others wrap any link, to trace it or to inject faults, and are links too.

pub mod control;
pub mod faults;
pub mod loopback;
pub mod raw_file;
pub mod replay;
pub mod serial;
pub mod tcp;
pub mod trace;
pub mod usb;

use std::time::{Duration, Instant};

use thiserror::Error;

/// Outcome of [`Link::receive`].
#[derive(Debug, PartialEq, Eq)]
pub enum Received<'l> {
    /// The next bytes of the stream, at least one.
    Bytes {
        /// The bytes, valid until the next call.
        bytes: &'l [u8],
        /// When the last of them arrived.
        at: Instant,
    },
    /// The link knows that bytes before the next ones did not arrive.
    Lost {
        /// Number of lost bytes, if known.
        bytes: Option<u64>,
        /// Cause of the loss.
        cause: Loss,
    },
    /// Nothing arrived in time.
    Nothing,
    /// The other side has ended the stream in order.
    Ended,
}

/// Why bytes did not arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Loss {
    /// The device sent more than the transfer had room for.
    Overflow,
    /// A transfer failed with an error on the wire.
    Damaged,
    /// The endpoint halted and the halt was cleared.
    Stalled,
    /// A fault injected on request.
    Injected,
}

/// Failure of a link, as one line that says what to do.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The device was unplugged.
    #[error("{link}: unplugged; connect it again and rerun the command")]
    Unplugged {
        /// Name of the link.
        link: String,
    },
    /// The user has no permission to open the device.
    #[error("{link}: no permission to open it; {remedy}")]
    Permission {
        /// Name of the link.
        link: String,
        /// How to get the permission, such as a udev rule and where to put it.
        remedy: String,
    },
    /// Another program or driver uses the device.
    #[error("{link}: in use by another program or driver; stop that one first")]
    Busy {
        /// Name of the link.
        link: String,
    },
    /// An endpoint stays halted although the halt was cleared.
    #[error("{link}: endpoint {endpoint:#04x} remains stalled; reconnect the device")]
    Stalled {
        /// Name of the link.
        link: String,
        /// Endpoint address with the direction bit.
        endpoint: u8,
    },
    /// The bus is too slow for the stream.
    #[error("{link}: is connected at {speed}; it needs USB 3: use another port or cable")]
    TooSlow {
        /// Name of the link.
        link: String,
        /// Speed at which the device is connected.
        speed: &'static str,
    },
    /// The address or device cannot be reached.
    #[error("{link}: cannot be reached: {cause}")]
    Unreachable {
        /// Name of the link.
        link: String,
        /// Cause, as the system or the library reports it.
        cause: String,
    },
    /// Any other failure.
    #[error("{link}: {cause}")]
    Failed {
        /// Name of the link.
        link: String,
        /// Cause, as the system or the library reports it.
        cause: String,
    },
}

/// A stream of bytes from a device, and a way to send bytes to it.
pub trait Link: Send {
    /// Returns the name used in messages: `usb 1-4 DAVIS346`, `/dev/ttyACM0`, `tcp://host:port`.
    fn name(&self) -> &str;

    /// Waits for the next part of the stream, for at most `timeout`.
    ///
    /// # Errors
    /// The link failed; nothing more can be received from it.
    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError>;

    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// The link failed.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// Returns a separate sender, for a thread that sends while another one receives.
    ///
    /// # Errors
    /// The link cannot send this way: a file, or a device that only sends to the host.
    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        Err(LinkError::Failed {
            link: self.name().to_owned(),
            cause: "accepts no bytes".to_owned(),
        })
    }
}

/// The sending side of a link.
pub trait Outlet: Send {
    /// Sends all of `bytes`, however slowly the device accepts them.
    ///
    /// # Errors
    /// The link failed, or the device has accepted nothing for seconds.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;
}

/// Receives what a device sent before it stopped: until nothing arrives for `quiet`, or the stream ends. `quiet`
/// must be longer than the device's own timeout of transfers. Every outcome is passed to `taken`. Returns `false`
/// if bytes still arrive after `limit`.
///
/// # Errors
/// The link failed.
pub fn drain(
    link: &mut dyn Link,
    quiet: Duration,
    limit: Duration,
    mut taken: impl FnMut(&Received<'_>),
) -> Result<bool, LinkError> {
    let deadline = until(limit);
    loop {
        let received = link.receive(quiet)?;
        taken(&received);
        match received {
            Received::Nothing | Received::Ended => return Ok(true),
            _ if Instant::now() >= deadline => return Ok(false),
            _ => {}
        }
    }
}

/// Returns the instant `timeout` from now, or one day from now if the clock cannot represent that instant.
pub(crate) fn until(timeout: Duration) -> Instant {
    let now = Instant::now();
    now.checked_add(timeout)
        .unwrap_or(now + Duration::from_secs(24 * 60 * 60))
}
