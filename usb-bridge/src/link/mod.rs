//! Links: what moves bytes between a device and this host.
//!
//! [`Link`] is one direction of a stream in, another out. Implementations move the bytes; wrappers
//! stand around any of them and are links themselves.

pub mod control;
pub mod faults;
pub mod listen;
pub mod loopback;
pub mod raw_file;
pub mod replay;
pub mod serial;
pub mod tcp;
pub mod trace;
pub mod usb;

use std::time::{Duration, Instant};

use thiserror::Error;

/// What a [`Link`] had to give.
#[derive(Debug, PartialEq, Eq)]
pub enum Received<'l> {
    /// The next bytes of the stream, at least one.
    Bytes {
        /// The bytes, until the next call.
        bytes: &'l [u8],
        /// When the last of them had arrived.
        at: Instant,
    },
    /// Bytes before those that come next did not arrive, and the link knows it.
    Lost {
        /// How many, where it is known.
        bytes: Option<u64>,
        /// Why.
        cause: Loss,
    },
    /// Nothing came in time.
    Nothing,
    /// The other side has ended the stream in order.
    Ended,
}

/// Why bytes did not arrive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Loss {
    /// The device sent more than was asked for.
    Overflow,
    /// A transfer failed with an error on the wire.
    Damaged,
    /// The endpoint halted and was cleared.
    Stalled,
    /// A fault that was asked for.
    Injected,
}

/// A link that failed: one line that says what to do.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The device was unplugged.
    #[error("{link}: unplugged; connect it again and start anew")]
    Unplugged {
        /// Which one.
        link: String,
    },
    /// Nobody may open it but root, so far.
    #[error("{link}: no permission to open it; {remedy}")]
    Permission {
        /// Which one.
        link: String,
        /// The udev rule, and where to put it.
        remedy: String,
    },
    /// Another program has it.
    #[error("{link}: in use by another program or driver; stop that one first")]
    Busy {
        /// Which one.
        link: String,
    },
    /// An endpoint stays halted.
    #[error("{link}: endpoint {endpoint:#04x} is stalled and stays so; reconnect the device")]
    Stalled {
        /// Which one.
        link: String,
        /// Endpoint with the direction's bit.
        endpoint: u8,
    },
    /// The bus is slower than the stream.
    #[error("{link}: is connected at {speed}; it needs USB 3: use another port or cable")]
    TooSlow {
        /// Which one.
        link: String,
        /// What the bus gave.
        speed: &'static str,
    },
    /// The address cannot be reached.
    #[error("{link}: cannot be reached: {cause}")]
    Unreachable {
        /// Which one.
        link: String,
        /// What the system says.
        cause: String,
    },
    /// Anything else.
    #[error("{link}: {cause}")]
    Failed {
        /// Which one.
        link: String,
        /// What the system says.
        cause: String,
    },
}

/// A stream of bytes from a device, and to it.
pub trait Link: Send {
    /// Name for messages: `usb 1-4 DAVIS346`, `/dev/ttyACM0`, `tcp://host:port`.
    fn name(&self) -> &str;

    /// Waits for what comes next, at most for `timeout`.
    ///
    /// # Errors
    /// The link failed; nothing comes from it any more.
    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError>;

    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// The link failed.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;

    /// The way to the device by itself, for a thread that sends while another one receives.
    ///
    /// # Errors
    /// There is none: a file, or a device that only sends.
    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        Err(LinkError::Failed {
            link: self.name().to_owned(),
            cause: "takes no bytes".to_owned(),
        })
    }
}

/// The way to a device.
pub trait Outlet: Send {
    /// Sends all of `bytes`, however slowly the device takes them.
    ///
    /// # Errors
    /// The link failed, or the device has taken nothing for seconds.
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError>;
}

/// Receives until nothing comes for `quiet`, which is longer than the device's own timeout of transfers,
/// or the stream ends: what a device sent before it stopped. `false` where bytes still come after
/// `limit`.
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

/// The moment at which `timeout` from now ends; one that no clock can hold is a day.
pub(crate) fn until(timeout: Duration) -> Instant {
    let now = Instant::now();
    now.checked_add(timeout)
        .unwrap_or(now + Duration::from_secs(24 * 60 * 60))
}
