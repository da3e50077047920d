//! Whose messages are received: of all that connect or send datagrams, one at a time is the *sender*.
//!
//! Anybody may connect, or send datagrams, and say nothing, or anything. Each of them is a *candidate* with a buffer
//! of its own: a connection, or a stream of datagrams from one address. The first candidate from which a whole message
//! of use comes is the sender, and gets everything delivered that has come from it. Candidates are bounded in number,
//! in bytes and in time ([`Deadlines`]).
//!
//! While there is a sender, other connections are closed and counted, and other datagrams are dropped and counted. A
//! sender from which no whole message has come for [`Deadlines::idle`] keeps its place only until a candidate has sent
//! one.

mod connections;
mod datagrams;

use std::time::Duration;

use super::address::Address;
use super::demux::{Demux, MESSAGE_BYTES_MAX, Message};
use crate::link::LinkError;
use crate::stop::Stop;
use connections::Connections;
use datagrams::Datagrams;
pub use datagrams::{DATAGRAMS_BYTES, DatagramAccount};

/// Most bytes that all candidates hold together; beyond it, the one that holds most is dropped.
pub const CANDIDATES_BYTES_MAX: usize = 4 * MESSAGE_BYTES_MAX;
/// Most bytes that a candidate may send before its first whole message of use.
const CANDIDATE_BYTES_MAX: u64 = 2 * MESSAGE_BYTES_MAX as u64;

/// How long each part of a stream may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deadlines {
    /// From a connection to its first byte.
    pub first_byte: Duration,
    /// From a candidate's first byte to the end of its first whole message of use.
    pub first_message: Duration,
    /// From a message of the sender to its next one, after which another may take its place. `None`:
    /// [`Deadlines::IDLE_CONNECTION`] or [`Deadlines::IDLE_DATAGRAMS`].
    pub idle: Option<Duration>,
}

impl Deadlines {
    /// Default of [`Deadlines::idle`] for a connection, whose end is known unless its host was switched off.
    pub const IDLE_CONNECTION: Duration = Duration::from_secs(10);
    /// Default of [`Deadlines::idle`] for datagrams, of which nobody knows the end where the sender was killed.
    pub const IDLE_DATAGRAMS: Duration = Duration::from_secs(1);
}

/// Decides who can be the sender.
pub trait Judge {
    /// Returns whether a message of a candidate is of use; one that is not is left out.
    fn is_of_use(&mut self, message: &Message<'_>) -> bool;

    /// Takes a line about somebody who was refused.
    fn tell(&mut self, line: &str);
}

/// A message of the sender.
#[derive(Debug, Clone, Copy)]
pub struct Found<'m> {
    /// The message.
    pub message: Message<'m>,
    /// All of its bytes.
    pub bytes: &'m [u8],
    /// Number of its sender, from 1.
    pub sender: u64,
}

/// Counts of senders, and of what came from others.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of senders, one after the other.
    pub senders: u64,
    /// Connections that were closed, by whatever end, without a message of use.
    pub alien_connections: u64,
    /// Connections that were closed because there was a sender.
    pub refused_connections: u64,
    /// Datagrams that are not of the sender.
    pub alien_datagrams: u64,
    /// Bytes of alien and refused connections, as far as they were read, and of alien datagrams.
    pub alien_bytes: u64,
    /// Bytes of senders that belong to no whole message.
    pub damaged_bytes: u64,
}

/// The sender, and all candidates.
pub struct Senders {
    name: String,
    kind: Kind,
}

enum Kind {
    Connections(Box<Connections>),
    Datagrams(Box<Datagrams>),
}

impl Senders {
    /// Listens at an address; a name is looked up until `stop` is asked.
    ///
    /// # Errors
    /// The address is in use, does not belong to this host, or cannot be listened at (a file or stdout).
    pub fn open(address: &Address, deadlines: Deadlines, stop: &Stop) -> Result<Self, LinkError> {
        let name = address.to_string();
        let connections = |opened| Kind::Connections(Box::new(opened));
        let opened = match address {
            Address::Tcp(at) => Connections::tcp(at, deadlines, stop).map(connections),
            Address::Unix(path) => Connections::unix(path, deadlines).map(connections),
            Address::Udp(at) => {
                let datagrams = Datagrams::open(at, deadlines, stop);
                datagrams.map(|datagrams| Kind::Datagrams(Box::new(datagrams)))
            }
            Address::File(_) | Address::Stdout => Err(std::io::Error::other(
                "nothing can be received there: use tcp://, udp:// or unix:",
            )),
        };
        match opened {
            Ok(kind) => Ok(Self { name, kind }),
            Err(error) => Err(LinkError::Unreachable {
                link: name,
                cause: error.to_string(),
            }),
        }
    }

    /// Returns the next message of the sender, or of a candidate that becomes the sender by it; `None` if none came
    /// within `timeout`, or a connection that was the sender has gone. The next one follows a sender that ends.
    ///
    /// # Errors
    /// The system fails to receive.
    pub fn next(
        &mut self,
        timeout: Duration,
        judge: &mut dyn Judge,
    ) -> Result<Option<Found<'_>>, LinkError> {
        match &mut self.kind {
            Kind::Connections(connections) => Ok(connections.next(timeout, judge)),
            Kind::Datagrams(datagrams) => {
                datagrams
                    .next(timeout, judge)
                    .map_err(|error| LinkError::Failed {
                        link: self.name.clone(),
                        cause: error.to_string(),
                    })
            }
        }
    }

    /// Returns whether there is a sender now; over UDP, whether its stream has not ended.
    #[must_use]
    pub const fn has_sender(&self) -> bool {
        match &self.kind {
            Kind::Connections(connections) => connections.has_sender(),
            Kind::Datagrams(datagrams) => datagrams.has_sender(),
        }
    }

    /// Ends receiving on request: returns the bytes that have come of the sender's next message, which is then not
    /// counted as lost or damaged.
    pub fn forgive(&mut self) -> u64 {
        match &mut self.kind {
            Kind::Connections(connections) => connections.unfinished_bytes(),
            Kind::Datagrams(datagrams) => datagrams.forgive(),
        }
    }

    /// Returns the counts so far; candidates count as aliens.
    #[must_use]
    pub fn tally(&self) -> Tally {
        match &self.kind {
            Kind::Connections(connections) => connections.tally(),
            Kind::Datagrams(datagrams) => datagrams.tally(),
        }
    }

    /// Returns the counts of datagrams; `None` unless this listens on UDP.
    #[must_use]
    pub fn datagrams(&self) -> Option<DatagramAccount> {
        match &self.kind {
            Kind::Connections(_) => None,
            Kind::Datagrams(datagrams) => Some(datagrams.account()),
        }
    }

    /// Returns the local port, also if the system chose it because port 0 was requested; `None` for a Unix socket.
    #[must_use]
    pub fn local_port(&self) -> Option<u16> {
        match &self.kind {
            Kind::Connections(connections) => connections.local_port(),
            Kind::Datagrams(datagrams) => datagrams.local_port(),
        }
    }
}

/// Returns whether a message of use is next; whole messages before it, which are of no use, are used up.
fn is_of_use(demux: &mut Demux, judge: &mut dyn Judge) -> bool {
    while let Some(message) = demux.peek() {
        if judge.is_of_use(&message) {
            return true;
        }
        demux.next_message();
    }
    false
}

/// Returns whether the error only means that nothing has arrived yet.
fn is_pause(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), WouldBlock | TimedOut | Interrupted)
}

/// Removes the candidate that holds most bytes if all hold too many together.
fn drop_largest<C>(candidates: &mut Vec<C>, held: impl Fn(&C) -> usize) -> Option<C> {
    if candidates.iter().map(&held).sum::<usize>() <= CANDIDATES_BYTES_MAX {
        return None;
    }
    let largest = candidates.iter().enumerate();
    let (at, _) = largest.max_by_key(|(_, one)| held(one))?;
    Some(candidates.remove(at))
}

#[cfg(test)]
mod tests;
