//! Links inside the process: a pair of connected ends, and a simulated device without a bus.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::control::{Control, Request};
use super::{Link, LinkError, Loss, Outlet, Received, until};
use crate::device::Transfers;
use crate::peripheral::{Bulk, Peripheral, Reply};

/// A receiver that accepts no bytes for this long has stopped.
const PATIENCE: Duration = Duration::from_secs(5);

/// Bytes per transfer to a simulated device.
const TRANSFER: usize = 4096;

/// Period at which a device with nothing to send is asked again.
const POLL: Duration = Duration::from_micros(200);

/// Buffers that one direction keeps for reuse.
const SPARE_MAX: usize = 8;

/// Locks a mutex even if another thread panicked while holding it.
fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One direction between two ends.
#[derive(Debug)]
struct Pipe {
    state: Mutex<PipeState>,
    changed: Condvar,
    room: usize,
}

#[derive(Debug, Default)]
struct PipeState {
    pieces: VecDeque<(Vec<u8>, Instant)>,
    /// Buffers of pieces that were read, for reuse.
    spare: Vec<Vec<u8>>,
    bytes: usize,
    closed: bool,
}

/// One end of a [`pair`].
#[derive(Debug)]
pub struct LoopbackLink {
    name: String,
    out: Arc<Pipe>,
    into: Arc<Pipe>,
    /// The piece that the last receive returned.
    lent: Vec<u8>,
    patience: Duration,
}

/// Creates two connected ends: what is sent at one is received at the other. Each direction holds at most `room`
/// bytes (at least 1), and a sender waits for room. Bytes are copied once; the receiver borrows that copy.
#[must_use]
pub fn pair(room: usize) -> (LoopbackLink, LoopbackLink) {
    let pipe = || {
        Arc::new(Pipe {
            state: Mutex::default(),
            changed: Condvar::new(),
            room: room.max(1),
        })
    };
    let (there, back) = (pipe(), pipe());
    let end = |name: &str, out: &Arc<Pipe>, into: &Arc<Pipe>| LoopbackLink {
        name: name.to_owned(),
        out: Arc::clone(out),
        into: Arc::clone(into),
        lent: Vec::new(),
        patience: PATIENCE,
    };
    (
        end("near end", &there, &back),
        end("far end", &back, &there),
    )
}

impl LoopbackLink {
    /// Sets how long a sender waits for room before it takes the reader as stopped; the default is 5 s.
    pub const fn set_patience(&mut self, patience: Duration) {
        self.patience = patience;
    }

    fn failed(&self, cause: String) -> LinkError {
        LinkError::Failed {
            link: self.name.clone(),
            cause,
        }
    }
}

impl Link for LoopbackLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let deadline = until(timeout);
        let mut state = lock(&self.into.state);
        loop {
            if let Some((piece, at)) = state.pieces.pop_front() {
                state.bytes -= piece.len();
                let read = std::mem::replace(&mut self.lent, piece);
                if state.spare.len() < SPARE_MAX {
                    state.spare.push(read);
                }
                drop(state);
                self.into.changed.notify_one();
                return Ok(Received::Bytes {
                    bytes: &self.lent,
                    at,
                });
            }
            if state.closed {
                return Ok(Received::Ended);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(Received::Nothing);
            }
            let waited = self.into.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for part in bytes.chunks(self.out.room) {
            let mut state = lock(&self.out.state);
            let deadline = until(self.patience);
            loop {
                if state.closed {
                    return Err(self.failed("the other end is closed".to_owned()));
                }
                if state.bytes + part.len() <= self.out.room {
                    break;
                }
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    let waited = self.patience.as_secs_f64();
                    return Err(self.failed(format!("has accepted no bytes for {waited} s")));
                }
                let waited = self.out.changed.wait_timeout(state, left);
                state = waited.unwrap_or_else(PoisonError::into_inner).0;
            }
            let mut piece = state.spare.pop().unwrap_or_default();
            piece.clear();
            piece.extend_from_slice(part);
            state.bytes += part.len();
            state.pieces.push_back((piece, Instant::now()));
            drop(state);
            self.out.changed.notify_one();
        }
        Ok(())
    }
}

impl Drop for LoopbackLink {
    fn drop(&mut self) {
        for pipe in [&self.out, &self.into] {
            lock(&pipe.state).closed = true;
            pipe.changed.notify_all();
        }
    }
}

/// A simulated device attached inside the process.
#[derive(Clone)]
pub struct Attachment {
    shared: Arc<Mutex<Attached>>,
    name: String,
    release: u16,
    serial: Option<String>,
}

struct Attached {
    /// `None` after the device was unplugged.
    peripheral: Option<Box<dyn Peripheral>>,
}

impl Attachment {
    /// Attaches a device and configures it as a host would.
    #[must_use]
    pub fn new(name: &str, mut peripheral: Box<dyn Peripheral>) -> Self {
        peripheral.reset();
        let descriptors = peripheral.descriptors();
        let field = |at: usize| descriptors.device.get(at).copied().unwrap_or(0);
        let serial = usize::from(field(16)).checked_sub(1);
        Self {
            name: format!("simulated {name}"),
            release: u16::from_le_bytes([field(12), field(13)]),
            serial: serial.and_then(|index| descriptors.strings.get(index).cloned()),
            shared: Arc::new(Mutex::new(Attached {
                peripheral: Some(peripheral),
            })),
        }
    }

    /// Returns the control side of the device.
    #[must_use]
    pub fn control(&self) -> PeripheralControl {
        PeripheralControl {
            attachment: self.clone(),
        }
    }

    /// Returns the stream of the device, read with transfers of the given size.
    #[must_use]
    pub fn stream(&self, transfers: &Transfers) -> PeripheralLink {
        PeripheralLink {
            attachment: self.clone(),
            endpoint: transfers.endpoint,
            room: transfers.bytes,
            buffer: Vec::with_capacity(transfers.bytes),
            halts: 0,
        }
    }

    /// Removes the device, like pulling its cable.
    pub fn unplug(&self) {
        lock(&self.shared).peripheral = None;
    }

    fn unplugged(&self) -> LinkError {
        LinkError::Unplugged {
            link: self.name.clone(),
        }
    }

    fn refused(&self, step: &str) -> LinkError {
        LinkError::Failed {
            link: self.name.clone(),
            cause: format!("{step}: the device refused it"),
        }
    }

    fn ask<T>(&self, question: impl FnOnce(&mut dyn Peripheral) -> T) -> Result<T, LinkError> {
        let mut attached = lock(&self.shared);
        let peripheral = attached.peripheral.as_mut();
        Ok(question(&mut **peripheral.ok_or_else(|| self.unplugged())?))
    }
}

/// The stream of an [`Attachment`], one transfer at a time.
pub struct PeripheralLink {
    attachment: Attachment,
    endpoint: u8,
    room: usize,
    buffer: Vec<u8>,
    /// Consecutive halts without bytes in between.
    halts: usize,
}

impl Link for PeripheralLink {
    fn name(&self) -> &str {
        &self.attachment.name
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let deadline = until(timeout);
        loop {
            self.buffer.clear();
            let Self {
                buffer,
                endpoint,
                room,
                ..
            } = self;
            let bulk = self
                .attachment
                .ask(|device| device.bulk_in(*endpoint, *room, buffer))?;
            if self.buffer.len() > self.room {
                return Ok(Received::Lost {
                    bytes: Some(self.buffer.len() as u64),
                    cause: Loss::Overflow,
                });
            }
            match bulk {
                Bulk::Data if !self.buffer.is_empty() => {
                    self.halts = 0;
                    return Ok(Received::Bytes {
                        bytes: &self.buffer,
                        at: Instant::now(),
                    });
                }
                Bulk::Data | Bulk::Wait => {}
                Bulk::Stall => {
                    self.halts += 1;
                    if self.halts > 1 {
                        return Err(LinkError::Stalled {
                            link: self.attachment.name.clone(),
                            endpoint: self.endpoint,
                        });
                    }
                    self.attachment
                        .ask(|device| device.clear_halt(self.endpoint))?;
                    return Ok(Received::Lost {
                        bytes: None,
                        cause: Loss::Stalled,
                    });
                }
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(Received::Nothing);
            }
            if bulk == Bulk::Wait {
                thread::sleep(left.min(POLL));
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.outlet()?.send(bytes)
    }

    fn outlet(&self) -> Result<Box<dyn Outlet>, LinkError> {
        Ok(Box::new(PeripheralOutlet {
            attachment: self.attachment.clone(),
            endpoint: self.endpoint & 0x7F,
        }))
    }
}

/// The sending side of an [`Attachment`]: the OUT endpoint with the stream's endpoint number.
struct PeripheralOutlet {
    attachment: Attachment,
    endpoint: u8,
}

impl Outlet for PeripheralOutlet {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let endpoint = self.endpoint;
        for piece in bytes.chunks(TRANSFER) {
            let deadline = until(PATIENCE);
            let taken = loop {
                let taken = self.attachment.ask(|device| {
                    let is_ready = device.is_ready(endpoint);
                    is_ready.then(|| device.bulk_out(endpoint, piece))
                })?;
                if let Some(taken) = taken {
                    break taken;
                }
                if Instant::now() >= deadline {
                    return Err(LinkError::Failed {
                        link: self.attachment.name.clone(),
                        cause: format!("has accepted no bytes for {} s", PATIENCE.as_secs()),
                    });
                }
                thread::sleep(POLL);
            };
            if !taken {
                return Err(LinkError::Stalled {
                    link: self.attachment.name.clone(),
                    endpoint,
                });
            }
        }
        Ok(())
    }
}

/// The control side of an [`Attachment`]. It skips the waits that a real device requires.
#[derive(Clone)]
pub struct PeripheralControl {
    attachment: Attachment,
}

impl PeripheralControl {
    fn request(&self, request: Request, data: &[u8], length: usize) -> Result<Vec<u8>, LinkError> {
        match self
            .attachment
            .ask(|device| device.control(request, data, length))?
        {
            Reply::Data(data) => Ok(data),
            Reply::Stall => Err(self
                .attachment
                .refused(&format!("request {:#04x}", request.request))),
        }
    }
}

impl Control for PeripheralControl {
    fn control_out(&mut self, request: Request, data: &[u8]) -> Result<(), LinkError> {
        self.request(request, data, data.len()).map(drop)
    }

    fn control_in(&mut self, request: Request, data: &mut [u8]) -> Result<usize, LinkError> {
        let answer = self.request(request, &[], data.len())?;
        let length = answer.len().min(data.len());
        data[..length].copy_from_slice(&answer[..length]);
        Ok(length)
    }

    fn bulk_out(&mut self, endpoint: u8, data: &[u8]) -> Result<(), LinkError> {
        let taken = self
            .attachment
            .ask(|device| device.bulk_out(endpoint, data))?;
        if taken {
            Ok(())
        } else {
            Err(self.attachment.refused("a command"))
        }
    }

    fn bulk_in(&mut self, endpoint: u8, data: &mut [u8]) -> Result<usize, LinkError> {
        let deadline = until(Duration::from_secs(1));
        let mut answer = Vec::with_capacity(data.len());
        loop {
            let bulk = self
                .attachment
                .ask(|device| device.bulk_in(endpoint, data.len(), &mut answer))?;
            match bulk {
                Bulk::Data => {
                    let length = answer.len().min(data.len());
                    data[..length].copy_from_slice(&answer[..length]);
                    return Ok(length);
                }
                Bulk::Stall => return Err(self.attachment.refused("a command")),
                Bulk::Wait if Instant::now() >= deadline => {
                    return Err(LinkError::Failed {
                        link: self.attachment.name.clone(),
                        cause: "does not answer a command".to_owned(),
                    });
                }
                Bulk::Wait => thread::sleep(POLL),
            }
        }
    }

    fn clear_halt(&mut self, endpoint: u8) -> Result<(), LinkError> {
        self.attachment.ask(|device| device.clear_halt(endpoint))
    }

    fn wait(&mut self, _duration: Duration) {}

    fn release(&self) -> u16 {
        self.attachment.release
    }

    fn serial(&mut self) -> Option<String> {
        self.attachment.serial.clone()
    }

    fn name(&self) -> &str {
        &self.attachment.name
    }
}

#[cfg(test)]
#[path = "loopback_tests.rs"]
mod tests;
