//! A link that waits for a sender: `tcp://`, `unix:` and `udp://` from the receiving side.

use std::io::{ErrorKind, Read};
use std::net::{TcpListener, ToSocketAddrs, UdpSocket};
use std::os::unix::net::UnixListener;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::{Link, LinkError, Loss, Received};
use crate::forward::address::Address;
use crate::forward::datagram::{DATAGRAM_BYTES_MAX, Joiner, Part};

/// Bytes read at a time.
const READ_BYTES: usize = 1 << 16;
/// Wait between two looks for a sender.
const LOOK: Duration = Duration::from_millis(10);

enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener, PathBuf),
    Udp(UdpSocket, Joiner),
}

/// A stream, whoever sends it; one sender at a time.
pub struct Listening {
    name: String,
    listener: Listener,
    sender: Option<Box<dyn Read + Send>>,
    senders: u64,
    buffer: Vec<u8>,
    late: u64,
    /// Of a datagram after a gap: its bytes, until the gap has been told.
    held: Option<usize>,
}

impl Listening {
    /// Waits at an address.
    ///
    /// # Errors
    /// The address is taken, is not one of this host, or cannot be waited at.
    pub fn open(address: &Address) -> Result<Self, LinkError> {
        let name = address.to_string();
        let unreachable = |cause: String| LinkError::Unreachable {
            link: name.clone(),
            cause,
        };
        let io = |error: std::io::Error| unreachable(error.to_string());
        let listener = match address {
            Address::Tcp(at) => {
                let listener = TcpListener::bind(at.as_str()).map_err(io)?;
                listener.set_nonblocking(true).map_err(io)?;
                Listener::Tcp(listener)
            }
            Address::Unix(path) => {
                let listener = UnixListener::bind(path).map_err(io)?;
                listener.set_nonblocking(true).map_err(io)?;
                Listener::Unix(listener, path.clone())
            }
            Address::Udp(at) => {
                let at = at
                    .to_socket_addrs()
                    .map_err(io)?
                    .next()
                    .ok_or_else(|| unreachable("the name has no address".to_owned()))?;
                let socket = UdpSocket::bind(at).map_err(io)?;
                Listener::Udp(socket, Joiner::default())
            }
            Address::File(_) | Address::Stdout => {
                return Err(unreachable(
                    "nobody sends there: use tcp://, udp:// or unix:".to_owned(),
                ));
            }
        };
        Ok(Self {
            name,
            listener,
            sender: None,
            senders: 0,
            buffer: vec![0; READ_BYTES],
            late: 0,
            held: None,
        })
    }

    /// Where it waits: the port that the system chose, where 0 was asked for.
    #[must_use]
    pub fn local_port(&self) -> Option<u16> {
        match &self.listener {
            Listener::Tcp(listener) => listener.local_addr().ok(),
            Listener::Udp(socket, _) => socket.local_addr().ok(),
            Listener::Unix(..) => None,
        }
        .map(|address| address.port())
    }

    /// Datagrams that came twice, late, or from elsewhere, and were left out.
    #[must_use]
    pub const fn late(&self) -> u64 {
        self.late
    }

    fn failed(&self, error: &std::io::Error) -> LinkError {
        LinkError::Failed {
            link: self.name.clone(),
            cause: error.to_string(),
        }
    }

    /// A sender's connection, where one is waiting.
    fn accept(&mut self) -> std::io::Result<Option<Box<dyn Read + Send>>> {
        let timeout = Some(Duration::from_millis(20));
        let accepted: std::io::Result<Box<dyn Read + Send>> = match &self.listener {
            Listener::Tcp(listener) => listener.accept().and_then(|(stream, _)| {
                stream.set_nonblocking(false)?;
                stream.set_read_timeout(timeout)?;
                Ok(Box::new(stream) as Box<dyn Read + Send>)
            }),
            Listener::Unix(listener, _) => listener.accept().and_then(|(stream, _)| {
                stream.set_nonblocking(false)?;
                stream.set_read_timeout(timeout)?;
                Ok(Box::new(stream) as Box<dyn Read + Send>)
            }),
            Listener::Udp(..) => return Ok(None),
        };
        match accepted {
            Ok(sender) => Ok(Some(sender)),
            Err(error) if is_pause(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn receive_datagram(&mut self, until: Instant) -> Result<Received<'_>, LinkError> {
        if let Some(length) = self.held.take() {
            return Ok(bytes(&self.buffer[..length]));
        }
        let Listener::Udp(socket, joiner) = &mut self.listener else {
            return Ok(Received::Nothing);
        };
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let met = socket
                .set_read_timeout(Some(left.max(Duration::from_millis(1))))
                .and_then(|()| socket.recv(&mut self.buffer[..DATAGRAM_BYTES_MAX + 1]));
            let length = match met {
                Ok(length) => length,
                Err(error) if is_pause(&error) => return Ok(Received::Nothing),
                Err(error) => {
                    return Err(LinkError::Failed {
                        link: self.name.clone(),
                        cause: error.to_string(),
                    });
                }
            };
            let (is_gap, part_bytes) = match joiner.join(&self.buffer[..length]) {
                Part::Next(part) => (false, part.len()),
                Part::AfterLoss(_, part) => (true, part.len()),
                Part::Anew(part) => {
                    self.senders += 1;
                    (self.senders > 1, part.len())
                }
                Part::Late | Part::Strange => {
                    self.late += 1;
                    continue;
                }
            };
            self.buffer.copy_within(length - part_bytes..length, 0);
            if is_gap {
                self.held = Some(part_bytes);
                return Ok(Received::Lost {
                    bytes: None,
                    cause: Loss::Damaged,
                });
            }
            return Ok(bytes(&self.buffer[..part_bytes]));
        }
    }
}

fn bytes(bytes: &[u8]) -> Received<'_> {
    Received::Bytes {
        bytes,
        at: Instant::now(),
    }
}

/// Whether nothing came, but might soon.
fn is_pause(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

impl Link for Listening {
    fn name(&self) -> &str {
        &self.name
    }

    /// A sender that goes is not the end: the next one is waited for, and a loss told between them.
    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        let until = Instant::now() + timeout;
        if matches!(self.listener, Listener::Udp(..)) {
            return self.receive_datagram(until);
        }
        loop {
            let Some(sender) = &mut self.sender else {
                match self.accept() {
                    Ok(Some(sender)) => {
                        self.sender = Some(sender);
                        self.senders += 1;
                        if self.senders > 1 {
                            return Ok(Received::Lost {
                                bytes: None,
                                cause: Loss::Damaged,
                            });
                        }
                    }
                    Ok(None) if Instant::now() >= until => return Ok(Received::Nothing),
                    Ok(None) => std::thread::sleep(LOOK),
                    Err(error) => return Err(self.failed(&error)),
                }
                continue;
            };
            match sender.read(&mut self.buffer) {
                Ok(0) => self.sender = None,
                Ok(length) => return Ok(bytes(&self.buffer[..length])),
                Err(error) if is_pause(&error) => {
                    if Instant::now() >= until {
                        return Ok(Received::Nothing);
                    }
                }
                // As if it had gone.
                Err(_) => self.sender = None,
            }
        }
    }

    fn send(&mut self, _: &[u8]) -> Result<(), LinkError> {
        Err(LinkError::Failed {
            link: self.name.clone(),
            cause: "only receives".to_owned(),
        })
    }
}

impl Listening {
    /// Whether somebody is sending now; of datagrams, whether any came.
    #[must_use]
    pub const fn has_sender(&self) -> bool {
        match self.listener {
            Listener::Udp(..) => self.senders > 0,
            Listener::Tcp(_) | Listener::Unix(..) => self.sender.is_some(),
        }
    }

    /// Senders so far.
    #[must_use]
    pub const fn senders(&self) -> u64 {
        self.senders
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        if let Listener::Unix(_, path) = &self.listener {
            // The name would stay and be taken the next time.
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forward::fan_out::FanOut;

    fn all(link: &mut Listening, at_least: usize) -> (Vec<u8>, usize) {
        let (mut met, mut losses) = (Vec::new(), 0);
        let until = Instant::now() + Duration::from_secs(20);
        while met.len() < at_least && Instant::now() < until {
            match link.receive(Duration::from_millis(50)).unwrap() {
                Received::Bytes { bytes, .. } => met.extend_from_slice(bytes),
                Received::Lost { .. } => losses += 1,
                Received::Nothing | Received::Ended => {}
            }
        }
        (met, losses)
    }

    #[test]
    fn what_is_sent_arrives_over_every_kind_and_from_one_sender_after_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        for kind in ["tcp", "udp", "unix"] {
            let address = match kind {
                "unix" => Address::Unix(path.clone()),
                "tcp" => Address::Tcp("127.0.0.1:0".to_owned()),
                _ => Address::Udp("127.0.0.1:0".to_owned()),
            };
            let mut link = Listening::open(&address).unwrap();
            let to = match (kind, link.local_port()) {
                ("tcp", Some(port)) => Address::Tcp(format!("127.0.0.1:{port}")),
                ("udp", Some(port)) => Address::Udp(format!("127.0.0.1:{port}")),
                _ => address,
            };
            for round in 0..2 {
                let mut fan_out = FanOut::start(std::slice::from_ref(&to), 1 << 20).unwrap();
                let message: Vec<u8> = (0..30_000_u32).map(|i| ((i * i) >> 3) as u8).collect();
                fan_out.give(&message, 0);
                let (met, losses) = all(&mut link, message.len());
                assert!(met == message, "{kind}, {} bytes", met.len());
                assert_eq!(losses, round, "{kind}");
                let reports = fan_out.finish(Duration::from_secs(5));
                assert_eq!(reports[0].lost.messages, 0, "{kind}");
            }
        }
        assert!(!path.exists());
    }
}
