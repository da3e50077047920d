//! One host at the other end of a socket: moves bytes in and out of a [`Session`], with bounded memory.
//!
//! One thread serves a host. It reads while the session can take bytes, stops reading while the host does not take
//! its answers, and polls the device in short steps while transfers wait.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
#[cfg(unix)]
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use super::Peripheral;
use super::attached::Traffic;

/// Most bytes that wait for the host; beyond that, nothing more is answered until it reads.
pub const OUTPUT_MAX: usize = 1 << 20;

/// Bytes per read.
const READ_BYTES: usize = 1 << 16;
/// Longest pause between two polls of a device that has no data.
const PAUSE_MAX: Duration = Duration::from_millis(1);
/// Shortest pause between two polls of a device that has no data.
const PAUSE_MIN: Duration = Duration::from_micros(100);
/// Longest wait of a read while only the host can cause anything.
const QUIET: Duration = Duration::from_millis(20);
/// Time at the end within which the remaining bytes are written to the host.
const FLUSH: Duration = Duration::from_secs(1);

/// A change of the cable.
pub enum Change {
    /// A device is plugged in, replacing the current one.
    Plug(Box<dyn Peripheral>),
    /// The device is unplugged.
    Unplug,
    /// The device is unplugged for good, and serving ends.
    End,
}

/// A protocol that carries a device's requests and transfers; it does no I/O itself.
pub trait Session {
    /// Takes bytes from the host.
    fn receive(&mut self, bytes: &[u8]);

    /// Answers one packet or ends one transfer; returns `false` if there is nothing to do now.
    ///
    /// # Errors
    /// The host breaks the protocol such that packet boundaries are lost.
    fn step(&mut self) -> Result<bool>;

    /// Returns the bytes for the host; the caller removes from the front what it has written.
    fn output(&mut self) -> &mut Vec<u8>;

    /// Returns whether transfers wait for the device.
    fn waits(&self) -> bool;

    /// Handles a change of the cable; returns `false` if the session ends once its output is written.
    fn change(&mut self, change: Change) -> bool;

    /// Returns the counts of what was carried and of packets that were not understood.
    fn report(&self) -> Report;
}

/// Counts of a session.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Report {
    /// Requests and transfers.
    pub traffic: Traffic,
    /// Packets that were not understood or came at the wrong time, and were skipped.
    pub packets_odd: u64,
    /// Whether the host refused the device.
    pub is_rejected: bool,
}

impl Traffic {
    /// Adds the counts of another device.
    pub(super) fn add(&mut self, other: Self) {
        self.requests += other.requests;
        self.requests_refused += other.requests_refused;
        self.transfers_in += other.transfers_in;
        self.bytes_in += other.bytes_in;
        self.transfers_out += other.transfers_out;
        self.bytes_out += other.bytes_out;
        self.stalled += other.stalled;
        self.cancelled += other.cancelled;
        self.refused += other.refused;
        self.bytes_overflown += other.bytes_overflown;
    }
}

/// A socket that can be polled without waiting.
pub trait Socket: Read + Write {
    /// Sets whether a read waits, for at most 20 ms, or reads and writes return at once.
    ///
    /// # Errors
    /// The system refuses.
    fn set_waiting(&self, waits: bool) -> io::Result<()>;
}

#[cfg(unix)]
impl Socket for UnixStream {
    fn set_waiting(&self, waits: bool) -> io::Result<()> {
        self.set_read_timeout(Some(QUIET))?;
        self.set_nonblocking(!waits)
    }
}

impl Socket for TcpStream {
    fn set_waiting(&self, waits: bool) -> io::Result<()> {
        self.set_read_timeout(Some(QUIET))?;
        self.set_nonblocking(!waits)
    }
}

/// Result of a read or a write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Moved {
    /// Bytes were moved.
    Bytes,
    /// No bytes could be moved.
    Nothing,
    /// The host has closed its end.
    Closed,
}

/// Serves a host until it leaves or the cable is unplugged for good; `changes` is called in between.
///
/// # Errors
/// The host breaks the protocol, or the system refuses the socket.
pub fn serve(
    socket: &mut impl Socket,
    session: &mut dyn Session,
    changes: &mut dyn FnMut() -> Option<Change>,
) -> Result<Report> {
    let mut bytes = vec![0; READ_BYTES];
    let mut pause = PAUSE_MIN;
    let mut waiting = None;
    loop {
        let mut is_busy = false;
        if let Some(change) = changes() {
            is_busy = true;
            if !session.change(change) {
                flush(socket, session.output())?;
                return Ok(session.report());
            }
        }
        let mut has_more = true;
        while has_more && session.output().len() < OUTPUT_MAX {
            has_more = session.step()?;
            is_busy |= has_more;
        }
        // A read may wait only while nothing but the host can cause anything.
        let waits = !is_busy && !session.waits() && session.output().is_empty();
        if waiting != Some(waits) {
            socket.set_waiting(waits).context("socket")?;
            waiting = Some(waits);
        }
        match write(socket, session.output())? {
            Moved::Bytes => is_busy = true,
            Moved::Nothing => {}
            Moved::Closed => return Ok(session.report()),
        }
        // While packets wait for room in the output, more would only fill memory.
        if !has_more {
            match read(socket, &mut bytes)? {
                (Moved::Bytes, length) => {
                    session.receive(&bytes[..length]);
                    is_busy = true;
                }
                (Moved::Nothing, _) => {}
                (Moved::Closed, _) => return Ok(session.report()),
            }
        }
        if is_busy {
            pause = PAUSE_MIN;
        } else if !waits {
            std::thread::sleep(pause);
            pause = (pause * 2).min(PAUSE_MAX);
        }
    }
}

/// Writes as much as the socket accepts now.
fn write(socket: &mut impl Write, output: &mut Vec<u8>) -> Result<Moved> {
    if output.is_empty() {
        return Ok(Moved::Nothing);
    }
    match socket.write(output) {
        Ok(0) => Ok(Moved::Closed),
        Ok(length) => {
            output.drain(..length);
            Ok(Moved::Bytes)
        }
        Err(error) if is_later(&error) => Ok(Moved::Nothing),
        Err(error) if is_closed(&error) => Ok(Moved::Closed),
        Err(error) => Err(error).context("socket: cannot be written"),
    }
}

fn read(socket: &mut impl Read, bytes: &mut [u8]) -> Result<(Moved, usize)> {
    match socket.read(bytes) {
        Ok(0) => Ok((Moved::Closed, 0)),
        Ok(length) => Ok((Moved::Bytes, length)),
        Err(error) if is_later(&error) => Ok((Moved::Nothing, 0)),
        Err(error) if is_closed(&error) => Ok((Moved::Closed, 0)),
        Err(error) => Err(error).context("socket: cannot be read"),
    }
}

/// Writes the rest, as far as the host accepts it in time.
fn flush(socket: &mut impl Socket, output: &mut Vec<u8>) -> Result<()> {
    let until = Instant::now() + FLUSH;
    socket.set_waiting(false).context("socket")?;
    while !output.is_empty() && Instant::now() < until {
        match write(socket, output)? {
            Moved::Bytes => {}
            Moved::Nothing => std::thread::sleep(PAUSE_MAX),
            Moved::Closed => break,
        }
    }
    Ok(())
}

fn is_later(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

fn is_closed(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::ConnectionReset | ErrorKind::ConnectionAborted | ErrorKind::BrokenPipe
    )
}

/// Bytes from a host that have not been answered yet.
#[derive(Debug, Default)]
pub(super) struct Input {
    bytes: Vec<u8>,
    taken: usize,
}

impl Input {
    /// Appends bytes from the host.
    pub fn append(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.taken);
        self.taken = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// Returns the bytes that have not been taken.
    pub fn rest(&self) -> &[u8] {
        &self.bytes[self.taken..]
    }

    /// Takes the next `length` bytes; `None` if they have not all arrived.
    pub fn take(&mut self, length: usize) -> Option<&[u8]> {
        let end = self.taken.checked_add(length)?;
        let bytes = self.bytes.get(self.taken..end)?;
        self.taken = end;
        Some(bytes)
    }
}
