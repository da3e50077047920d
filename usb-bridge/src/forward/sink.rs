//! Where a consumer's messages go.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::os::unix::net::UnixStream;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use event_files::output::create_bytes;

use super::address::Address;
use super::datagram::Cutter;

/// How long a connection may take to come about.
const CONNECT: Duration = Duration::from_secs(3);
/// How long a write waits before it is asked whether it may go on.
const WAIT: Duration = Duration::from_millis(100);
/// Datagrams that say the end: one that is lost is not the only one.
const ENDS: usize = 3;

/// An open way to a consumer.
#[derive(Debug)]
pub enum Sink {
    /// A TCP connection.
    Tcp(TcpStream),
    /// Datagrams.
    Udp(UdpSocket, Cutter, Vec<u8>),
    /// A connected socket of the file system.
    Unix(UnixStream),
    /// A file.
    File(File),
    /// Standard output.
    Stdout,
}

impl Sink {
    /// Opens the way to an address; to a file, what is there is written anew.
    ///
    /// # Errors
    /// Nobody is there, or the file cannot be created.
    pub fn open(address: &Address) -> io::Result<Self> {
        Ok(match address {
            Address::Tcp(to) => {
                let stream = connect(to)?;
                stream.set_write_timeout(Some(WAIT))?;
                // A frame is not to wait for the next one.
                stream.set_nodelay(true)?;
                Self::Tcp(stream)
            }
            Address::Udp(to) => {
                let socket = udp(to)?;
                socket.set_write_timeout(Some(WAIT))?;
                Self::Udp(socket, Cutter::new(stream_number()), Vec::new())
            }
            Address::Unix(path) => {
                let stream = UnixStream::connect(path)?;
                stream.set_write_timeout(Some(WAIT))?;
                Self::Unix(stream)
            }
            Address::File(path) => Self::File(create_bytes(path)?),
            Address::Stdout => Self::Stdout,
        })
    }

    /// Sends a message, however slowly it is taken, as long as `goes_on` says.
    ///
    /// # Errors
    /// The consumer is gone; `TimedOut` where the message was given up.
    pub fn send(&mut self, message: &[u8], goes_on: &dyn Fn() -> bool) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => send_all(stream, message, goes_on),
            Self::Unix(stream) => send_all(stream, message, goes_on),
            Self::File(file) => file.write_all(message),
            Self::Stdout => {
                let mut out = io::stdout().lock();
                out.write_all(message)?;
                out.flush()
            }
            Self::Udp(socket, cutter, datagram) => {
                let mut dropped = Ok(());
                let sent = cutter.cut(message, datagram, |datagram| match socket.send(datagram) {
                    Ok(_) => Ok(()),
                    // The number that is missing tells the receiver.
                    Err(error) if is_full(&error) => {
                        dropped = Err(ErrorKind::WouldBlock.into());
                        Ok(())
                    }
                    Err(error) => Err(error),
                });
                // What the host there answered, where it did at once.
                let sent = sent.and_then(|()| match socket.take_error()? {
                    Some(error) => Err(error),
                    None => Ok(()),
                });
                if sent.is_err() {
                    // Nobody had the stream so far: whoever comes gets one from its beginning.
                    cutter.begin_anew();
                }
                sent.and(dropped)
            }
        }
    }

    /// Says that the stream has ended, where the end of the way itself does not.
    pub fn end(&mut self) {
        if let Self::Udp(socket, cutter, datagram) = self
            && !cutter.is_at_start()
        {
            cutter.end(datagram);
            for _ in 0..ENDS {
                // Whoever does not hear of it waits on.
                let _ = socket.send(datagram);
            }
        }
    }

    /// Whether the way is there after that error, though what was sent is lost: datagrams have no connection.
    #[must_use]
    pub fn survives(&self, error: &io::Error) -> bool {
        let is_away = matches!(
            error.kind(),
            ErrorKind::ConnectionRefused
                | ErrorKind::HostUnreachable
                | ErrorKind::NetworkUnreachable
                | ErrorKind::NetworkDown
        );
        matches!(self, Self::Udp(..)) && (is_away || is_full(error))
    }

    /// Whether a lost way is worth to be tried again.
    #[must_use]
    pub const fn comes_back(&self) -> bool {
        matches!(self, Self::Tcp(_) | Self::Udp(..) | Self::Unix(_))
    }
}

/// Whether the system had no room for a datagram.
fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

fn send_all(stream: &mut impl Write, message: &[u8], goes_on: &dyn Fn() -> bool) -> io::Result<()> {
    let mut left = message;
    while !left.is_empty() {
        match stream.write(left) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(sent) => left = &left[sent..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error)
                if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
                    && goes_on() => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                return Err(ErrorKind::TimedOut.into());
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn connect(to: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in to.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

fn udp(to: &str) -> io::Result<UdpSocket> {
    let mut last = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in to.to_socket_addrs()? {
        let any = if address.is_ipv4() {
            "0.0.0.0:0"
        } else {
            "[::]:0"
        };
        let connected = UdpSocket::bind(any).and_then(|socket| {
            socket.connect(address)?;
            Ok(socket)
        });
        match connected {
            Ok(socket) => return Ok(socket),
            Err(error) => last = error,
        }
    }
    Err(last)
}

/// A number that another start of the program does not have.
fn stream_number() -> u32 {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    (now.as_micros() as u32) ^ std::process::id().rotate_left(16)
}
