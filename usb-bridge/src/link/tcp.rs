//! A stream over one TCP connection.

use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use super::{Link, LinkError, Received};

/// Bytes per read.
const BUFFER: usize = 256 * 1024;

/// A host that does not answer within this time cannot be reached.
const CONNECTING: Duration = Duration::from_secs(5);

/// A receiver that accepts no bytes for this long has stopped.
const PATIENCE: Duration = Duration::from_secs(5);

/// A link over one TCP connection.
pub struct TcpLink {
    stream: TcpStream,
    name: String,
    buffer: Vec<u8>,
    /// Read timeout currently set on the socket.
    timeout: Duration,
}

impl TcpLink {
    /// Connects to `host:port`, trying each address of the name in turn.
    ///
    /// # Errors
    /// The name is unknown, or nobody answers.
    pub fn connect(address: &str) -> Result<Self, LinkError> {
        let name = format!("tcp://{address}");
        let unreachable = |error: &io::Error| LinkError::Unreachable {
            link: name.clone(),
            cause: error.to_string(),
        };
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the host name has no address");
        for one in address.to_socket_addrs().map_err(|e| unreachable(&e))? {
            match TcpStream::connect_timeout(&one, CONNECTING) {
                Ok(stream) => return Self::new(stream, name),
                Err(error) => last = error,
            }
        }
        Err(unreachable(&last))
    }

    /// Accepts the next connection of a listener.
    ///
    /// # Errors
    /// The listener fails, or it is non-blocking and no connection is pending.
    pub fn accept(listener: &TcpListener) -> io::Result<Self> {
        let (stream, from) = listener.accept()?;
        stream.set_nonblocking(false)?;
        Self::new(stream, format!("tcp://{from}")).map_err(io::Error::other)
    }

    fn new(stream: TcpStream, name: String) -> Result<Self, LinkError> {
        let timeout = Duration::from_secs(1);
        stream
            .set_nodelay(true)
            .and_then(|()| stream.set_write_timeout(Some(PATIENCE)))
            .and_then(|()| stream.set_read_timeout(Some(timeout)))
            .map_err(|error| LinkError::Failed {
                link: name.clone(),
                cause: error.to_string(),
            })?;
        Ok(Self {
            stream,
            name,
            buffer: vec![0; BUFFER],
            timeout,
        })
    }

    fn failed(&self, error: &io::Error) -> LinkError {
        let link = self.name.clone();
        let cause = match error.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => {
                format!("has accepted no bytes for {} s", PATIENCE.as_secs())
            }
            _ => error.to_string(),
        };
        LinkError::Failed { link, cause }
    }
}

impl Link for TcpLink {
    fn name(&self) -> &str {
        &self.name
    }

    fn receive(&mut self, timeout: Duration) -> Result<Received<'_>, LinkError> {
        // The system takes zero as no timeout at all.
        let timeout = timeout.clamp(Duration::from_millis(1), Duration::from_secs(24 * 60 * 60));
        if timeout != self.timeout {
            let set = self.stream.set_read_timeout(Some(timeout));
            set.map_err(|error| self.failed(&error))?;
            self.timeout = timeout;
        }
        match self.stream.read(&mut self.buffer) {
            Ok(0) => Ok(Received::Ended),
            Ok(length) => Ok(Received::Bytes {
                bytes: &self.buffer[..length],
                at: Instant::now(),
            }),
            Err(error) => match error.kind() {
                io::ErrorKind::TimedOut
                | io::ErrorKind::WouldBlock
                | io::ErrorKind::Interrupted => Ok(Received::Nothing),
                _ => Err(self.failed(&error)),
            },
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.stream
            .write_all(bytes)
            .map_err(|error| self.failed(&error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_go_both_ways_and_the_end_is_told() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let mut near = TcpLink::connect(&address).unwrap();
        let mut far = TcpLink::accept(&listener).unwrap();
        assert_eq!(near.receive(Duration::ZERO).unwrap(), Received::Nothing);
        far.send(b"events").unwrap();
        drop(far);
        let mut got = Vec::new();
        loop {
            match near.receive(Duration::MAX).unwrap() {
                Received::Bytes { bytes, .. } => got.extend_from_slice(bytes),
                Received::Ended => break,
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(got, b"events");
    }

    #[test]
    fn an_address_without_anybody_is_told_in_one_line() {
        let free = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let told = TcpLink::connect(&free.to_string())
            .err()
            .unwrap()
            .to_string();
        assert!(
            told.starts_with(&format!("tcp://{free}: cannot be reached: ")),
            "{told}"
        );
        let told = TcpLink::connect("no port here").err().unwrap().to_string();
        assert!(told.contains("cannot be reached"), "{told}");
        assert!(!told.contains('\n'));
    }
}
