//! The stream of a USB device.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::device::Opened;
use super::outlet::UsbOutlet;
use super::ring::{Completion, Ring, Status};
use crate::device::Transfers;
use crate::link::{Link, LinkError, Loss, Outlet, Received, until};

/// Time within which cancelled transfers must come back; beyond it, the host controller is stuck.
const BACK: Duration = Duration::from_secs(5);

/// Consecutive failed transfers without any bytes after which the stream fails.
const FAILURES_MAX: usize = 64;

/// A stream of bulk transfers, several of which are in flight. The bytes of each are lent without a copy, and the
/// transfer is then submitted again.
///
/// # Hand-over
/// A transfer ends when it is full or when the device sends a short packet. If neither happens within
/// [`Transfers::timeout`], the oldest transfer is cancelled and handed over as far as it was filled. Only that one:
/// the others stay in flight, so the device always finds a transfer that takes its bytes. A timeout of zero
/// disables this; it suits a device that ends its transfers itself when it pauses.
pub struct UsbLink {
    opened: Arc<Opened>,
    ring: Ring,
    endpoint: u8,
    timeout: Duration,
    /// Number of transfers in flight.
    count: usize,
    /// The head's bytes are lent or used up; the head is submitted again at the next call.
    used: bool,
    /// When the head became the oldest transfer.
    head_since: Instant,
    /// The head was cancelled for hand-over.
    asked_back: bool,
    /// A loss to report before the next bytes.
    loss: Option<Loss>,
    /// The endpoint has halted: the transfers in flight come back first, then the halt is cleared.
    halted: bool,
    /// Consecutive halts without bytes in between.
    halts: usize,
    /// Consecutive failed transfers without bytes in between.
    failures: usize,
    /// No transfer is submitted any more: what has arrived is still lent, then this failure is returned.
    failed: Option<Failure>,
}

/// Why a stream has ended.
#[derive(Debug, Clone, Copy)]
enum Failure {
    /// An error of libusb.
    Usb(rusb::Error),
    Stalled,
    /// Too many transfers in a row failed on the wire.
    Wire,
    /// Too many transfers in a row overflowed.
    Overflow,
    /// Cancelled transfers do not come back.
    Stuck,
}

impl UsbLink {
    pub(super) fn new(opened: Arc<Opened>, transfers: &Transfers) -> Result<Self, LinkError> {
        let Transfers {
            endpoint,
            count,
            bytes,
            timeout,
            ..
        } = *transfers;
        let failed = |error| opened.error("transfers of its stream", error);
        let mut ring = Ring::new(Arc::clone(&opened), endpoint, count, bytes).map_err(failed)?;
        let count = ring.submit_all().map_err(failed)?;
        Ok(Self {
            opened,
            ring,
            endpoint,
            timeout,
            count,
            used: false,
            head_since: Instant::now(),
            asked_back: false,
            loss: None,
            halted: false,
            halts: 0,
            failures: 0,
            failed: None,
        })
    }

    /// Returns the number of transfers in flight: fewer than requested if the kernel has no memory for more.
    #[must_use]
    pub const fn in_flight(&self) -> usize {
        self.count
    }

    /// Releases the head if its bytes are no longer needed.
    fn next_head(&mut self) {
        if !std::mem::take(&mut self.used) {
            return;
        }
        let again = self.failed.is_none() && !self.halted;
        if let Err(error) = self.ring.release(again) {
            self.failed.get_or_insert(Failure::Usb(error));
            // What has arrived is kept, but nothing more will arrive.
            self.ring.cancel_all();
        }
        self.head_since = Instant::now();
        self.asked_back = false;
    }

    /// Updates the state by how the head ended.
    fn note(&mut self, completion: Completion) {
        self.used = true;
        if completion.length > 0 {
            (self.failures, self.halts) = (0, 0);
        }
        match completion.status {
            Status::Complete | Status::Cancelled => {}
            Status::Stalled if self.halted => {}
            Status::Stalled => {
                self.halted = true;
                self.halts += 1;
                self.ring.cancel_all();
                if self.halts > 1 {
                    self.failed.get_or_insert(Failure::Stalled);
                } else {
                    self.loss = Some(Loss::Stalled);
                }
            }
            Status::Overflow => {
                self.loss = Some(Loss::Overflow);
                self.fail_again(Failure::Overflow);
            }
            Status::Failed => {
                self.loss = Some(Loss::Damaged);
                self.fail_again(Failure::Wire);
            }
            Status::NoDevice => {
                self.failed
                    .get_or_insert(Failure::Usb(rusb::Error::NoDevice));
            }
        }
    }

    fn fail_again(&mut self, failure: Failure) {
        self.failures += 1;
        if self.failures > FAILURES_MAX {
            self.failed.get_or_insert(failure);
            self.ring.cancel_all();
        }
    }

    /// Returns the failure if there is one, else restarts the stream after a halt. Call it when the head is neither
    /// in flight nor has a result.
    fn begin_again(&mut self) -> Result<(), LinkError> {
        if let Some(failure) = self.failed {
            return Err(self.error(failure));
        }
        self.halted = false;
        let begun = self
            .opened
            .handle
            .clear_halt(self.endpoint)
            .and_then(|()| self.ring.submit_all());
        match begun {
            Ok(count) => {
                self.count = count;
                self.head_since = Instant::now();
                self.asked_back = false;
                Ok(())
            }
            Err(error) => {
                let failure = match error {
                    rusb::Error::Pipe | rusb::Error::Timeout => Failure::Stalled,
                    other => Failure::Usb(other),
                };
                self.failed = Some(failure);
                Err(self.error(failure))
            }
        }
    }

    fn error(&self, failure: Failure) -> LinkError {
        let link = self.opened.name.clone();
        match failure {
            Failure::Usb(error) => self.opened.error("transfers of its stream", error),
            Failure::Stalled => LinkError::Stalled {
                link,
                endpoint: self.endpoint,
            },
            // An unplugged cable fails like this until the hub has noticed.
            Failure::Wire => LinkError::Unplugged { link },
            Failure::Overflow => LinkError::Failed {
                link,
                cause: "keeps sending more than was requested: perhaps the transfers are not a \
                        multiple of its packet size"
                    .to_owned(),
            },
            Failure::Stuck => LinkError::Failed {
                link,
                cause: "its transfers do not complete; connect it again".to_owned(),
            },
        }
    }
}

impl Link for UsbLink {
    fn name(&self) -> &str {
        &self.opened.name
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let deadline = until(timeout);
        loop {
            self.next_head();
            if let Some(cause) = self.loss.take() {
                return Ok(Received::Lost { bytes: None, cause });
            }
            let hand_over = (!self.timeout.is_zero() && !self.asked_back)
                .then(|| self.head_since.checked_add(self.timeout))
                .flatten();
            // Cancelled transfers are awaited whatever the timeout: they come back soon.
            let ending = self.failed.is_some() || self.halted;
            let wait = if ending {
                Instant::now() + BACK
            } else {
                hand_over.map_or(deadline, |at| at.min(deadline))
            };
            match self.ring.wait(wait) {
                Some(completion) => {
                    self.note(completion);
                    if completion.length > 0 {
                        return Ok(Received::Bytes {
                            bytes: self.ring.bytes(completion.length),
                            at: completion.at,
                        });
                    }
                }
                None if self.ring.head_is_ours() => self.begin_again()?,
                None if ending => {
                    self.failed = Some(Failure::Stuck);
                    return Err(self.error(Failure::Stuck));
                }
                None => {
                    let now = Instant::now();
                    if hand_over.is_some_and(|at| at <= now) {
                        self.ring.cancel_head();
                        self.asked_back = true;
                    } else if deadline <= now {
                        return Ok(Received::Nothing);
                    }
                }
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        UsbOutlet::new(&self.opened)?.send(bytes)
    }

    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        Ok(Box::new(UsbOutlet::new(&self.opened)?))
    }
}
