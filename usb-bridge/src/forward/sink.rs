//! Where a consumer's messages go.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::net::{TcpStream, ToSocketAddrs, UdpSocket};
use std::os::unix::net::UnixStream;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::address::Address;
use super::datagram::{Cutter, PART_BYTES_MAX};

/// How long a connection may take to come about.
const CONNECT: Duration = Duration::from_secs(3);
/// How long a write waits before it is asked whether it may go on.
const WAIT: Duration = Duration::from_millis(100);

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
    /// Opens the way to an address.
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
            Address::File(path) => Self::File(File::create(path)?),
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
                for part in message.chunks(PART_BYTES_MAX) {
                    cutter.cut(part, datagram);
                    match socket.send(datagram) {
                        Ok(_) => {}
                        // Nobody listens just now, or the system has no room: the number that is
                        // missing tells who comes later.
                        Err(error)
                            if matches!(
                                error.kind(),
                                ErrorKind::ConnectionRefused
                                    | ErrorKind::WouldBlock
                                    | ErrorKind::TimedOut
                            ) => {}
                        Err(error) => return Err(error),
                    }
                }
                Ok(())
            }
        }
    }

    /// Whether a lost way is worth to be tried again.
    #[must_use]
    pub const fn comes_back(&self) -> bool {
        matches!(self, Self::Tcp(_) | Self::Unix(_))
    }
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
